"""Two recordings, one with a planted payload: the payload is found with an interval that holds it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from estimation.arms import Motion, efforts, motion, samples, shipped, truth

from geomid_ros.exports.payload import identify_payload_at
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.live.searches import look_for_gap
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.options import silent
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.payload import WeighedPayload, identify_payload
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, AcceptedMessages
from geomid_ros.types import FloatArray

NOISE = 0.05
MASS, COM = 1.3, np.array([0.02, -0.03, 0.08])
INERTIA = np.diag([4e-3, 5e-3, 3e-3])


def session() -> Session:
    return Session(shipped("arm3"), Configuration({"candidates": []}), "arm3.urdf")


def measured(seed: int, payload: bool, seconds: float, gain: float = 1.0) -> tuple[Motion, FloatArray]:
    """A motion, another for each seed, and the efforts of one robot, the same for all."""
    robot = Robot(shipped("arm3"))
    true = truth(np.random.default_rng(5), robot)
    if payload:
        true.links[-1] += pseudo_inertia.assemble(np.array(MASS), COM, INERTIA)
    rng = np.random.default_rng([seed, payload])
    moving = motion(rng, len(robot.joints), seconds)
    clean = gain * efforts(robot, true, moving)
    return moving, clean + NOISE * rng.normal(size=clean.shape)


def recording(seed: int, payload: bool, gain: float = 1.0) -> Samples:
    """Twenty seconds."""
    return samples(*measured(seed, payload, 20.0, gain))


def recording_of_the_last_joint(seed: int) -> Samples:
    """With the payload, whose joint alone moves and is measured."""
    robot = Robot(shipped("arm3"))
    true = truth(np.random.default_rng(5), robot)
    true.links[-1] += pseudo_inertia.assemble(np.array(MASS), COM, INERTIA)
    rng = np.random.default_rng(seed)
    moving = motion(rng, len(robot.joints), 20.0)
    last = np.arange(len(robot.joints)) == len(robot.joints) - 1
    held = Motion(np.where(last, moving.position, 0.7), moving.velocity * last, moving.acceleration * last)
    clean = efforts(robot, true, held) + NOISE * rng.normal(size=moving.position.shape)
    return samples(held, np.where(last, clean, np.nan))


def weighed(seed: int, gain: float = 0.0, true_gain: float = 1.0) -> WeighedPayload:
    link = session().model.body_names[-1]
    return identify_payload(
        session(), [recording(seed, False, true_gain)], [recording(seed, True, true_gain)], link, gain
    )


def test_on_the_trunk_it_is_known_no_better_than_the_robots_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which differs between two recordings as accelerometers do along gravity; the first moment does not."""
    recordings = [recording(1, False)], [recording(1, True)]
    own, share = session(), 0.02
    link = own.model.body_names[-1]
    monkeypatch.setattr(Session, "relative_mass_std", share)
    known = identify_payload(own, *recordings, link)
    own.robot.tree = replace(own.robot.tree, root=link)
    found = identify_payload(own, *recordings, link)
    robot = sum(body.parameters[0] for body in own.robot.bodies)
    assert np.sqrt(found.std[0] ** 2 - known.std[0] ** 2) == pytest.approx(share * robot, rel=0.2)
    np.testing.assert_array_equal(found.moment_std, known.moment_std)


def test_a_planted_payload_is_found_within_its_deviations() -> None:
    expected = pseudo_inertia.quantities_of(pseudo_inertia.assemble(np.array(MASS), COM, INERTIA))
    off = np.array([(found.quantities - expected) / found.std for found in map(weighed, range(6))])
    assert np.mean(np.abs(off) < 1.96) > 0.8
    assert np.max(np.abs(off[:, 0])) < 4.0
    assert abs(weighed(0).mass - MASS) < 0.05 * MASS


def test_recordings_in_the_wrong_order_are_doubted() -> None:
    """Not those that carry the same."""
    link = session().model.body_names[-1]
    for before, after in ((True, False), (False, False), (True, True)):
        found = identify_payload(session(), [recording(1, before)], [recording(2, after)], link)
        doubts = [reason for reason in found.verdict.reasons if "swapped?" in reason]
        assert (found.verdict.word, len(doubts)) == (("doubtful", 1) if before > after else ("usable", 0))


def weighed_beside(estimate_of: Samples, seed: int) -> WeighedPayload:
    """Weighed by the recording with the payload and what an estimate without it told."""
    bare = session()
    bare.identifier.add(estimate_of)
    known = bare.identifier.solve().posterior
    return identify_payload(session(), known, [recording(seed, True)], bare.model.body_names[-1], 0.0)


def test_an_earlier_estimate_tells_as_much_as_its_recording() -> None:
    expected = pseudo_inertia.quantities_of(pseudo_inertia.assemble(np.array(MASS), COM, INERTIA))
    both, beside = weighed(1), weighed_beside(recording(1, False), 1)
    assert beside.mass == pytest.approx(both.mass, abs=2.0 * max(both.std[0], beside.std[0]))
    assert beside.std[0] < 3.0 * both.std[0]
    assert np.mean(np.abs(beside.quantities - expected) < 3.0 * beside.std) > 0.8


def test_a_payload_that_is_hardly_told_can_exist() -> None:
    """Half a second of motion: whatever is not told, the payload stays a body."""
    found = weighed_beside(recording(0, False), 0)
    short = recording(0, True).select(np.arange(2000) < 50)
    bare = session()
    bare.identifier.add(recording(0, False))
    little = identify_payload(session(), bare.identifier.solve().posterior, [short], bare.model.body_names[-1], 0.0)
    assert pseudo_inertia.is_body(pseudo_inertia.parameters_of(little.quantities))
    assert little.std[0] > found.std[0]


def test_of_a_payload_whose_mass_is_not_told_the_first_moment_is() -> None:
    """One joint that turns against gravity tells it, but for the part along its axis."""
    bare = session()
    bare.identifier.add(recording(0, False))
    known, link = bare.identifier.solve().posterior, bare.model.body_names[-1]
    found = [identify_payload(session(), known, [recording_of_the_last_joint(seed)], link, 0.0) for seed in range(6)]
    off = np.array([(one.moment - MASS * COM) / one.moment_std for one in found])
    assert np.max(np.abs(off)) < 3.5
    assert all(one.only_moment_identified for one in found)
    assert not weighed(0).only_moment_identified
    (sure,) = [identify_payload(session(), known, [recording_of_the_last_joint(0)], link, 0.1)]
    assert np.all(sure.moment_std[[0, 2]] > found[0].moment_std[[0, 2]])


def test_what_is_not_told_is_not_said_first() -> None:
    bare = session()
    bare.identifier.add(recording(0, False))
    known = bare.identifier.solve().posterior
    untold = identify_payload_at(session(), known, [recording_of_the_last_joint(0)], "tool", 0.0)
    assert re.match(
        r"m x 0\.026\S* ± 0\.00\S*, m y .*, m z 0\.10\S* ± .* kg m \(95 %\) in 'link3'; these motions do not",
        untold.sentence,
    )
    assert untold.document["moment"]["value"] == untold.weighed.moment.tolist()
    assert re.match(
        r"1\.[23]\d* kg, from", identify_payload_at(session(), known, [recording(0, True)], "tool", 0.0).sentence
    )


def test_the_link_that_is_taken_where_no_flange_is_named_is_said_once() -> None:
    known = session()
    known.identifier.add(recording(0, False))
    posterior, loaded = known.identifier.solve().posterior, [recording(0, True)]
    assumed, named = (identify_payload_at(session(), posterior, loaded, frame).document for frame in ("", "link3"))
    (note,) = assumed["notes"]
    assert "--frame" in note
    assert "at 'link3', the last moving link" in note
    assert not named["notes"]
    assert assumed["quantities"] == named["quantities"]


def test_gains_of_single_joints_are_in_the_deviations() -> None:
    """One joint's gain moves the centre of mass; a gain of all moves the mass alone, one to one."""
    sure, unsure = weighed(2, 0.0), weighed(2, 0.05)
    assert np.all(unsure.std >= sure.std)
    assert np.any(unsure.std[1:4] > 1.5 * sure.std[1:4])
    assert np.hypot(sure.std[0], 0.05 * sure.mass) <= 1.01 * unsure.std[0]
    assert sure.quantities.tolist() == unsure.quantities.tolist()


def messages(seed: int, payload: bool) -> list[AcceptedMessages]:
    """A minute, as a node accepts it."""
    moving, effort = measured(seed, payload, 60.0)
    stamps = 10_000_000 * np.arange(1, len(effort) + 1)
    return [AcceptedMessages(JOINT_STATES, stamps, np.hstack([moving.position, moving.velocity, effort]))]


def heard(own: Session, accepted: list[AcceptedMessages]) -> Samples:
    pipeline = own.new_pipeline()
    for each in accepted:
        pipeline.push_accepted(each)
    found = pipeline.collect()
    assert found is not None
    return found


def test_gap_says_the_same_of_it() -> None:
    """Within the deviations of both, which share the noise of the loaded recording."""
    own, empty, loaded = session(), messages(0, False), messages(0, True)
    own.identifier.add(heard(own, empty))
    estimate = own.identifier.solve()
    found = identify_payload(session(), estimate.posterior, [heard(own, loaded)], own.model.body_names[-1], 0.0)
    (named,) = look_for_gap(own, estimate, empty, loaded, silent).result.findings
    assert (named.effect, named.link, named.confidence) == ("payload", found.link, "confident")
    mass = named.parameters["mass"]
    assert abs(mass.value - found.mass) < 2.0 * np.hypot(mass.std, found.std[0])
    for axis, moment, std in zip("xyz", found.moment, found.moment_std, strict=True):
        centre = named.parameters[f"com_{axis}"]
        unsure = np.hypot(mass.value * centre.std, centre.value * mass.std)
        assert abs(mass.value * centre.value - moment) < 2.0 * np.hypot(unsure, std)
