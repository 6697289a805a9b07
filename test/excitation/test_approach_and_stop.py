"""The way to the start, and the way to rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from geomid_ros.excitation.approach import stopping_accelerations, way_by, way_to_rest

JOINTS = ("a", "b", "c")


@pytest.mark.parametrize("first", [0.5, 9.0])
def test_the_way_to_the_start_is_slow_and_at_rest_at_both_ends(first: float) -> None:
    random = np.random.default_rng(1)
    here, there = random.uniform(-3.0, 3.0, (2, 3))
    limits = np.array([first, 3.0, np.inf])
    way = way_by(JOINTS, [here, there], limits)
    np.testing.assert_allclose(way.positions[[0, -1]], [here, there])
    np.testing.assert_allclose(way.velocities[[0, -1]], 0.0, atol=1e-12)
    np.testing.assert_allclose(way.accelerations[[0, -1]], 0.0, atol=1e-12)
    times = np.linspace(0.0, way.duration, 4001)
    positions, velocities = np.moveaxis([way.at(time) for time in times.tolist()], 1, 0)
    np.testing.assert_allclose(velocities, np.gradient(positions, times, axis=0), atol=1e-3)
    fastest = np.abs(velocities).max(axis=0)
    slow = np.array([0.05 if first < 1.0 else 0.25, 0.25, 0.25])
    assert np.all(fastest <= slow * (1.0 + 1e-6))
    assert np.max(fastest / slow) == pytest.approx(1.0, rel=1e-3), "it takes no longer than it must"
    assert np.all(np.diff(positions, axis=0) * (there - here) >= -1e-12), "it goes straight there"


def test_the_way_to_rest_decelerates_uniformly() -> None:
    """By the cubic that a controller makes of where it is and the one point."""
    random = np.random.default_rng(1)
    position, velocity = random.normal(0.0, 1.0, (2, 3))
    most = np.array([1.0, 4.0, 9.0])
    way = way_to_rest(JOINTS, position, velocity, most)
    assert way.accelerations.shape == (1, 0), "else it is no cubic"
    end = way.positions[0]
    np.testing.assert_array_equal(way.velocities, 0.0)
    path = CubicHermiteSpline([0.0, way.duration], [position, end], [velocity, np.zeros(3)])
    slowing = path(np.linspace(0.0, way.duration, 50), 2)
    np.testing.assert_allclose(slowing, np.broadcast_to(-velocity / way.duration, slowing.shape), atol=1e-9)
    assert np.all(np.abs(velocity / way.duration) <= most + 1e-12)
    assert way.duration <= max(0.5, float(np.max(np.abs(velocity) / most))) + 1e-12


def test_a_joint_stops_as_hard_as_it_moves_and_from_its_limit_in_half_a_second() -> None:
    motion = way_by(JOINTS, [np.zeros(3), np.array([0.1, 0.1, 0.1])], np.full(3, 2.0)).at_speed(4.0)
    own = np.abs(motion.accelerations).max()
    found = stopping_accelerations(motion, np.array([0.01, 3.0, np.inf]))
    np.testing.assert_allclose(found, [own, 6.0, own])
    assert way_to_rest(JOINTS, np.zeros(3), np.array([0.0, -3.0, 0.0]), found).duration == pytest.approx(0.5)
