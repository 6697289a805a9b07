"""Feed-forward efforts for a trajectory.

A joint_trajectory_controller interpolates positions by polynomials and efforts linearly (ros2_controllers adds them to
its feedback since 4.22). Points are added where linear interpolation of the efforts is too coarse. They lie on the same
polynomials, so the motion does not change.
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
"""Inverse dynamics: efforts ``(N, joints)`` [N m, N] at positions, velocities and accelerations ``(3, N, joints)``."""
SHORTEST = 1e-3
"""Shortest time between two points [s]: the cycle time of usual controllers."""
_PROBED = 10.0 * SHORTEST  # [s] at least so often the interpolation is checked
_INSIDE = (0.25, 0.5, 0.75)  # and there between two points


def with_efforts(trajectory: Trajectory, efforts_of: EffortsOf, tolerance: float) -> Trajectory:
    """Add efforts at all points, and further points where they are needed.

    Args:
        trajectory: the motion.
        efforts_of: inverse dynamics.
        tolerance: largest interpolation error, as a share of each joint's largest effort. Where the effort jumps, as
            at the points of cubic polynomials, the error may be larger for :data:`SHORTEST`.
    """
    times = trajectory.times
    found = sampled(trajectory, efforts_of, times)
    while np.any(far := _far(found, efforts_of, tolerance)):
        middle = 0.5 * (times[1:] + times[:-1])
        times = np.sort(np.concatenate([times, middle[far]]))
        found = sampled(trajectory, efforts_of, times)
    return found


def sampled(trajectory: Trajectory, efforts_of: EffortsOf, times: FloatArray) -> Trajectory:
    """The same motion sampled at ``times (N,)`` [s], which include those of its own points, with efforts."""
    motion = trajectory.states(times)[:3]
    accelerations = motion[2] if trajectory.accelerations.shape[1] else np.zeros((len(times), 0))
    efforts = efforts_of(motion)
    return replace(
        trajectory, times=times, positions=motion[0], velocities=motion[1], accelerations=accelerations, efforts=efforts
    )


def interpolation_errors(found: Trajectory, efforts_of: EffortsOf) -> FloatArray:
    """Largest error of linearly interpolated efforts between two points ``(N - 1, joints)`` [N m, N]."""
    times, steps = found.times, np.diff(found.times)
    probes = [np.arange(times[0], times[-1], _PROBED), *(times[:-1] + share * steps for share in _INSIDE)]
    at = np.concatenate(probes)
    between = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(steps) - 1)
    share = ((at - times[between]) / steps[between])[:, None]
    linear = (1.0 - share) * found.efforts[between] + share * found.efforts[between + 1]
    errors = np.zeros((len(steps), len(found.joints)))
    np.maximum.at(errors, between, np.abs(efforts_of(found.states(at)[:3]) - linear))
    return errors


def _far(found: Trajectory, efforts_of: EffortsOf, tolerance: float) -> BoolArray:
    """True where a further point is needed ``(N - 1,)``."""
    largest = np.max(np.abs(found.efforts), axis=0)
    bounds = np.maximum(tolerance * largest, ROUNDING * np.max(largest))
    off = np.any(interpolation_errors(found, efforts_of) > bounds, axis=1)
    return np.asarray(off & (np.diff(found.times) >= 2.0 * SHORTEST))
