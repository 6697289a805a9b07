"""Dahl's law, integrated along a motion, comes back as dry friction with presliding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.model.effects import JointMotion
from geomid_ros.model.effects.coulomb_friction import SMOOTHINGS, CoulombFriction
from geomid_ros.model.effects.presliding import DISTANCES, Presliding
from geomid_ros.model.effects.stribeck_friction import StribeckFriction
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.session.configuration import Configuration
from geomid_ros.types import FloatArray

from .arms import arm, solved

JOINT = 1
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
    motion = JointMotion(position, time, np.ones_like(time))
    law = DRY.column(motion) + Presliding(distance).column(motion)
    there = (time > -0.5) & (np.abs(time) > 10.0 * SMOOTHINGS[0])  # it slides, and beside rest the sign is smooth
    np.testing.assert_allclose(law[there], dahl(position, distance)[there], atol=0.01)


def test_it_is_found_with_the_level_of_dry_friction() -> None:
    case = arm("arm3", 0, noise=0.02)
    level, distance = case.true.effects["coulomb_friction"][JOINT], DISTANCES[-1]
    efforts = case.samples.effort.copy()
    efforts[:, JOINT] -= level * np.tanh(case.samples.velocity[:, JOINT] / 0.02)
    efforts[:, JOINT] += level * dahl(case.samples.position[:, JOINT], distance)
    model = MeasurementModel(case.model.robot, case.model.places.common, candidates=Configuration().candidates)
    planted = replace(case.with_efforts(efforts), model=model)
    found = [effect for effect in solved(planted).effects if effect.name == "presliding"]
    assert [(effect.joint, effect.parameters["distance"].value) for effect in found] == [("joint2", distance)]
    assert found[0].value == pytest.approx(level, rel=0.05)


@pytest.mark.parametrize(
    ("level", "excess", "kept", "is_borne_out"), [(1, 0, 0.9, True), (1, 0, 1.3, False), (1, 0.5, 1.2, True)]
)
def test_no_more_than_all_dry_friction_keeps_its_sign(
    level: float, excess: float, kept: float, is_borne_out: bool
) -> None:
    own = Presliding()
    assert own.is_borne_out({DRY: level, StribeckFriction(0.25): excess, own: kept}) == is_borne_out
