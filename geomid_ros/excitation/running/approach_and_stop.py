"""The slow way to the start of a motion, and the way from a motion to rest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.types import FloatArray

_SHARE, _FASTEST = 0.1, 0.25  # of the limit of speed, and [rad/s, m/s]
_SHORTEST_WAY = 2.0  # [s]
_SHORTEST_STOP, _LONGEST_STOP = 0.3, 0.5  # [s], the latter from the limit of speed
_POINTS = 20.0  # a second
_PEAK = 15.0 / 8.0  # of the speed of a quintic from rest to rest, as a multiple of its mean


def way_by(joints: tuple[str, ...], postures: Sequence[FloatArray], speed_limits: FloatArray) -> Trajectory:
    """From rest to rest by a quintic, from each posture to the next, no joint faster than a tenth of its limit or
    0.25 rad/s (m/s).

    Args:
        joints: names.
        postures: two or more positions ``(joints,)``.
        speed_limits: ``(joints,)``, infinite where there is none.
    """
    way, *others = (_way_to(joints, *ends, speed_limits) for ends in pairwise(postures))
    for other in others:
        way = way.followed_by(other)
    return way


def _way_to(joints: tuple[str, ...], here: FloatArray, there: FloatArray, speed_limits: FloatArray) -> Trajectory:
    distance = there - here
    slow = np.minimum(_SHARE * speed_limits, _FASTEST)
    duration = max(_SHORTEST_WAY, float(np.max(_PEAK * np.abs(distance) / slow)))
    times = np.linspace(0.0, duration, round(duration * _POINTS) + 1)
    u = (times / duration)[:, None]
    return Trajectory(
        joints,
        times,
        here + distance * u**3 * (10.0 + u * (6.0 * u - 15.0)),
        distance * 30.0 * (u * (1.0 - u)) ** 2 / duration,
        distance * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration**2,
    )


def stopping_accelerations(motion: Trajectory, speed_limits: FloatArray) -> FloatArray:
    """The accelerations by which joints are stopped ``(joints,)`` [rad/s^2, m/s^2]: the largest of the motion, or more
    where a joint needs it to come from its limit of speed to rest in half a second.

    Args:
        motion: at full speed, where it is feasible.
        speed_limits: ``(joints,)``, infinite where there is none.
    """
    enough = np.where(np.isfinite(speed_limits), speed_limits / _LONGEST_STOP, 0.0)
    return np.asarray(np.maximum(np.max(np.abs(motion.accelerations), axis=0), enough))


def way_to_rest(
    joints: tuple[str, ...], position: FloatArray, velocity: FloatArray, accelerations: FloatArray
) -> Trajectory:
    """One point, at which all joints have come to rest.

    A controller that leads there from where it is by a cubic, as it does where no accelerations are given, decelerates
    uniformly: a joint at speed ``v`` that stands after ``T`` has gone ``v T / 2``.

    Args:
        joints: names.
        position, velocity: ``(joints,)``.
        accelerations: ``(joints,)``, with which the joints may be stopped; a joint with zero is taken to stand.
    """
    moving = accelerations > 0.0
    duration = max(_SHORTEST_STOP, float(np.max(np.abs(velocity[moving]) / accelerations[moving], initial=0.0)))
    end = position + np.where(moving, velocity, 0.0) * duration / 2.0
    return Trajectory(joints, np.array([duration]), end[None], np.zeros((1, len(joints))), np.zeros((1, 0)))
