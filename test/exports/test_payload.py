"""Which bodies are a payload, its inertia in the flange's frame, and how sure that is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import UncertainInertia
from geomid_ros.exports.formats import Export
from geomid_ros.exports.model import read_model
from geomid_ros.exports.payload import Summand, attached, difference, each_link, sum_of_links, total
from geomid_ros.files.models.written_model import write_model
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot

from .points import Chain, Link, Points, points

ARM = (
    Link("base"),
    Link("fore", "base", points(1), "continuous", (0.1, 0.2, 0.3), (0.4, -0.5, 0.6)),
    Link("wrist", "fore", points(2), "continuous", (-0.1, 0.05, 0.2), (1.0, 0.3, -0.7)),
    Link("tool0", "wrist", None, "fixed", (0.01, 0.02, 0.08), (0.2, 2.0, 1.1)),
)
GRIPPER = Link("gripper", "tool0", points(3), "fixed", (0.0, 0.03, 0.05), (-0.9, 0.8, 0.1))
FINGER = Link("finger", "gripper", points(4, 0.01), "continuous", (0.03, 0.0, 0.1), (0.3, 0.2, -1.2))
WHOLE = Chain((*ARM, GRIPPER, FINGER))


def assert_is(export: Export, expected: Points) -> None:
    assert export.inertial.mass == pytest.approx(expected.mass, rel=1e-9)
    np.testing.assert_allclose(export.inertial.com, expected.com, rtol=0, atol=1e-10)
    np.testing.assert_allclose(export.inertial.inertia, expected.inertia, rtol=0, atol=1e-12)


@pytest.mark.parametrize("estimated", [{}, {"wrist": {}, "gripper": {}, "finger": {}}])
def test_all_that_is_attached_is_summed_in_the_flange(estimated: dict[str, dict[str, object]], tmp_path: Path) -> None:
    model = read_model(replace(WHOLE, estimated=estimated).write(tmp_path))
    payload = attached(model, "tool0")
    assert_is(payload, WHOLE.seen("gripper", "tool0") + WHOLE.seen("finger", "tool0"))
    assert payload.notes == ("with these joints at zero: finger_joint",)
    assert_is(attached(model, "finger"), WHOLE.seen("finger", "finger"))
    assert attached(model, "finger").notes == ()


def test_named_links_in_any_frame(tmp_path: Path) -> None:
    model = read_model(WHOLE.write(tmp_path))
    assert_is(sum_of_links(model, ["gripper", "gripper"], "base"), WHOLE.seen("gripper", "base"))
    assert_is(
        sum_of_links(model, ["fore", "finger"], "tool0"), WHOLE.seen("fore", "tool0") + WHOLE.seen("finger", "tool0")
    )
    assert "fore_joint" not in str(sum_of_links(model, ["fore"], "fore").notes)


def merged() -> Chain:
    """The gripper in the wrist, as a wrist without a sensor is identified."""
    gripper = GRIPPER.body
    assert gripper is not None
    in_wrist = WHOLE.seen("gripper", "wrist") + WHOLE.seen("wrist", "wrist")
    links = (*ARM[:2], replace(ARM[2], body=in_wrist), ARM[3], replace(GRIPPER, body=None), FINGER)
    return Chain(links, {"fore": {}, "wrist": {"merged": ["gripper"]}, "finger": {}})


def test_a_reference_takes_the_wrist_away(tmp_path: Path) -> None:
    expected = WHOLE.seen("gripper", "tool0") + WHOLE.seen("finger", "tool0")
    model, reference = read_model(merged().write(tmp_path / "with")), read_model(Chain(ARM).write(tmp_path / "arm"))
    with pytest.raises(InputError, match="'wrist' was identified as one body with gripper"):
        attached(model, "tool0")
    payload = difference(model, reference, "tool0")
    assert_is(payload, expected)
    assert "differ" not in str(payload.notes)
    other = read_model(Chain((ARM[0], replace(ARM[1], body=points(9)), *ARM[2:])).write(tmp_path / "other"))
    (note,) = (note for note in difference(model, other, "tool0").notes if "differ" in note)
    assert note.startswith("fore differ"), "links elsewhere"
    with pytest.raises(InputError, match="'gripper' is not a separate body: it is merged into 'wrist'"):
        sum_of_links(model, ["gripper"], "tool0")


def test_less_than_nothing_is_refused(tmp_path: Path) -> None:
    bare, held = read_model(Chain(ARM).write(tmp_path / "arm")), read_model(WHOLE.write(tmp_path / "with"))
    with pytest.raises(InputError, match=r"its mass is -[\d.]+ kg; it must be positive"):
        difference(bare, held, "tool0")
    with pytest.raises(InputError, match="nothing at or after 'tool0' has a mass"):
        attached(bare, "tool0")
    with pytest.raises(InputError, match="its mass is 0 kg"):
        difference(bare, bare, "tool0")
    empty = read_model(Chain((Link("base"), Link("tool0", "base"))).write(tmp_path / "empty"))
    with pytest.raises(InputError, match="its mass is 0 kg"):
        difference(empty, empty, "tool0")


def test_a_difference_that_no_body_has_is_refused(tmp_path: Path) -> None:
    """A point heavier, and a smaller inertia."""
    wrist = ARM[2].body
    assert wrist is not None
    shrunk = Points(1.5 * wrist.masses, 0.5 * (wrist.positions - wrist.com) + wrist.com)
    model = Chain((*ARM[:2], replace(ARM[2], body=shrunk), ARM[3]))
    reference = read_model(Chain(ARM).write(tmp_path / "b"))
    with pytest.raises(
        InputError, match=r"its principal moments of inertia, .* are not physically consistent"
    ) as refusal:
        difference(read_model(model.write(tmp_path / "a")), reference, "tool0")
    empty = reference.source if reference.estimated else "EMPTY_BAG"
    assert f"geomid payload {empty} LOADED_BAG --frame tool0" in str(refusal.value)


@pytest.mark.parametrize("quantity", ["mass", "com y"])
def test_what_the_data_did_not_show_is_refused(quantity: str, tmp_path: Path) -> None:
    told = {"wrist": {}, "gripper": {"cannot_tell": [quantity, "Ixx"]}, "finger": {}}
    model = read_model(replace(WHOLE, estimated=told).write(tmp_path))
    with pytest.raises(InputError, match=f"hardly identify {quantity} of 'gripper'"):
        attached(model, "tool0")
    assert any(f"{quantity}, Ixx" in note for note in each_link(model)[1].notes)


def test_of_a_small_part_it_may_be_unknown(tmp_path: Path) -> None:
    """An inertia, or all about a part of a twentieth of the mass: said, not refused. A link that was not identified
    counts as unknown."""
    finger, gripper = FINGER.body, GRIPPER.body
    assert finger is not None
    assert gripper is not None
    light = Points(0.05 * gripper.mass / finger.mass * finger.masses, finger.positions)
    links = (*ARM, GRIPPER, replace(FINGER, body=light))
    model = read_model(Chain(links, {"gripper": {"cannot_tell": ["Ixx"]}}).write(tmp_path / "light"))
    notes = attached(model, "tool0").notes
    assert [note.split(",")[0] for note in notes[2:]] == [
        "hardly identified by the data of gripper",
        "hardly identified by the data of finger",
    ]
    heavy = read_model(replace(WHOLE, estimated={"gripper": {}}).write(tmp_path / "heavy"))
    with pytest.raises(InputError, match="of 'finger'"):
        attached(heavy, "tool0")


def random_term(seed: int) -> Summand:
    random = np.random.default_rng(seed)
    body = points(seed)
    own = pseudo_inertia.assemble(np.array(body.mass), body.com, body.inertia)
    placement = np.eye(4)
    placement[:3, :3] = np.linalg.qr(random.normal(size=(3, 3)))[0]
    placement[:3, 3] = random.normal(scale=0.1, size=3)
    std = np.array([2e-3, *[1e-4] * 3, *[2e-6] * 6]) * random.uniform(0.5, 2.0, 10)
    return Summand(UncertainInertia(parameters=own, std=std), placement, 1.0)


def part_taken_away(term: Summand) -> Summand:
    """Of a body, a third of each of its points."""
    third = term.inertial.quantities / np.array([3.0, 1.0, 1.0, 1.0, *[3.0] * 6])
    own = UncertainInertia(parameters=pseudo_inertia.parameters_of(third), std=0.7 * term.inertial.std)
    return Summand(own, term.placement, -1.0)


def test_standard_deviations_are_those_of_repeated_draws() -> None:
    terms = [random_term(5), random_term(6), part_taken_away(random_term(5))]
    random = np.random.default_rng(0)
    draws = []
    for _ in range(2000):
        drawn = []
        for term in terms:
            mass, *rest = random.normal(term.inertial.quantities, term.inertial.std)
            com, (xx, xy, yy, xz, yz, zz) = np.array(rest[:3]), rest[3:]
            central = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            rotation, translation = term.placement[:3, :3], term.placement[:3, 3]
            drawn.append((term.sign * mass, rotation @ com + translation, term.sign * rotation @ central @ rotation.T))
        whole = sum(mass for mass, _, _ in drawn)
        centre = sum((mass * com for mass, com, _ in drawn), np.zeros(3)) / whole
        about = np.zeros((3, 3))
        for mass, com, central in drawn:
            arm = com - centre
            about += central + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        draws.append([whole, *centre, *about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    found = total(terms, "sum")
    spread = np.std(draws, axis=0)
    np.testing.assert_allclose(found.std, spread, rtol=0.08)  # 1/sqrt(2 * 2000) is 1.6 %
    assert np.all(np.abs(np.mean(draws, axis=0) - found.quantities) < 0.2 * spread)


def test_an_uncertainty_that_is_not_known_is_not_made_up(tmp_path: Path) -> None:
    """Of all: not known. Of one part: that counts as exact, and it is said which."""
    unknown = np.full(10, np.nan)
    one, other = (term._replace(inertial=replace(term.inertial, std=unknown)) for term in map(random_term, (5, 6)))
    assert np.all(np.isnan(total([one, other], "sum").std))
    sure = other._replace(inertial=replace(other.inertial, std=0.01 * np.abs(other.inertial.quantities)))
    assert total([one, sure], "sum").std[0] == pytest.approx(0.01 * other.inertial.mass)
    model, reference = read_model(merged().write(tmp_path / "with")), read_model(Chain(ARM).write(tmp_path / "arm"))
    payload = difference(model, reference, "tool0")
    assert payload.inertial.std[0] == pytest.approx(0.01 * np.sqrt(2.0))  # of wrist and finger
    assert f"taken as exact: wrist of {reference.source}" in payload.notes


def test_a_payload_that_gap_found_is_attached_with_its_uncertainty(tmp_path: Path) -> None:
    """Written by the gap workflow's own writer, at the wrist."""
    robot = Robot(Chain(ARM).urdf())
    held = points(11)
    keys = ("com_x", "com_y", "com_z", "ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    parameters = {"mass": Quantity(held.mass, 0.03, "kg")}
    for key, value in zip(keys, [*held.com, *held.six], strict=True):
        parameters[key] = Quantity(float(value), 1e-4, "m" if key.startswith("com") else "kg m^2")
    inertias = {body.name: body.parameters for body in robot.bodies}
    effects = [KnownEffect("payload", "", "wrist", parameters)]
    write_model(tmp_path, MeasurementModel(robot, ()), robot.urdf, inertias, effects, robot.gravity)
    model = read_model(tmp_path / "estimate.json")
    payload = sum_of_links(model, ["wrist_payload"], "wrist")
    assert payload.inertial.mass == pytest.approx(held.mass, rel=1e-8)
    np.testing.assert_allclose(payload.inertial.com, held.com, atol=1e-9)
    np.testing.assert_allclose(payload.inertial.std, [0.03, *[1e-4] * 9], rtol=1e-6)
    assert difference(model, read_model(Chain(ARM).write(tmp_path / "arm")), "tool0").inertial.mass == pytest.approx(
        held.mass, rel=1e-7
    )
