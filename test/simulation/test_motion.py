"""Motions stay inside the limits, start at rest, repeat, and come with their exact derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.simulation.description import read_description
from geomid_ros.simulation.motion import SetPoints, exciting_motion
from geomid_ros.simulation.options import MOTIONS, SimulationOptions
from geomid_ros.simulation.robots import robot_description

JOINTS = read_description(robot_description("arm7")).joints
OPTIONS = SimulationOptions(motion_period=3.0)
TIMES = np.linspace(0.0, 9.0, 9001)


def motion(options: SimulationOptions = OPTIONS) -> SetPoints:
    return exciting_motion(TIMES, JOINTS, options, np.random.default_rng(1))


@pytest.mark.parametrize("kind", MOTIONS)
def test_derivatives(kind: str) -> None:
    """Between the corners that trapezoids of speed have."""
    whole, step = motion(replace(OPTIONS, motion=kind)), TIMES[1] - TIMES[0]
    slope, bend = (np.gradient(values, step, axis=0)[1:-1] for values in (whole.position, whole.velocity))
    inside = np.abs(whole.acceleration[2:] - whole.acceleration[:-2]) < 1.0
    assert inside.mean() > 0.95
    np.testing.assert_allclose(slope, whole.velocity[1:-1], atol=1e-2)
    off = np.abs(bend[inside] - whole.acceleration[1:-1][inside]) > 1e-2
    assert off.mean() < (0.01 if kind == "points" else 1e-9)


@pytest.mark.parametrize("kind", MOTIONS)
@pytest.mark.parametrize(("reach", "speed"), [(0.7, 0.6), (0.1, 1.0), (1.0, 0.1)])
def test_uses_its_share_of_the_limits(reach: float, speed: float, kind: str) -> None:
    whole = motion(replace(OPTIONS, motion_range=reach, motion_speed=speed, motion=kind))
    centre, half, top = np.array([(joint.centre, joint.half_range, joint.velocity) for joint in JOINTS]).T
    used_range = np.abs(whole.position - centre).max(0) / half / reach
    used_speed = np.abs(whole.velocity).max(0) / top / speed
    np.testing.assert_allclose(np.maximum(used_range, used_speed), 1.0, rtol=1e-9)
