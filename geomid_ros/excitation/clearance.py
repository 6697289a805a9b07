"""How close the bodies of a robot come to each other and to their surroundings on a path."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from geomid_ros.model.collision import CollisionModel, Pair
from geomid_ros.types import FloatArray, IntArray

Course: TypeAlias = Callable[[FloatArray], FloatArray]
"""From times ``(N,)`` [s] to positions, speeds, accelerations and jerks ``(4, N, J)``."""
RATE = 50.0
"""[Hz] of the instants at which distances, at first, and efforts are looked at."""
_SHORTEST = 2e-4  # [s] between instants of which the distance is computed
_SHARE_AT_ENDS = 0.5  # of the distance there, for pairs that begin or end closer than the clearance


def overlap(collision: CollisionModel, position: FloatArray) -> str:
    """Which pair overlaps most at a position ``(J,)``, in words; empty if none does."""
    distances = collision.distances(position[None])[0]
    if not np.any(distances <= 0.0):
        return ""
    return f"{collision.pairs[int(np.argmin(distances))]} overlap by {-1e3 * np.min(distances):.0f} mm"


def clearances_from(collision: CollisionModel, ends: FloatArray, clearance: float) -> FloatArray:
    """The distances ``(pairs,)`` [m] to keep between ``ends (N, J)``: the ``clearance`` [m], or half of what a pair has
    at an end where that is less."""
    return np.asarray(np.minimum(clearance, _SHARE_AT_ENDS * np.min(collision.distances(ends), axis=0)))


class Distances:
    """Distances at some instants of a path, and what they say of those between.

    No point of a pair's bodies moves faster relative to the other than ``reach . |speeds|``. Between two instants the
    distance is at least half of what it is at both together, less half of the way in between.
    """

    def __init__(self, course: Course, duration: float, collision: CollisionModel, clearances: FloatArray) -> None:
        self._course, self._collision, self._clearances = course, collision, clearances
        self._reach = collision.reach @ collision.coupling_sizes
        self._times = np.linspace(0.0, duration, int(np.ceil(RATE * duration)) + 1)
        self._distances = collision.distances(course(self._times)[0])

    def settle(self) -> bool:
        """Halve intervals until the clearances are certain, or are found not to hold."""
        while np.all(self._distances >= self._clearances):
            unsure = np.flatnonzero(np.any(self._between() < self._clearances, axis=1))
            if not len(unsure):
                return True
            if np.min(np.diff(self._times)[unsure]) < _SHORTEST:
                return False
            self._refine(unsure)
        return False

    @property
    def worst(self) -> tuple[Pair, float, float]:
        """The pair that has the least to spare, its distance [m], and when [s]."""
        instant, pair = np.unravel_index(np.argmin(self._distances - self._clearances), self._distances.shape)
        return self._collision.pairs[pair], float(self._distances[instant, pair]), float(self._times[instant])

    def _between(self) -> FloatArray:
        """Lower bounds ``(N - 1, pairs)`` of the distances between instants."""
        ends = self._distances[:-1] + self._distances[1:]
        return np.asarray(0.5 * (ends - self._ways() @ self._reach.T))

    def _ways(self) -> FloatArray:
        """At least the ways ``(N - 1, J)`` that joints go between instants."""
        states = self._course(self._times)
        steps = np.diff(self._times)[:, None]
        # The speed is at most that at the nearer end, and what the largest acceleration adds in half of the time.
        fastest = np.maximum(np.abs(states[1, :-1]), np.abs(states[1, 1:]))
        jerk = np.max(np.abs(states[3]), axis=0)
        harder = np.max(np.abs(states[2]), axis=0) + 0.5 * np.max(steps) * jerk
        return np.asarray(steps * (fastest + 0.5 * steps * harder))

    def _refine(self, intervals: IntArray) -> None:
        middles = 0.5 * (self._times[intervals] + self._times[intervals + 1])
        new = self._collision.distances(self._course(middles)[0])
        self._times = np.insert(self._times, intervals + 1, middles)
        self._distances = np.insert(self._distances, intervals + 1, new, axis=0)

    def bounds(self) -> FloatArray:
        """Lower bounds of the distances ``(pairs,)`` at all instants."""
        return np.asarray(np.min(self._between(), axis=0))
