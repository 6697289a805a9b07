"""Dry friction drives no joint, whatever the rows say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.estimation.estimate import STDS_OF_95, Estimate
from geomid_ros.gap.candidates import EffectTerm, passivity_constraints
from geomid_ros.model.effects import AtJoint
from geomid_ros.model.effects.drive import Spring
from geomid_ros.model.effects.friction import CoulombFriction, SaturatingFriction, StribeckFriction, ViscousFriction
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.session.configuration import Configuration

from .arms import Case, arm, solved

JOINT, SPEED = 1, 0.12  # the joint with the planted friction; [rad/s] over which it sets in


def sets_in(share: float, within: float = SPEED) -> Case:
    """An arm one of whose joints has, beside standstill, 1 + ``share`` of the dry friction that it has when fast."""
    case = arm("arm3", 0, noise=0.02)
    level = case.true.effects["coulomb_friction"][JOINT]
    speed = case.samples.velocity[:, JOINT]
    efforts = case.samples.effort.copy()
    efforts[:, JOINT] += share * level * np.tanh(speed / 0.02) * np.exp(-((speed / within) ** 2))
    model = MeasurementModel(case.model.robot, case.effects, candidates=Configuration().candidates)
    return replace(case.with_efforts(efforts), model=model)


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


@pytest.mark.parametrize("within", [0.09, 0.18])
def test_viscous_friction_beside_a_speed_between_those_tried_is_within_its_interval(within: float) -> None:
    case = sets_in(1.0, within)
    (viscous,) = (e for e in solved(case).effects if (e.name, e.joint) == ("viscous_friction", "joint2"))
    true = case.true.effects["viscous_friction"][JOINT]
    assert abs(viscous.value - true) < STDS_OF_95 * viscous.std < 2.0 * true


def test_rows_are_of_driven_places_alone() -> None:
    first, second = AtJoint(0), AtJoint(1)
    dry, stuck = CoulombFriction(), StribeckFriction()
    places = [(dry, first), (ViscousFriction(), first), (dry, second), (stuck, first), (stuck, second)]
    terms = [EffectTerm(*place) for place in places]
    assert passivity_constraints(terms, np.array([1.0, -5.0, 1.0, -0.9, -0.9])).shape == (0, 5)
    (row,) = passivity_constraints(terms, np.array([1.0, -5.0, 1.0, -0.9, -2.0]))
    np.testing.assert_allclose(row, [0.0, 0.0, 5e4, 0.0, 5e4])
    assert passivity_constraints(terms, np.array([-1.0, -5.0, 1.0, 0.0, -0.9])).shape == (0, 5)  # one is left out
    alone = [EffectTerm(dry, first), EffectTerm(Spring(), first)]
    assert passivity_constraints(alone, np.array([-1.0, -1.0])).shape == (0, 2)


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


@pytest.mark.parametrize(("level", "is_supported"), [(0.21, True), (0.19, False)])
def test_friction_that_levels_off_exceeds_the_drift_of_dry_friction(level: float, is_supported: bool) -> None:
    """A smaller one may be another shape of the dry friction."""
    own = SaturatingFriction(1.2)
    assert own.is_supported({CoulombFriction(0.003): 1.0, ViscousFriction(): 9.0, own: level}) == is_supported
