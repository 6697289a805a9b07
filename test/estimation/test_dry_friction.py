"""Dry friction drives no joint, whatever the rows say; and how sure friction is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.estimation.estimate import STDS_OF_95, Estimate
from geomid_ros.model.effects.effect import FRICTION_DRIFT
from geomid_ros.model.effects.friction import CoulombFriction, SaturatingFriction, StribeckFriction, ViscousFriction
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.session.configuration import Configuration

from .arms import Case, Truth, arm, efforts, solved

JOINT, SPEED = 1, 0.12  # the joint with the planted friction; [rad/s] over which it sets in


def sets_in(share: float, within: float = SPEED, pace: float = 1.0) -> Case:
    """An arm one of whose joints has, beside standstill, 1 + ``share`` of the dry friction that it has when fast; in a
    motion of ``pace`` times the speed."""
    case = arm("arm3", 0, noise=0.02)
    usual = case.samples
    moving = replace(usual, velocity=pace * usual.velocity, acceleration=pace**2 * usual.acceleration)
    change = efforts(case.model.robot, case.true, moving) - efforts(case.model.robot, case.true, usual)
    level, speed = case.true.effects["coulomb_friction"][JOINT], moving.velocity[:, JOINT]
    measured = usual.effort + change
    measured[:, JOINT] += share * level * np.tanh(speed / 0.02) * np.exp(-((speed / within) ** 2))
    model = MeasurementModel(case.model.robot, case.effects, candidates=Configuration().candidates)
    return replace(case, samples=replace(moving, effort=measured), model=model)


def friction(found: Estimate) -> tuple[float, float]:
    """Level and excess at the joint."""
    own = {effect.name: effect.value for effect in found.effects if effect.joint == "joint2"}
    return own["coulomb_friction"], own.get("stribeck_friction", 0.0)


@pytest.mark.parametrize("objective", ["residual", "geodesic"])
def test_friction_that_would_drive_sets_in_gradually(objective: str) -> None:
    """There is no excess below zero, which Stribeck never meant."""
    found = solved(sets_in(-2.0), objective=objective)
    assert all(effect.value >= 0.0 for effect in found.effects if effect.name != "effort_offset")
    assert friction(found)[1] == 0.0


def test_friction_that_sticks_is_as_measured() -> None:
    level, excess = friction(solved(sets_in(1.0)))
    assert excess == pytest.approx(level, rel=0.1)


@pytest.mark.parametrize(
    ("within", "pace", "speeds"),
    [(0.08, 0.3, (0.0849,)), (0.16, 0.3, (0.12, 0.1697)), (0.2, 0.2, (0.1697, 0.24))],
)
def test_friction_that_sticks_is_found_between_the_speeds_that_are_tried(
    within: float, pace: float, speeds: tuple[float, ...]
) -> None:
    """Another shape of the dry friction beside it, in which nothing falls, would follow the rows better. Slow motion
    hardly tells viscous friction from another speed: its interval holds the truth. The size of the excess is for the
    stated speed."""
    effects = solved(sets_in(1.0, within, pace)).effects
    own = {effect.name: effect for effect in effects if effect.joint == "joint2"}
    viscous, excess = own["viscous_friction"], own["stribeck_friction"]
    assert excess.parameters["speed"].value in speeds
    true = arm("arm3", 0, noise=0.02).true.effects["viscous_friction"][JOINT]
    assert abs(viscous.value - true) < STDS_OF_95 * viscous.std < 2.0 * true
    assert excess.std**2 < (StribeckFriction.drift**2 + 0.1**2) * excess.value**2


@pytest.mark.parametrize(
    ("level", "smoothing", "excess", "speed", "made_up", "falls"),
    [
        (1.0, 0.003, 0.3, SPEED, 0.0, True),
        (1.0, 0.003, 0.19, SPEED, 0.0, False),
        (1.0, 0.02, 3.0, SPEED, 0.0, True),
        (0.6, 0.003, 0.4, SPEED, 0.5, False),
        (5.0, 0.06, 1.0, 0.06, 0.0, False),
    ],
)
def test_stribeck_friction_is_friction_that_falls(
    level: float, smoothing: float, excess: float, speed: float, made_up: float, falls: bool
) -> None:
    """Its excess may make up for friction that sets in with speed, or for another shape near rest: then it is none.
    Nor is one that is smaller than the drift of the dry friction."""
    own = StribeckFriction(speed)
    dry = {CoulombFriction(smoothing): level, own: excess, SaturatingFriction(0.15): made_up}
    assert own.is_supported({**dry, ViscousFriction(): 9.0}) == falls


def test_friction_that_noise_hides_is_not_known_to_be_nothing() -> None:
    """The deviation of a logarithm would be a share of next to nothing. None is smaller than that of the least squares
    of the friction's column alone."""
    for seed in range(2):
        case = arm("arm3", seed, seconds=5.0, noise=0.0)
        small = Truth(case.true.links, {**case.true.effects, "viscous_friction": np.full(3, 0.02)})
        clean = efforts(case.model.robot, small, case.samples)
        noise = np.random.default_rng(100 + seed).normal(size=clean.shape)
        least = 1.0 / np.linalg.norm(case.samples.velocity, axis=0)
        for effect in solved(case.with_efforts(clean + noise)).effects:
            if effect.name == "viscous_friction":
                assert effect.std > 0.8 * least[case.model.robot.joint_names.index(effect.joint)]


def test_friction_that_drifts_between_two_recordings_is_within_what_both_say() -> None:
    """Each recording is of other friction, by the drift that robots have; nothing else of the robot changes."""
    apart = []
    for seed in range(8):
        drift, told = np.random.default_rng(seed), []
        case = arm("arm3", seed, seconds=5.0, noise=0.0)
        for _ in range(2):
            own = {
                name: c * drift.normal(1.0, FRICTION_DRIFT, 3) if "friction" in name else c
                for name, c in case.true.effects.items()
            }
            clean = efforts(case.model.robot, Truth(case.true.links, own), case.samples)
            told.append(solved(case.with_efforts(clean + drift.normal(0.0, 0.01, clean.shape))).effects)
        for first, second in zip(*told, strict=True):
            if "friction" in first.name:
                apart.append(abs(first.value - second.value) / np.hypot(first.std, second.std))
    assert 0.88 < np.mean(np.array(apart) < STDS_OF_95) < 0.99


def test_what_does_not_drift_is_as_sure_as_its_recording() -> None:
    case = arm("arm3", 0, seconds=10.0, noise=0.001)
    for effect in solved(case).effects:
        if "friction" in effect.name:
            assert FRICTION_DRIFT * effect.value <= effect.std < 1.1 * FRICTION_DRIFT * effect.value
        else:
            assert effect.std < 0.01 * max(abs(effect.value), 1.0)
