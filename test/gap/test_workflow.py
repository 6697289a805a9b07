"""The whole workflow on planted robots, and what it refuses."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from estimation.frames import rewritten
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.gap import analysis, verdict, workflow
from geomid_ros.gap.result import GapResult, LinkChange
from geomid_ros.gap.workflow import find_gap
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.inference.prior import GAIN, OtherRecordings
from geomid_ros.model.effects.friction import LoadFriction, StribeckFriction, ViscousFriction
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.report.gap_words import summary
from geomid_ros.types import FloatArray

from . import planted
from .planted import Efforts

JOINTS = planted.model().robot.joint_names


def recordings(efforts: Efforts, seed: int) -> tuple[list[Samples], list[Samples]]:
    """To fit, and held out."""
    return [planted.recording(efforts, seed)], [planted.recording(efforts, seed + 1000, 13.0)]


def run(efforts: Efforts, seed: int, model: MeasurementModel | None = None, **known: Any) -> GapResult:
    """Beside a URDF alone, unless more is known."""
    return find_gap(model or planted.model(), *recordings(efforts, seed), **known)


def beside(seed: int, extra: Callable[[FloatArray, FloatArray, FloatArray], FloatArray], joint: int) -> Efforts:
    """A robot with inertial errors and something more at one joint."""
    rigid = planted.rigid(planted.true_inertias(seed, 0.2))

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        result = rigid(q, v, a)
        result[:, joint] += extra(q[:, joint], v[:, joint], a[:, joint])
        return result

    return efforts


def test_inertial_errors_alone_are_no_finding() -> None:
    result = run(planted.rigid(planted.true_inertias(11, 0.2)), 11)
    assert result.verdict == "no gap"
    assert not result.findings
    assert not result.unexplained
    assert not [change for change in result.links if change.moment], "nothing says that one link has been changed"
    assert np.max(result.gap.before) > 1.5
    np.testing.assert_allclose(result.floor, planted.NOISE, rtol=0.15)


def test_a_link_that_a_urdf_has_wrong_is_told_and_no_gap() -> None:
    inertias = planted.true_inertias(11, 0.05)
    inertias[2] *= 2.0
    result = run(planted.rigid(inertias), 11)
    assert "confident" in [change.confidence for change in result.links]
    assert (result.findings, result.verdict) == ((), "no gap")


PAYLOAD = 0.6  # [kg]


def carrying(inertias: FloatArray) -> FloatArray:
    """With a small body at the last link."""
    return with_body(inertias, -1, inertias[-1, 1:4] / inertias[-1, 0] + [0.03, 0.0, 0.05])


def with_body(inertias: FloatArray, link: int, centre: FloatArray) -> FloatArray:
    """With the small body there."""
    loaded = inertias.copy()
    x, y, z = centre
    square = [y**2 + z**2, -x * y, x**2 + z**2, -x * z, -y * z, x**2 + y**2]
    loaded[link] += PAYLOAD * np.array([1.0, *centre, *square])
    loaded[link, [4, 6, 9]] += 1e-3
    return loaded


@cache
def identified(seed: int, motion: int, body: bool = False) -> Estimate:
    """What is known of the robot of this seed, with the small body or without, after another motion."""
    inertias = planted.true_inertias(seed, 0.2)
    identifier = Identifier(planted.model())
    identifier.add(planted.recording(planted.rigid(carrying(inertias) if body else inertias), motion))
    return identifier.solve()


def known(before: Estimate) -> dict[str, Any]:
    """An estimate, and what its recordings say of its links."""
    return {
        "nominal": before.parameters,
        "previous": OtherRecordings(before.information.rows, before.information.residuals),
    }


def test_a_payload_that_only_the_prior_tells_is_not_sure_but_beside_an_identified_model_it_is() -> None:
    """And it weighs what it weighs beside inertias that were identified together: their errors are large, but not where
    the motion tells."""
    before, loaded = known(identified(52, 53)), planted.rigid(carrying(planted.true_inertias(52, 0.2)))
    assert not run(loaded, 52).sure
    together, apart = (run(loaded, 52, **own).findings[0] for own in (before, before | {"previous": None}))
    for finding in (together, apart):
        assert (finding.effect, finding.joint, finding.confidence) == ("payload", JOINTS[-1], "confident")
        assert abs(finding.parameters["mass"].value - PAYLOAD) < 3.0 * finding.parameters["mass"].std
        assert finding.moment == {}
    masses = [finding.parameters["mass"] for finding in (together, apart)]
    beyond_gain = [np.sqrt(mass.std**2 - (GAIN * mass.value) ** 2) for mass in masses]
    assert beyond_gain[0] < 0.02 * PAYLOAD
    assert beyond_gain[0] < 0.3 * beyond_gain[1]


def test_of_a_payload_whose_mass_is_not_told_the_first_moment_is_said() -> None:
    """The second link turns about its own origin and a vertical axis: nothing lifts its mass."""
    inertias, centre = planted.true_inertias(51, 0.2), np.array([0.02, 0.0, 0.1])
    result = run(planted.rigid(with_body(inertias, 1, centre)), 52, **known(identified(51, 53)))
    (change,) = result.links
    assert not result.findings
    assert (change.link, change.confidence) == (planted.model().body_names[1], "confident")
    assert result.verdict == "named"
    for axis, true in zip("xz", PAYLOAD * centre[[0, 2]], strict=True):
        moment = change.moment[f"m {axis}"]
        assert abs(moment.value - true) < 3.0 * moment.std
        assert moment.std < 0.15 * true
    assert change.moment["m y"].std > 3.0 * change.moment["m x"].std, "it lies along the axis"
    assert "changed: m x by 0.01" in change.sentence
    assert any("m x by 0.01" in sentence for sentence in summary(result))


@pytest.mark.parametrize("link", [1, 2])
def test_a_link_that_has_become_lighter_is_told_as_that(link: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A body that is added behind the joint would explain it nearly as well. The link is not sure where another one
    may have been changed in its place, and not named where the size that is written may be nothing."""
    lighter = planted.true_inertias(61, 0.2)
    lighter[link] *= 0.7
    before, robot = known(identified(61, 61)), planted.rigid(lighter)
    analysed: list[Any] = []

    def analyse(*given: Any) -> Any:
        analysed.append(analysed[0] if analysed else analysis.analyse(*given))
        return analysed[-1]

    def found() -> GapResult:
        return run(robot, 561, **before)

    monkeypatch.setattr(workflow, "analyse", analyse)
    result = found()
    assert not result.findings
    (change,) = result.links
    assert (change.link, change.confidence) == (planted.model().body_names[link], "confident")
    sizes = {"mass": change.mass} if not change.moment else change.moment
    nominal = planted.true_inertias(61, 0.2)[link]
    true = dict(zip(("mass", "m x", "m y", "m z"), lighter[link, :4] - nominal[:4], strict=True))
    for name, size in sizes.items():
        assert abs(size.value - true[name]) < 3.0 * size.std

    certain = analysed[0]
    analysed[0] = replace(certain, contested=0.25)
    (contested,) = found().links
    assert (contested.link, contested.confidence) == (change.link, "tentative")

    def unsure(*given: Any) -> tuple[LinkChange, ...]:
        links = verdict.changed_links(*given)
        return tuple(
            replace(each, mass=replace(each.mass, std=0.5 * abs(each.mass.value)), moment={}) for each in links
        )

    analysed[0] = certain
    monkeypatch.setattr(workflow, "changed_links", unsure)
    result = found()
    assert not result.links
    np.testing.assert_allclose(result.gap.after, result.gap.before, rtol=0.01)


def test_the_centre_of_a_difference_is_as_unsure_as_mass_and_first_moment_together() -> None:
    """Against draws: a mass and a first moment that err together leave the centre as it is."""
    mass, centre = 0.5, np.array([0.1, -0.2, 0.3])
    change = np.concatenate([[mass], mass * centre, np.zeros(6)])
    along = np.concatenate([[0.02], 0.02 * centre])
    covariance = np.outer(along, along) + np.diag([1e-8, 1e-4, 4e-4, 9e-4]) * mass**2
    found = verdict._centre(change, covariance)
    draws = np.random.default_rng(0).multivariate_normal(change[:4], covariance, 20_000)
    for place, axis in enumerate("xyz"):
        assert found[axis].value == pytest.approx(centre[place])
        assert found[axis].std == pytest.approx(np.std(draws[:, 1 + place] / draws[:, 0]), rel=0.05)


def test_a_gain_of_all_joints_is_no_payload() -> None:
    """Where it is known what the links weigh."""
    rigid = planted.rigid(planted.true_inertias(51, 0.2))
    result = run(lambda q, v, a: 1.12 * rigid(q, v, a), 52, **known(identified(51, 53)))
    gains = {f.joint: f.parameters["gain"] for f in result.findings if f.effect == "effort_gain"}
    assert set(gains) == set(JOINTS)
    assert all(abs(gain.value - 1.12) < 4.0 * gain.std for gain in gains.values())
    assert not [f for f in result.findings if f.effect == "payload"]
    assert any("efforts of all joints 1.1" in sentence for sentence in summary(result))


def test_a_payload_that_is_gone_is_no_other_effect() -> None:
    """What the recordings with it said of the links contradicts those without: then it is worth little, and is not
    imitated by wrong sensors."""
    without = planted.rigid(planted.true_inertias(54, 0.2))
    result = run(without, 554, **known(identified(54, 54, body=True)))
    assert not result.sure
    assert np.max(result.gap.inertias_only) < 1.3


def test_a_link_is_heavier_by_a_payload_that_the_simulator_lacks_and_its_friction_is_no_gap() -> None:
    inertias = planted.true_inertias(61, 0.05)
    friction = np.array([0.0, 0.4, 0.0])
    twin_robot, robot = planted.rigid(inertias), planted.rigid(carrying(inertias))
    twin = planted.recording(lambda q, v, a: twin_robot(q, v, a) + friction * v, 61)
    result = run(lambda q, v, a: robot(q, v, a) + friction * v, 62, simulated=[twin])
    assert result.findings == ()
    (change,) = result.links
    assert (change.link, change.joint, change.confidence) == ("link3", "joint3", "confident")
    assert result.verdict == "named"
    assert abs(change.mass.value - PAYLOAD) < 3.0 * change.mass.std
    assert change.mass.std < 0.3 * PAYLOAD
    assert "higher than in the model" in change.sentence
    assert not change.centre, "of a drawing's own link nobody knows where its mass is"


@pytest.mark.parametrize("identified", [False, True])
def test_of_joints_that_stand_exactly_still_nothing_is_said_and_of_the_others_what_is_true(identified: bool) -> None:
    """Neither their positions nor their measured efforts ever change: they show no noise, and divide nothing by it."""
    inertias = planted.true_inertias(76, 0.03)
    robot, moves = planted.rigid(inertias), np.array([True, False, False])

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return np.where(moves, robot(q, v, a) + 0.8 * v, 1.25)

    motion: dict[str, Any] = {"noise": planted.NOISE * moves, "size": 1.0 * moves, "posture": 0.4}
    train, held_out = (planted.recording(efforts, seed, **motion) for seed in (76, 1076))
    assert np.all(np.ptp(train.position, axis=0)[~moves] == 0.0)
    with np.errstate(divide="raise", invalid="raise"):
        result = find_gap(planted.model(), [train], [held_out], nominal=inertias.ravel() if identified else None)
    sure = {(finding.effect, finding.joint) for finding in result.sure}
    assert sure == {("viscous_friction", JOINTS[joint]) for joint in np.flatnonzero(moves)}
    assert not {finding.joint for finding in result.findings} & set(JOINTS[1:])
    for found in (result.floor, result.gap.after, result.moving):
        np.testing.assert_array_equal(np.isfinite(found), moves)


def test_friction_that_has_grown_is_named_with_what_it_was_and_keeps_its_shape() -> None:
    """At a speed that is none of those to choose from. It is no payload, gain or delay, and friction that has not
    changed is not named."""
    inertias, viscous = planted.true_inertias(72, 0.03), np.array([0.3, 0.5, 0.2])
    robot, stribeck = planted.rigid(inertias), StribeckFriction(0.31)
    model = MeasurementModel(planted.model().robot, [ViscousFriction()], local_effects={JOINTS[1]: stribeck.parts})
    shape = np.array([1.0, 0.6])  # of the level: it, and what there is more near standstill
    known = {"viscous_friction": dict(zip(JOINTS, viscous, strict=True)), "coulomb_friction": {JOINTS[1]: 0.4}}
    before = np.array([known.get(c.effect.name, {}).get(c.place_name, 0.24) for c in model.coefficients])

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        whole = robot(q, v, a) + viscous * v
        speed = v[:, 1]
        whole[:, 1] += 0.7 * (1.0 + 0.6 * np.exp(-((speed / 0.31) ** 2))) * np.tanh(speed / 0.02)
        return whole

    result = run(efforts, 72, model, nominal=np.append(inertias.ravel(), before))
    (finding,) = result.findings
    assert (finding.effect, finding.joint, finding.confidence) == ("stribeck_friction", JOINTS[1], "confident")
    assert finding.was == pytest.approx({"level": 0.4, "excess": 0.24, "speed": 0.31})
    assert "instead of 0.4" in finding.sentence
    for name, value in zip(("level", "excess"), 0.7 * shape, strict=True):
        assert abs(finding.parameters[name].value - value) < 3.0 * finding.parameters[name].std
    unchanged = [c.effect.name == "viscous_friction" for c in model.coefficients]
    np.testing.assert_allclose(result.coefficients, np.where(unchanged, before, np.nan), rtol=0.1)


def test_friction_in_proportion_to_the_load_is_of_that_of_the_links_as_identify_takes_it() -> None:
    """Not of other friction, though at an axis that gravity does not load that is most of the effort."""
    inertias = planted.true_inertias(73, 0.03)
    robot = planted.rigid(inertias)
    model = MeasurementModel(planted.model().robot, [ViscousFriction()])
    viscous = np.array([1.5, 0.3, 0.2])

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        links = robot(q, v, a)
        return links + viscous * v + np.array([0.2, 0.0, 0.0]) * np.abs(links) * np.sign(v)

    result = run(efforts, 73, model, nominal=np.append(inertias.ravel(), viscous))
    (finding,) = result.sure
    assert (finding.effect, finding.joint) == ("load_friction", JOINTS[0])
    size = finding.parameters["coefficient"]
    assert size.value == pytest.approx(0.2, abs=0.02)
    assert size.std == pytest.approx(LoadFriction.drift * 0.2, rel=0.2), "in another motion it is another"


@pytest.mark.parametrize("offset", [0.0, -4.0])
def test_a_size_that_an_offset_may_change_is_as_unsure(offset: float) -> None:
    """At a vertical slide it is a weight, as far as anyone can tell: the rest of the inertia is the motor's."""
    text = (planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")
    robot = Robot(text.replace('name="joint1" type="revolute"', 'name="joint1" type="prismatic"'))
    dynamics = robot.with_inertias(np.array([body.parameters for body in robot.bodies]), range(3))
    data, rotor = dynamics.createData(), 5.0

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        links = np.array([pin.rnea(dynamics, data, *row) for row in zip(q, v, a, strict=True)])
        return links + np.array([1.0, 0.0, 0.0]) * (rotor * a + offset)

    result = run(efforts, 5, MeasurementModel(robot, ()))
    (size,) = [f.parameters["inertia"] for f in result.findings if (f.effect, f.joint) == ("rotor_inertia", JOINTS[0])]
    (written,) = [e.parameters["inertia"] for e in result.ordinary if e.effect == "rotor_inertia"]
    for quantity in (size, written):
        assert abs(quantity.value - rotor) < 3.0 * quantity.std
        assert quantity.std > 0.1, "a mass of the URDF is known to a fifth"


def test_friction_that_follows_reversals_late_is_no_delay() -> None:
    """As bristles that bend first: it lags by some 20 ms, what the rigid bodies need does not."""
    inertias = planted.true_inertias(81, 0.05)
    robot = planted.rigid(inertias)

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        share = 1.0 - np.exp(-1.0 / (0.02 * planted.RATE))
        return np.asarray(robot(q, v, a) + 0.5 * lfilter([share], [1.0, share - 1.0], np.sign(v), axis=0))

    result = run(efforts, 81)
    assert not [f for f in result.findings if f.effect == "effort_delay"]


def test_a_long_delay_is_found_beside_what_has_no_name() -> None:
    """What is common to all joints is no part of what each lacks."""
    robot, delay = planted.rigid(planted.true_inertias(81, 0.2)), -0.12

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        lacking = np.sin(9.0 * q + 1.0) + np.sin(3.0 * q[:, [1, 2, 0]])
        whole = robot(q, v, a) + 0.5 * np.tanh(v / 0.02) + 0.1 * lacking
        times = np.arange(len(q)) / planted.RATE
        return np.asarray(CubicSpline(times, whole)(times - delay))

    result = run(efforts, 81)
    (found,) = [f for f in result.sure if f.effect == "effort_delay"]
    assert found.parameters["delay"].value == pytest.approx(delay, abs=2e-3)


def test_three_seconds_are_enough_for_what_is_plain() -> None:
    """And what so short a recording cannot tell is not claimed."""
    for extra, expected in (
        (lambda _q, v, _a: 0.4 * v, [("viscous_friction", JOINTS[1])]),
        (lambda *_: 0.0, []),
    ):
        train, unseen = (planted.recording(beside(21, extra, 1), seed, seconds=3.0) for seed in (21, 1021))
        found = find_gap(planted.model(), [train], [unseen])
        assert [(finding.effect, finding.joint) for finding in found.findings] == expected
        assert np.all(np.isfinite(found.floor))


SAME = 1e-3  # of a standard deviation, or relative: the fits end at a tolerance
URDF = (planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")


def found_in(model: MeasurementModel, unit: float) -> GapResult:
    """With friction at the second joint; efforts times ``unit``."""
    rigid = planted.rigid(planted.true_inertias(71, 0.2))
    parts = [
        planted.recording(lambda q, v, a: rigid(q, v, a) + np.array([0.0, 0.3, 0.0]) * v, seed, seconds)
        for seed, seconds in ((71, 30.0), (72, 12.0))
    ]
    train, held_out = (replace(part, effort=unit * part.effort) for part in parts)
    return find_gap(model, [train], [held_out])


def test_frames_and_units_do_not_matter() -> None:
    """Written in other frames, in cm and g."""
    length, mass = 100.0, 1000.0
    other, unit = rewritten(URDF, 5, length, mass), mass * length**2
    there_model = MeasurementModel(Robot(other.urdf, gravity=np.array([0.0, 0.0, -9.81 * length])), ())
    here, there = found_in(planted.model(), 1.0), found_in(there_model, unit)
    assert there.verdict == here.verdict == "named"
    for one, two in zip(here.findings, there.findings, strict=True):
        assert (two.effect, two.joint, two.confidence) == (one.effect, one.joint, one.confidence)
        for name, quantity in one.parameters.items():
            assert abs(two.parameters[name].value / unit - quantity.value) < SAME * quantity.std
            assert two.parameters[name].std == pytest.approx(unit * quantity.std, rel=SAME)
    np.testing.assert_allclose(there.floor, unit * here.floor, rtol=SAME)
    np.testing.assert_allclose(there.gap.after, here.gap.after, rtol=SAME)
    for body, one, two in zip(here.bodies, here.inertias, there.inertias, strict=True):
        expected = pseudo_inertia.from_parameters(other.parameters(body, one))
        assert spd.distance(expected, pseudo_inertia.from_parameters(two)) < 10.0 * SAME
