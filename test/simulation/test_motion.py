"""Motions stay inside the limits, start at rest, repeat, and come with their exact derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.simulation.description import read_description
from geomid_ros.simulation.motion import FADE_IN, Motion, exciting_motion
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.robots import robot_description

JOINTS = read_description(robot_description("arm7")).joints
OPTIONS = SimulationOptions(motion_period=3.0)
TIMES = np.linspace(0.0, 9.0, 9001)


def motion(options: SimulationOptions = OPTIONS) -> Motion:
    return exciting_motion(TIMES, JOINTS, options, np.random.default_rng(1))


def test_starts_at_rest_in_the_middle_of_the_range() -> None:
    np.testing.assert_allclose(motion().position[0], [joint.centre for joint in JOINTS], atol=1e-12)
    np.testing.assert_allclose(motion().velocity[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(motion().acceleration[0], 0.0, atol=1e-12)


def test_derivatives() -> None:
    whole, step = motion(), TIMES[1] - TIMES[0]
    np.testing.assert_allclose(np.gradient(whole.position, step, axis=0)[1:-1], whole.velocity[1:-1], atol=1e-3)
    np.testing.assert_allclose(np.gradient(whole.velocity, step, axis=0)[1:-1], whole.acceleration[1:-1], atol=1e-2)


@pytest.mark.parametrize(("reach", "speed"), [(0.7, 0.6), (0.1, 1.0), (1.0, 0.1)])
def test_uses_its_share_of_the_limits(reach: float, speed: float) -> None:
    whole = motion(replace(OPTIONS, motion_range=reach, motion_speed=speed))
    centre, half, top = np.array([(joint.centre, joint.half_range, joint.velocity) for joint in JOINTS]).T
    used_range = np.abs(whole.position - centre).max(0) / half / reach
    used_speed = np.abs(whole.velocity).max(0) / top / speed
    np.testing.assert_allclose(np.maximum(used_range, used_speed), 1.0, rtol=1e-9)


def test_is_periodic_once_faded_in() -> None:
    position = motion().position
    faded, later = np.searchsorted(TIMES, (FADE_IN, FADE_IN + OPTIONS.motion_period))
    np.testing.assert_allclose(position[later:], position[faded : faded + len(position) - later], atol=1e-9)
