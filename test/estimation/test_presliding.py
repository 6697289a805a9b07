"""Dahl's law, integrated along a motion, comes back as dry friction with presliding."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from geomid_ros.model.effects import JointMotion
from geomid_ros.model.effects import Motion as WithPast
from geomid_ros.model.effects.friction import (
    DISTANCES,
    SMOOTHINGS,
    CoulombFriction,
    Presliding,
)
from geomid_ros.model.effects.situation import AtJoint
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Entries, JointColumn, Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.types import FloatArray

from .arms import Case, Motion, arm, efforts, samples, solved

JOINT, NOISE = 1, 0.2
DRY = CoulombFriction(SMOOTHINGS[0])


def dahl(position: FloatArray, distance: float) -> FloatArray:
    """The share ``(N,)`` of dry friction that a joint has, from no friction on: dz/dq = (1 - z sign(q')) / distance."""
    shares = np.zeros(len(position))
    for place, step in enumerate(np.diff(position), 1):
        way = np.sign(step)
        shares[place] = way + (shares[place - 1] - way) * np.exp(-abs(step) / distance)
    return shares


@pytest.mark.parametrize("distance", DISTANCES)
def test_after_a_reversal_it_is_dahls_law(distance: float) -> None:
    """A joint that slides one way comes to rest and speeds up the other way, with one acceleration."""
    time = np.linspace(-1.0, 1.0, 20001)
    position = 0.5 * time**2
    motion = JointMotion(np.array([position, time, np.ones_like(time)]))
    law = DRY.column(motion) + Presliding(distance).column(motion)
    there = (time > -0.5) & (np.abs(time) > 10.0 * SMOOTHINGS[0])  # it slides, and beside rest the sign is smooth
    np.testing.assert_allclose(law[there], dahl(position, distance)[there], atol=0.01)


@pytest.mark.parametrize("distance", DISTANCES)
def test_what_it_remembers_is_dahls_law_also_at_rest(distance: float) -> None:
    """In whichever pieces a motion comes that turns round halfway and stops: its friction stays at rest."""
    time = np.linspace(0.0, 3.0, 301)
    position = np.where(time < 2.0, np.sin(2.0 * time), np.sin(4.0))[:, None] + 1e-3 * np.arange(3)
    moved, own, states = np.diff(position, axis=0, prepend=position[:1]), Presliding(distance), [np.zeros((1, 3))]
    for begin, end in ((0, 1), (1, 100), (100, 301)):
        states.append(own.states([own], moved[begin:end], states[-1][-1:])[:, 0])
    remembered = np.concatenate(states[1:])
    np.testing.assert_allclose(remembered[:, 0], dahl(position[:, 0], distance), atol=1e-12)
    still = WithPast(np.zeros((3, 1, 2)), past={own: np.array([[0.5, remembered[-1, 0]]])})
    efforts_at_rest = own.efforts(still, AtJoint(1))
    assert efforts_at_rest == pytest.approx(np.array([[0.0, -1.0]]), abs=0.01), "it came from above"


def test_it_is_found_with_the_level_of_dry_friction() -> None:
    case = arm("arm3", 0, noise=0.02)
    level, distance = case.true.effects["coulomb_friction"][JOINT], DISTANCES[-1]
    efforts = case.samples.effort.copy()
    efforts[:, JOINT] -= level * np.tanh(case.samples.velocity[:, JOINT] / 0.02)
    efforts[:, JOINT] += level * dahl(case.samples.position[:, JOINT], distance)
    model = MeasurementModel(case.model.robot, case.effects, candidates=Configuration().candidates)
    planted = replace(case.with_efforts(efforts), model=model)
    found = [effect for effect in solved(planted).effects if effect.name == "presliding"]
    assert [(effect.joint, effect.parameters["distance"].value) for effect in found] == [("joint2", distance)]
    assert found[0].value == pytest.approx(level, rel=0.05)


def point_to_point(seed: int, joints: int) -> Motion:
    """.3 seconds from one place to the next, .7 seconds of rest there."""
    rng, phase = np.random.default_rng(seed), np.linspace(0.0, 1.0, 31)[:-1]
    way = np.concatenate([phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2), np.ones(70)])
    places = rng.uniform(-1.0, 1.0, (31, joints))
    position = np.concatenate([a + (b - a) * way[:, None] for a, b in pairwise(places)])
    velocity = np.gradient(position, 0.01, axis=0)
    return Motion(position, velocity, np.gradient(velocity, 0.01, axis=0))


def remembered(case: Case, moving: Motion, distance: float) -> Samples:
    """Samples of a robot whose dry friction is Dahl's, with what presliding remembers."""
    level, own = case.true.effects["coulomb_friction"], [Presliding(each) for each in DISTANCES]
    dry = np.stack([dahl(position, distance) for position in moving.position.T], axis=1)
    others = {name: sizes for name, sizes in case.true.effects.items() if name != "coulomb_friction"}
    felt = efforts(case.model.robot, replace(case.true, effects=others), moving) + level * dry
    moved = np.diff(moving.position, axis=0, prepend=moving.position[:1])
    past = {effect: effect.states([effect], moved, np.zeros((1, moved.shape[1])))[:, 0] for effect in own}
    entries = Entries(tuple(JointColumn(effect) for effect in own), moved.shape[1])
    states = WithPast(np.array([moving.position, moving.velocity, moving.acceleration]), past)
    noise = NOISE * np.random.default_rng(1).normal(size=felt.shape)
    return replace(samples(moving, felt + noise), effects=entries.values(states), entries=entries)


def test_a_joint_that_comes_to_rest_keeps_its_friction() -> None:
    """It is told by rest, too: what is left on another motion is little more than the noise."""
    case, distance = arm("arm3", 0), 1e-2
    model = MeasurementModel(case.model.robot, case.effects, candidates=Configuration().candidates)
    seen, unseen = (remembered(case, point_to_point(seed, 3), distance) for seed in (1, 2))
    found = solved(replace(case, model=model, samples=seen))
    kept = {effect.joint: effect for effect in found.effects if effect.name == "presliding"}
    assert set(kept) == set(model.robot.joint_names)
    for level, effect in zip(case.true.effects["coulomb_friction"], kept.values(), strict=True):
        assert effect.value == pytest.approx(level, rel=0.1)
    exact, predicted = model.predict(unseen, found.parameters)
    assert np.all(np.std(predicted - exact, axis=0) < 1.2 * NOISE)
