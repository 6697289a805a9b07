"""Two recordings, one with a planted payload: the payload is found with an interval that holds it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from estimation.arms import Motion, efforts, motion, samples, shipped, truth

from geomid_ros.estimation.posterior import Posterior
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
TRUE = pseudo_inertia.quantities_of(pseudo_inertia.assemble(np.array(MASS), COM, INERTIA))
LINK = "link3"  # that carries it


def session() -> Session:
    return Session(shipped("arm3"), Configuration({"candidates": []}), "arm3.urdf")


@cache
def measured(seed: int, payload: bool, seconds: float = 20.0, last: bool = False) -> tuple[Motion, FloatArray]:
    """A motion, another for each seed, and the efforts of one robot, the same for all. Of the ``last`` joint alone, all
    others rest and are not measured."""
    robot = Robot(shipped("arm3"))
    true = truth(np.random.default_rng(5), robot)
    if payload:
        true.links[-1] += pseudo_inertia.assemble(np.array(MASS), COM, INERTIA)
    rng = np.random.default_rng([seed, payload])
    moving = motion(rng, len(robot.joints), seconds)
    moves = np.arange(len(robot.joints)) >= last * (len(robot.joints) - 1)
    held = Motion(np.where(moves, moving.position, 0.7), moving.velocity * moves, moving.acceleration * moves)
    clean = efforts(robot, true, held)
    return held, np.where(moves, clean + NOISE * rng.normal(size=clean.shape), np.nan)


@cache
def recording(seed: int, payload: bool, last: bool = False) -> Samples:
    return samples(*measured(seed, payload, last=last))


@cache
def weighed(seed: int, gain: float = 0.0) -> WeighedPayload:
    return identify_payload(session(), [recording(seed, False)], [recording(seed, True)], LINK, gain)


@cache
def known(seed: int = 0) -> Posterior:
    """What an estimate without the payload told."""
    bare = session()
    bare.identifier.add(recording(seed, False))
    return bare.identifier.solve().posterior


def beside(seed: int, loaded: Samples, gain: float = 0.0) -> WeighedPayload:
    """Weighed by a recording with the payload and such an estimate."""
    return identify_payload(session(), known(seed), [loaded], LINK, gain)


def test_on_the_trunk_it_is_known_no_better_than_the_robots_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which is off in either recording as its accelerometer is along gravity; the first moment is not."""
    recordings = [recording(1, False)], [recording(1, True)]
    own, share = session(), 0.02
    monkeypatch.setattr(Session, "relative_mass_std", share)
    elsewhere = identify_payload(own, *recordings, LINK, 0.0)
    own.robot.tree = replace(own.robot.tree, root=LINK)
    found = identify_payload(own, *recordings, LINK, 0.0)
    robot = sum(body.parameters[0] for body in own.robot.bodies)
    assert np.sqrt(found.std[0] ** 2 - elsewhere.std[0] ** 2) == pytest.approx(np.sqrt(2.0) * share * robot, rel=0.2)
    np.testing.assert_array_equal(found.moment_std, elsewhere.moment_std)


def test_a_planted_payload_is_found_within_its_deviations() -> None:
    off = np.array([(found.quantities - TRUE) / found.std for found in map(weighed, range(6))])
    assert np.mean(np.abs(off) < 1.96) > 0.8
    assert np.max(np.abs(off[:, 0])) < 4.0
    assert abs(weighed(0).mass - MASS) < 0.05 * MASS


def test_recordings_in_the_wrong_order_are_doubted() -> None:
    """Not those that carry the same."""
    for before, after in ((True, False), (False, False), (True, True)):
        found = identify_payload(session(), [recording(1, before)], [recording(2, after)], LINK, 0.0)
        doubts = [reason for reason in found.verdict.reasons if "swapped?" in reason]
        assert (found.verdict.word, len(doubts)) == (("doubtful", 1) if before > after else ("usable", 0))


def test_an_earlier_estimate_tells_as_much_as_its_recording() -> None:
    """And where half a second of motion hardly tells anything, the payload stays a body."""
    both, one = weighed(1), beside(1, recording(1, True))
    assert one.mass == pytest.approx(both.mass, abs=2.0 * max(both.std[0], one.std[0]))
    assert one.std[0] < 3.0 * both.std[0]
    assert np.mean(np.abs(one.quantities - TRUE) < 3.0 * one.std) > 0.8
    little = beside(1, recording(1, True).select(np.arange(2000) < 50))
    assert pseudo_inertia.is_body(pseudo_inertia.parameters_of(little.quantities))
    assert little.std[0] > one.std[0]


def test_of_a_payload_whose_mass_is_not_told_the_first_moment_is() -> None:
    """One joint that turns against gravity tells it, but for the part along its axis."""
    found = [beside(0, recording(seed, True, last=True)) for seed in range(2)]
    off = np.array([(one.moment - MASS * COM) / one.moment_std for one in found])
    assert np.max(np.abs(off)) < 3.5
    assert all(one.only_moment_identified for one in found)
    assert not weighed(0).only_moment_identified
    unsure = beside(0, recording(0, True, last=True), 0.1)
    assert np.all(unsure.moment_std[[0, 2]] > found[0].moment_std[[0, 2]])


def test_what_is_not_told_is_not_said_first() -> None:
    """And the link that is taken where no flange is named is said once."""
    untold = identify_payload_at(session(), known(), [recording(0, True, last=True)], "tool", 0.0)
    told = identify_payload_at(session(), known(), [recording(0, True)], "", 0.0)
    moments = r"m x 0\.0[23]\S* ± 0\.00\S*, m y .*, m z 0\.1\S* ± .* kg m \(95 %\) in 'link3'; these motions do not"
    assert re.match(moments, untold.sentence)
    assert untold.document["moment"]["value"] == untold.weighed.moment.tolist()
    assert re.match(r"1\.[23]\d* kg, from", told.sentence)
    (note,) = told.document["notes"]
    assert "--frame" in note
    assert "at 'link3', the last moving link" in note
    assert not untold.document["notes"]


@pytest.mark.parametrize("empty", [known, lambda: [recording(0, False)]])
def test_nothing_carried_is_said_with_what_it_may_weigh_at_most(empty: Callable[[], Posterior | list[Samples]]) -> None:
    """The data's own bound, some of their standard deviations: the prior of a tiny mass allows a hundred times it."""
    found = identify_payload_at(session(), empty(), [recording(1, False)], "tool")
    assert re.fullmatch(r"no load is identified at 'tool': less than 0\.0\d+ kg \(95 %\)", found.sentence)
    low, high = found.document["interval"]
    assert low == 0.0 < high < found.weighed.mass + 4.0 * weighed(1).std[0]
    assert found.document["summary"] == found.sentence


def test_gains_of_single_joints_are_in_the_deviations() -> None:
    """One joint's gain moves the centre of mass; a gain of all moves the mass alone, one to one."""
    sure, unsure = weighed(2, 0.0), weighed(2, 0.05)
    assert np.all(unsure.std >= sure.std)
    assert np.any(unsure.std[1:4] > 1.5 * sure.std[1:4])
    assert np.hypot(sure.std[0], 0.05 * sure.mass) <= 1.01 * unsure.std[0]
    assert sure.quantities.tolist() == unsure.quantities.tolist()


def messages(seed: int, payload: bool) -> list[AcceptedMessages]:
    """Half a minute, as a node accepts it."""
    moving, effort = measured(seed, payload, 30.0)
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
    found = identify_payload(session(), estimate.posterior, [heard(own, loaded)], LINK, 0.0)
    (named,) = look_for_gap(own, estimate, empty, loaded, silent).result.findings
    assert (named.effect, named.link, named.confidence) == ("payload", found.link, "confident")
    mass = named.parameters["mass"]
    assert abs(mass.value - found.mass) < 2.0 * np.hypot(mass.std, found.std[0])
    for axis, moment, std in zip("xyz", found.moment, found.moment_std, strict=True):
        centre = named.parameters[f"com_{axis}"]
        unsure = np.hypot(mass.value * centre.std, centre.value * mass.std)
        assert abs(mass.value * centre.value - moment) < 2.0 * np.hypot(unsure, std)
