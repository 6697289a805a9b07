"""Feed-forward: a trajectory with the efforts that it takes.

A controller leads positions from point to point by polynomials, and efforts by straight lines (ros2_controllers'
joint_trajectory_controller adds them to its feedback since 4.22). So points are added where straight lines are too far
from the efforts; they lie on the polynomials, and the motion stays what it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.types import BoolArray, FloatArray

EffortsOf: TypeAlias = Callable[[FloatArray], FloatArray]
"""Efforts ``(N, joints)`` [N m, N] of positions, velocities and accelerations ``(3, N, joints)``."""
SHORTEST = 1e-3
"""[s] between two points: usual controllers look no more often."""
_INSIDE = np.array([0.25, 0.5, 0.75])  # of the time from one point to the next, where efforts are compared


def with_efforts(trajectory: Trajectory, efforts_of: EffortsOf, tolerance: float) -> Trajectory:
    """The same motion with efforts at its points, and with as many more points as these ask for.

    Args:
        trajectory: the motion.
        efforts_of: the efforts of a motion.
        tolerance: of straight lines between the efforts, as a share of each joint's largest one. Where efforts jump,
            as those of cubic polynomials do at a point, they may be further off for :data:`SHORTEST`.
    """
    times = trajectory.times
    found = sampled(trajectory, efforts_of, times)
    while np.any(far := _far(found, efforts_of, tolerance)):
        middle = 0.5 * (times[1:] + times[:-1])
        times = np.sort(np.concatenate([times, middle[far]]))
        found = sampled(trajectory, efforts_of, times)
    return found


def sampled(trajectory: Trajectory, efforts_of: EffortsOf, times: FloatArray) -> Trajectory:
    """The same motion with points and efforts at other ``times (N,)`` [s], those of its own points among them."""
    motion = trajectory.states(times)[:3]
    accelerations = motion[2] if trajectory.accelerations.shape[1] else np.zeros((len(times), 0))
    efforts = efforts_of(motion)
    return replace(
        trajectory, times=times, positions=motion[0], velocities=motion[1], accelerations=accelerations, efforts=efforts
    )


def interpolation_errors(found: Trajectory, efforts_of: EffortsOf) -> FloatArray:
    """By how much straight lines between efforts are off ``(N - 1, joints)`` [N m, N], between two points at most."""
    steps = np.diff(found.times)
    errors = np.zeros((len(steps), len(found.joints)))
    for share in _INSIDE.tolist():
        true = efforts_of(found.states(found.times[:-1] + share * steps)[:3])
        errors = np.maximum(errors, np.abs(true - (1.0 - share) * found.efforts[:-1] - share * found.efforts[1:]))
    return errors


def _far(found: Trajectory, efforts_of: EffortsOf, tolerance: float) -> BoolArray:
    """Between which points ``(N - 1,)`` straight lines are too far from the efforts."""
    largest = np.max(np.abs(found.efforts), axis=0)
    bounds = np.maximum(tolerance * largest, ROUNDING * np.max(largest))
    off = np.any(interpolation_errors(found, efforts_of) > bounds, axis=1)
    return np.asarray(off & (np.diff(found.times) >= 2.0 * SHORTEST))
