"""The whole workflow on planted robots, and what it refuses."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from geomid_ros.errors import InputError
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.gap import analysis, workflow
from geomid_ros.gap.judgement import changed_links
from geomid_ros.gap.result import GapResult, LinkChange
from geomid_ros.gap.workflow import find_gap
from geomid_ros.model.effects.stribeck_friction import StribeckFriction
from geomid_ros.model.effects.viscous_friction import ViscousFriction
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.report.gap_words import in_short
from geomid_ros.types import FloatArray

from . import planted
from .planted import Efforts

JOINTS = planted.model().robot.joint_names


def run(efforts: Efforts, seed: int, noise: float = planted.NOISE) -> GapResult:
    train = planted.recording(efforts, seed, noise=noise)
    held_out = planted.recording(efforts, seed + 1000, 15.0, noise=noise)
    return find_gap(planted.model(), [train], [held_out])


def beside(seed: int, extra: Callable[[FloatArray, FloatArray, FloatArray], FloatArray], joint: int) -> Efforts:
    """A robot with inertial errors and something more at one joint."""
    rigid = planted.rigid(planted.true_inertias(seed, 0.2))

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        result = rigid(q, v, a)
        result[:, joint] += extra(q[:, joint], v[:, joint], a[:, joint])
        return result

    return efforts


@pytest.mark.parametrize("seed", [11])
def test_inertial_errors_alone_are_no_finding(seed: int) -> None:
    result = run(planted.rigid(planted.true_inertias(seed, 0.2)), seed)
    assert result.verdict == "no gap"
    assert not result.findings
    assert not result.unexplained
    assert not [change for change in result.links if change.moment], "nothing says that one link has been changed"
    assert np.max(result.gap.before) > 1.5
    np.testing.assert_allclose(result.floor, planted.NOISE, rtol=0.15)


PLANTED = {
    "viscous_friction": lambda _q, v, _a: 0.4 * v,
    "coulomb_friction": lambda _q, v, _a: 0.3 * np.sign(v),
    "spring": lambda q, _v, _a: 2.0 * (q - 0.3),
    "effort_offset": lambda q, _v, _a: -0.5 + 0.0 * q,
}


@pytest.mark.parametrize(
    ("effect", "joint"), [("viscous_friction", 0), ("coulomb_friction", 2), ("spring", 0), ("effort_offset", 2)]
)
def test_a_planted_effect_is_named(effect: str, joint: int) -> None:
    """And how large it is, test_calibration judges."""
    result = run(beside(20 + joint, PLANTED[effect], joint), 20 + joint)
    (finding,) = result.findings
    assert (finding.effect, finding.joint, finding.confidence) == (effect, JOINTS[joint], "confident")
    assert result.verdict == "named"
    assert np.max(result.gap.inertias_only) > 2.0
    assert np.max(result.moving) < 1.2, "near reversals the shape counts, which is not told here"


def test_what_a_simulator_shows_too_is_no_gap() -> None:
    efforts = beside(41, lambda _q, v, _a: 0.4 * v, 1)
    train, held_out = planted.recording(efforts, 41), planted.recording(efforts, 1041, 15.0)
    twin = planted.recording(efforts, 2041)
    assert find_gap(planted.model(), [train], [held_out]).verdict == "named"
    assert find_gap(planted.model(), [train], [held_out], simulated=[twin]).verdict == "no gap"


def test_too_little_is_refused() -> None:
    short = planted.recording(planted.rigid(planted.true_inertias(1, 0.1)), 1, seconds=1.0)
    with pytest.raises(InputError, match="too short"):
        find_gap(planted.model(), [short], [short])


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


def test_a_payload_that_only_the_prior_tells_is_not_sure_but_beside_an_identified_model_it_is() -> None:
    inertias = planted.true_inertias(51, 0.2)
    loaded = planted.rigid(carrying(inertias))
    train, held_out = planted.recording(loaded, 51), planted.recording(loaded, 1051, 15.0)
    guessed = find_gap(planted.model(), [train], [held_out])
    assert not [finding for finding in guessed.findings if finding.confidence == "confident"]
    known = find_gap(planted.model(), [train], [held_out], nominal=inertias.ravel())
    (finding,) = known.findings
    assert (finding.effect, finding.joint) == ("payload", JOINTS[-1])
    assert finding.confidence == "confident"
    mass = finding.parameters["mass"]
    assert abs(mass.value - PAYLOAD) < 3.0 * mass.std
    assert mass.std < 0.3 * PAYLOAD
    assert finding.moment == {}


def test_a_payload_weighs_what_it_weighs_beside_inertias_that_were_identified_together() -> None:
    """Their errors are large, but not where the motion tells: to know both makes the payload's mass sharp."""
    inertias = planted.true_inertias(52, 0.2)
    identifier = Identifier(planted.model())
    identifier.add(planted.recording(planted.rigid(inertias), 53))
    before = identifier.solve()
    loaded = planted.rigid(carrying(inertias))
    recordings = [planted.recording(loaded, 52)], [planted.recording(loaded, 1052, 15.0)]
    found = [
        find_gap(planted.model(), *recordings, nominal=before.parameters, known=known).findings[0].parameters["mass"]
        for known in (before.information, None)
    ]
    assert abs(found[0].value - PAYLOAD) < 3.0 * found[0].std
    assert found[0].std < 0.02 * PAYLOAD
    assert found[0].std < 0.3 * found[1].std


def test_of_a_payload_whose_mass_is_not_told_the_first_moment_is_said() -> None:
    """The second link turns about its own origin and a vertical axis: nothing lifts its mass."""
    inertias, centre = planted.true_inertias(51, 0.2), np.array([0.02, 0.0, 0.1])
    identifier = Identifier(planted.model())
    identifier.add(planted.recording(planted.rigid(inertias), 53))
    before = identifier.solve()
    loaded = planted.rigid(with_body(inertias, 1, centre))
    recordings = [planted.recording(loaded, 52)], [planted.recording(loaded, 1052, 15.0)]
    result = find_gap(planted.model(), *recordings, nominal=before.parameters, known=before.information)
    (change,) = result.links
    assert not result.findings
    assert (change.link, change.confidence) == (planted.model().body_names[1], "confident")
    for axis, true in zip("xz", PAYLOAD * centre[[0, 2]], strict=True):
        moment = change.moment[f"m {axis}"]
        assert abs(moment.value - true) < 3.0 * moment.std
        assert moment.std < 0.15 * true
    assert change.moment["m y"].std > 3.0 * change.moment["m x"].std, "it lies along the axis"
    assert "first moment m x by 0.01" in change.sentence
    assert any("m x by 0.01" in sentence for sentence in in_short(result))


def found_lighter(inertias: FloatArray, lighter: FloatArray, seed: int) -> GapResult:
    """Of a robot that was identified with these inertias, and has others now."""
    identifier = Identifier(planted.model())
    identifier.add(planted.recording(planted.rigid(inertias), seed))
    before, robot = identifier.solve(), planted.rigid(lighter)
    recordings = [planted.recording(robot, seed + 500)], [planted.recording(robot, seed + 1000, 15.0)]
    return find_gap(planted.model(), *recordings, nominal=before.parameters, known=before.information)


@pytest.mark.parametrize("link", [1, 2])
@pytest.mark.parametrize("seed", [61])
def test_a_link_that_has_become_lighter_is_told_as_that(link: int, seed: int) -> None:
    """A body that is added behind the joint would explain it nearly as well."""
    inertias = planted.true_inertias(seed, 0.2)
    lighter = inertias.copy()
    lighter[link] *= 0.7
    result = found_lighter(inertias, lighter, seed)
    assert not result.findings
    (change,) = result.links
    assert (change.link, change.confidence) == (planted.model().body_names[link], "confident")
    sizes = {"mass": change.mass} if not change.moment else change.moment
    true = dict(zip(("mass", "m x", "m y", "m z"), lighter[link, :4] - inertias[link, :4], strict=True))
    for name, size in sizes.items():
        assert abs(size.value - true[name]) < 3.0 * size.std


def test_no_link_is_sure_in_whose_place_another_one_may_have_been_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workflow, "analyse", lambda *given: replace(analysis.analyse(*given), contested=0.25))
    inertias = planted.true_inertias(61, 0.2)
    lighter = inertias * np.array([[1.0], [1.0], [0.7]])
    (change,) = found_lighter(inertias, lighter, 61).links
    assert (change.link, change.confidence) == (planted.model().body_names[2], "tentative")


def test_no_link_is_sure_of_which_the_size_that_is_written_may_be_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def unsure(*given: Any) -> tuple[LinkChange, ...]:
        links = changed_links.changed_links(*given)
        return tuple(
            replace(link, mass=replace(link.mass, std=0.5 * abs(link.mass.value)), moment={}) for link in links
        )

    inertias = planted.true_inertias(61, 0.2)
    lighter = inertias * np.array([[1.0], [1.0], [0.7]])
    (sure,) = found_lighter(inertias, lighter, 61).links
    assert sure.confidence == "confident"
    monkeypatch.setattr(workflow, "changed_links", unsure)
    result = found_lighter(inertias, lighter, 61)
    assert not result.links
    np.testing.assert_allclose(result.gap.after, result.gap.before, rtol=0.01)


def test_a_gain_of_all_joints_is_no_payload() -> None:
    """Where it is known what the links weigh."""
    inertias = planted.true_inertias(51, 0.2)
    identifier = Identifier(planted.model())
    identifier.add(planted.recording(planted.rigid(inertias), 53))
    before = identifier.solve()
    rigid = planted.rigid(inertias)
    recordings = [
        planted.recording(lambda q, v, a: 1.12 * rigid(q, v, a), seed, seconds)
        for seed, seconds in ((52, 30.0), (1052, 15.0))
    ]
    known = {"nominal": before.parameters, "known": before.information}
    result = find_gap(planted.model(), recordings[:1], recordings[1:], **known)
    gains = {f.joint: f.parameters["gain"] for f in result.findings if f.effect == "effort_gain"}
    assert set(gains) == set(JOINTS)
    assert all(abs(gain.value - 1.12) < 4.0 * gain.std for gain in gains.values())
    assert not [f for f in result.findings if f.effect == "payload"]
    assert any("efforts of all joints 1.1" in sentence for sentence in in_short(result))


@pytest.mark.parametrize("seed", [54])
def test_a_payload_that_is_gone_is_no_other_effect(seed: int) -> None:
    """What the recordings with it said of the links contradicts those without: then it is worth little, and is not
    imitated by wrong sensors."""
    inertias = planted.true_inertias(seed, 0.2)
    identifier = Identifier(planted.model())
    identifier.add(planted.recording(planted.rigid(carrying(inertias)), seed))
    before = identifier.solve()
    without = planted.rigid(inertias)
    recordings = [planted.recording(without, seed + 500)], [planted.recording(without, seed + 1000, 15.0)]
    result = find_gap(planted.model(), *recordings, nominal=before.parameters, known=before.information)
    assert not [finding for finding in result.findings if finding.confidence == "confident"]
    assert np.max(result.gap.inertias_only) < 1.3


def test_a_link_is_heavier_by_a_payload_that_the_simulator_lacks_and_its_friction_is_no_gap() -> None:
    inertias = planted.true_inertias(61, 0.05)
    friction = np.array([0.0, 0.4, 0.0])
    twin_robot, robot = planted.rigid(inertias), planted.rigid(carrying(inertias))
    twin = planted.recording(lambda q, v, a: twin_robot(q, v, a) + friction * v, 61)
    train = planted.recording(lambda q, v, a: robot(q, v, a) + friction * v, 62)
    held_out = planted.recording(lambda q, v, a: robot(q, v, a) + friction * v, 1062, 15.0)
    result = find_gap(planted.model(), [train], [held_out], simulated=[twin])
    assert result.findings == ()
    (change,) = result.links
    assert (change.link, change.joint, change.confidence) == ("link3", "joint3", "confident")
    assert abs(change.mass.value - PAYLOAD) < 3.0 * change.mass.std
    assert change.mass.std < 0.1 * PAYLOAD
    assert "more than" in change.sentence


@pytest.mark.parametrize("identified", [False, True])
@pytest.mark.parametrize("still", [[1, 2]])
def test_of_joints_that_stand_exactly_still_nothing_is_said_and_of_the_others_what_is_true(
    still: list[int], identified: bool
) -> None:
    """Neither their positions nor their measured efforts ever change: they show no noise, and divide nothing by it."""
    inertias = planted.true_inertias(76, 0.03)
    robot, moves = planted.rigid(inertias), np.isin(np.arange(3), still, invert=True)

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return np.where(moves, robot(q, v, a) + 0.8 * v, 1.25)

    motion: dict[str, Any] = {"noise": planted.NOISE * moves, "size": 1.0 * moves, "posture": 0.4}
    train, held_out = (planted.recording(efforts, seed, **motion) for seed in (76, 1076))
    assert np.all(np.ptp(train.position[:, still], axis=0) == 0.0)
    with np.errstate(divide="raise", invalid="raise"):
        result = find_gap(planted.model(), [train], [held_out], nominal=inertias.ravel() if identified else None)
    sure = {(finding.effect, finding.joint) for finding in result.sure}
    assert sure == {("viscous_friction", JOINTS[joint]) for joint in np.flatnonzero(moves)}
    assert not {finding.joint for finding in result.findings} & {JOINTS[joint] for joint in still}
    for found in (result.floor, result.gap.after, result.moving):
        np.testing.assert_array_equal(np.isfinite(found), moves)


def test_friction_that_has_grown_is_named_with_what_it_was() -> None:
    """It is no payload, gain or delay, and the friction that has not changed is not named."""
    inertias = planted.true_inertias(71, 0.03)
    robot = planted.rigid(inertias)
    model = MeasurementModel(planted.model().robot, [ViscousFriction()])
    before, now = np.array([0.3, 0.5, 0.2]), np.array([0.3, 0.8, 0.2])
    nominal = np.concatenate([inertias.ravel(), before])
    train = planted.recording(lambda q, v, a: robot(q, v, a) + now * v, 71)
    held_out = planted.recording(lambda q, v, a: robot(q, v, a) + now * v, 1071, 15.0)
    result = find_gap(model, [train], [held_out], nominal=nominal)
    (finding,) = result.findings
    assert (finding.effect, finding.joint, finding.confidence) == ("viscous_friction", JOINTS[1], "confident")
    size = finding.parameters["coefficient"]
    assert finding.was == {"coefficient": 0.5}
    assert abs(size.value - 0.8) < 4.0 * size.std
    assert "instead of 0.5" in finding.sentence
    unchanged = np.delete(result.coefficients, 1)
    np.testing.assert_allclose(unchanged, np.delete(before, 1), rtol=0.1)
    assert np.isnan(result.coefficients[1])


def test_dry_friction_that_has_grown_keeps_the_shape_that_the_model_has() -> None:
    """At a speed that is none of those to choose from."""
    inertias = planted.true_inertias(72, 0.03)
    robot = planted.rigid(inertias)
    stribeck = StribeckFriction(0.31)
    model = MeasurementModel(planted.model().robot, (), local_effects={JOINTS[1]: stribeck.parts})
    shape = np.array([1.0, 0.6])  # of the level: it, and what there is more near standstill
    nominal = np.append(inertias.ravel(), 0.4 * shape)

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        whole = robot(q, v, a)
        speed = v[:, 1]
        whole[:, 1] += 0.7 * (1.0 + 0.6 * np.exp(-((speed / 0.31) ** 2))) * np.tanh(speed / 0.02)
        return whole

    recordings = [planted.recording(efforts, 72)], [planted.recording(efforts, 1072, 15.0)]
    (finding,) = find_gap(model, *recordings, nominal=nominal).findings
    assert (finding.effect, finding.joint, finding.confidence) == ("stribeck_friction", JOINTS[1], "confident")
    assert finding.was["speed"] == 0.31
    for name, value in zip(("level", "excess"), 0.7 * shape, strict=True):
        assert abs(finding.parameters[name].value - value) < 3.0 * finding.parameters[name].std


def test_friction_in_proportion_to_the_effort_is_of_that_of_other_friction_too() -> None:
    """At an axis that gravity does not load most of what a gear transmits is friction behind it."""
    inertias = planted.true_inertias(73, 0.03)
    robot = planted.rigid(inertias)
    model = MeasurementModel(planted.model().robot, [ViscousFriction()])
    viscous = np.array([1.5, 0.3, 0.2])

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        passed = robot(q, v, a) + viscous * v
        return passed + np.array([0.2, 0.0, 0.0]) * np.abs(passed) * np.sign(v)

    recordings = [planted.recording(efforts, 73)], [planted.recording(efforts, 1073, 15.0)]
    result = find_gap(model, *recordings, nominal=np.append(inertias.ravel(), viscous))
    (finding,) = [f for f in result.findings if f.confidence == "confident"]
    assert (finding.effect, finding.joint) == ("load_friction", JOINTS[0])
    size = finding.parameters["coefficient"]
    assert abs(size.value - 0.2) < 3.0 * size.std < 0.06


@pytest.mark.parametrize("delay", [0.0, 0.015])
def test_friction_that_follows_reversals_late_is_no_delay(delay: float) -> None:
    """As bristles that bend first: it lags by some 20 ms, what the rigid bodies need does not."""
    inertias = planted.true_inertias(81, 0.05)
    robot = planted.rigid(inertias)

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        share = 1.0 - np.exp(-1.0 / (0.02 * planted.RATE))
        late = lfilter([share], [1.0, share - 1.0], np.sign(v), axis=0)
        times = np.arange(len(q)) / planted.RATE
        whole = CubicSpline(times, robot(q, v, a) + 0.5 * late)
        return np.asarray(whole(times - delay))

    result = find_gap(planted.model(), [planted.recording(efforts, 81)], [planted.recording(efforts, 1081, 15.0)])
    found = [f.parameters["delay"].value for f in result.findings if f.effect == "effort_delay"]
    assert np.allclose(found, [delay] if delay else [], atol=2e-3), found


@pytest.mark.parametrize("seed", [81])
def test_a_long_delay_is_found_beside_what_has_no_name(seed: int) -> None:
    """What is common to all joints is no part of what each lacks."""
    robot, delay = planted.rigid(planted.true_inertias(seed, 0.2)), -0.12

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        lacking = np.sin(9.0 * q + 1.0) + np.sin(3.0 * q[:, [1, 2, 0]])
        whole = robot(q, v, a) + 0.5 * np.tanh(v / 0.02) + 0.1 * lacking
        times = np.arange(len(q)) / planted.RATE
        return np.asarray(CubicSpline(times, whole)(times - delay))

    train, unseen = planted.recording(efforts, seed), planted.recording(efforts, seed + 1000, 15.0)
    result = find_gap(planted.model(), [train], [unseen])
    (found,) = [f for f in result.sure if f.effect == "effort_delay"]
    assert found.parameters["delay"].value == pytest.approx(delay, abs=2e-3)


@pytest.mark.parametrize("seed", [21])
def test_three_seconds_are_enough_for_what_is_plain(seed: int) -> None:
    """And what so short a recording cannot tell is not claimed."""
    for extra, expected in ((PLANTED["viscous_friction"], [("viscous_friction", JOINTS[1])]), (lambda *_: 0.0, [])):
        efforts = beside(seed, extra, 1)
        recordings = [planted.recording(efforts, each, seconds=3.0) for each in (seed, seed + 1000)]
        found = find_gap(planted.model(), recordings[:1], recordings[1:])
        assert [(finding.effect, finding.joint) for finding in found.findings] == expected
        assert np.all(np.isfinite(found.floor))
