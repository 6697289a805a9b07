"""``estimate`` does not depend on how the robot is written down."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot

from .arms import ALL_EFFECTS, Case, Motion, arm, samples, shipped, solved
from .frames import Rewritten, rewritten

SAME = 1e-7  # a prior that weighs a 1e-8th of the rows leaves its own directions to rounding
SETTINGS = {
    "auto": {},
    "geodesic": {"objective": "geodesic"},
    "sigma": {"gamma": 1e-4, "sigma": {"joint2": 0.3}},
}


def solved_there(case: Case, other: Rewritten, settings: dict[str, Any]) -> Estimate:
    robot = Robot(other.urdf, gravity=np.array([0.0, 0.0, -9.81 * other.length]))
    model = MeasurementModel(robot, [identifiable()[effect] for effect in ALL_EFFECTS])
    unit = other.mass * other.length**2
    sigma = {name: unit * s for name, s in settings.get("sigma", {}).items()}
    moving = Motion(case.samples.position, case.samples.velocity, case.samples.acceleration)
    there = replace(case, model=model, samples=samples(moving, unit * case.samples.effort))
    return solved(there, **{**settings, "sigma": sigma})


@pytest.mark.parametrize(
    ("name", "kind", "length", "mass"),
    [("arm3", "auto", 1.0, 1.0), *(("arm7", kind, 100.0, 1000.0) for kind in SETTINGS)],
)
def test_frames_and_units_do_not_matter(name: str, kind: str, length: float, mass: float) -> None:
    case, other, settings = arm(name, 1, seconds=10), rewritten(shipped(name), 1, length, mass), SETTINGS[kind]
    here, there = solved(case, **settings), solved_there(case, other, settings)
    assert there.gamma == pytest.approx(here.gamma, rel=SAME)
    for one, two in zip(here.links, there.links, strict=True):
        expected = pseudo_inertia.from_parameters(other.parameters(one.name, one.parameters))
        assert spd.distance(expected, pseudo_inertia.from_parameters(two.parameters)) < SAME
        assert two.std_mass == pytest.approx(mass * one.std_mass, rel=SAME)
        assert two.from_data == pytest.approx(one.from_data, abs=SAME)
        assert two.distance_from_prior == pytest.approx(one.distance_from_prior, abs=SAME)
        assert two.min_eigenvalue_ratio == pytest.approx(one.min_eigenvalue_ratio, rel=SAME)
    unit = mass * length**2
    for one, two in zip(here.effects, there.effects, strict=True):
        factor = 1.0 if one.unit == "-" else unit
        assert two.value == pytest.approx(factor * one.value, rel=SAME)
        assert two.std == pytest.approx(factor * one.std, rel=SAME)
    np.testing.assert_allclose(there.rms, unit * here.rms, rtol=SAME)
    np.testing.assert_allclose(there.sigmas, unit * here.sigmas, rtol=SAME)
