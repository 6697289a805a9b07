"""Feasibility of a motion at every time: the check, its margins, and shrinking a motion until it is feasible. Distances
between bodies, and to their surroundings, along a path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.excitation.belief import Belief
from geomid_ros.excitation.limits import MotionLimits
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.model.collision import CollisionModel, Pair
from geomid_ros.types import FloatArray, IntArray

Course: TypeAlias = Callable[[FloatArray], FloatArray]
"""Function from times ``(N,)`` [s] to positions, speeds, accelerations and jerks ``(4, N, J)``."""
_RATE = 50.0  # [Hz] of samples for efforts and, at first, for distances
_SHORTEST = 2e-4  # [s] between samples of the distance
_SHARE_AT_ENDS = 0.5  # fraction of the distance at an end to keep, for pairs closer there than the clearance
_FINE = 500.0  # [Hz] of samples for positions, speeds, accelerations, jerks
_RESERVE = 1e-3  # fraction of each limit kept in reserve, for the time between two samples
_EDGE = 0.01  # margin at the ends of a joint's range: fraction of the range, and at most so many rad or m
HALVINGS = 12
"""Number of halvings of the interval that contains the largest feasible size of a motion."""


def overlap(collision: CollisionModel, position: FloatArray) -> str:
    """Describe the pair that overlaps most at a position ``(J,)``; empty if none does."""
    distances = collision.distances(position[None])[0]
    if not np.any(distances <= 0.0):
        return ""
    return f"{collision.pairs[int(np.argmin(distances))]} overlap by {-1e3 * np.min(distances):.0f} mm"


def clearances_from(collision: CollisionModel, ends: FloatArray, clearance: float) -> FloatArray:
    """Distances ``(pairs,)`` [m] to keep between postures ``ends (N, J)``: the ``clearance`` [m], or half of the
    distance at an end where that is less."""
    return np.asarray(np.minimum(clearance, _SHARE_AT_ENDS * np.min(collision.distances(ends), axis=0)))


class PathClearance:
    """Distances at samples of a path, and their lower bounds between samples.

    The two bodies of a pair move no faster relative to each other than ``reach . |speeds|``. Between two samples the
    distance is at least half the sum of the distances at both, minus half of the travel in between.
    """

    def __init__(self, course: Course, duration: float, collision: CollisionModel, clearances: FloatArray) -> None:
        self._course, self._collision, self._clearances = course, collision, clearances
        self._reach = collision.reach @ np.abs(collision.robot.coupling)
        self._times = np.linspace(0.0, duration, int(np.ceil(_RATE * duration)) + 1)
        self._distances = collision.distances(course(self._times)[0])

    def verify(self) -> bool:
        """Halve intervals until all clearances are certain. Return False if one is violated or stays uncertain."""
        while np.all(self._distances >= self._clearances):
            uncertain = np.flatnonzero(np.any(self._between() < self._clearances, axis=1))
            if not len(uncertain):
                return True
            if np.min(np.diff(self._times)[uncertain]) < _SHORTEST:
                return False
            self._refine(uncertain)
        return False

    @property
    def worst(self) -> tuple[Pair, float, float]:
        """Pair that is closest to its clearance, its distance [m], and the time [s]."""
        sample, pair = np.unravel_index(np.argmin(self._distances - self._clearances), self._distances.shape)
        return self._collision.pairs[pair], float(self._distances[sample, pair]), float(self._times[sample])

    def _between(self) -> FloatArray:
        """Lower bounds ``(N - 1, pairs)`` of the distances between samples."""
        ends = self._distances[:-1] + self._distances[1:]
        return np.asarray(0.5 * (ends - self._ways() @ self._reach.T))

    def _ways(self) -> FloatArray:
        """Upper bounds ``(N - 1, J)`` of the joints' travel between samples."""
        states = self._course(self._times)
        steps = np.diff(self._times)[:, None]
        # The speed is at most that at the nearer end, plus the gain by the largest acceleration in half of the time.
        fastest = np.maximum(np.abs(states[1, :-1]), np.abs(states[1, 1:]))
        jerk = np.max(np.abs(states[3]), axis=0)
        hardest = np.max(np.abs(states[2]), axis=0) + 0.5 * np.max(steps) * jerk
        return np.asarray(steps * (fastest + 0.5 * steps * hardest))

    def _refine(self, intervals: IntArray) -> None:
        middles = 0.5 * (self._times[intervals] + self._times[intervals + 1])
        distances = self._collision.distances(self._course(middles)[0])
        self._times = np.insert(self._times, intervals + 1, middles)
        self._distances = np.insert(self._distances, intervals + 1, distances, axis=0)

    def bounds(self) -> FloatArray:
        """Lower bounds of the distances ``(pairs,)`` [m] over the whole path."""
        return np.asarray(np.min(self._between(), axis=0))


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins of a motion from its limits.

    Attributes:
        position: smallest distance of each joint from its limits ``(J,)`` [rad, m].
        velocity, acceleration, jerk, effort: largest used fraction of each joint's limit ``(J,)``; the effort includes
            :data:`STDS_OF_95` standard deviations.
        distance: lower bound of the distance of each pair ``(pairs,)`` [m].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    effort: FloatArray
    distance: FloatArray


class Feasibility:
    """All constraints on a motion from ``start (J,)``."""

    def __init__(
        self,
        belief: Belief,
        limits: MotionLimits,
        start: FloatArray,
        collision: CollisionModel | None = None,
        clearance: float = 0.02,
    ) -> None:
        """``clearance`` [m]: kept by all pairs that have it at the start; others keep half of their distance there.

        Raises InputError for a start that is not feasible itself.
        """
        self.belief, self.limits, self.start, self.collision = belief, limits, start, collision
        self.names, self.clearance = belief.model.robot.joint_names, clearance
        self.edge = np.minimum(_EDGE, _EDGE * np.diff(limits.position)[:, 0])
        self._check_start()
        self.clearances = np.zeros(0)
        """Distance that each pair must keep ``(pairs,)`` [m]."""
        if collision is not None:
            if touching := overlap(collision, start):
                raise InputError(f"at the start {touching}; give another --start")
            self.clearances = clearances_from(collision, start[None], clearance)

    def _check_start(self) -> None:
        low, high = self.limits.position.T
        for name, position, lower, upper in zip(self.names, self.start, low, high, strict=True):
            if not lower <= position <= upper:
                raise InputError(
                    f"the start of joint '{name}' is {position:.4g}, outside its limits {lower:.4g} to {upper:.4g}; "
                    "give another --start"
                )
        still = np.stack([self.start, 0.0 * self.start, 0.0 * self.start])[:, None]
        used = self._effort_shares(still)[0]
        worst = int(np.argmax(used))
        if used[worst] >= 1.0:
            raise InputError(
                f"at the start pose, gravity (with its uncertainty) requires {100 * used[worst]:.0f} % of the effort "
                f"limit of joint '{self.names[worst]}'; give another --start"
            )

    def _effort_shares(self, states: FloatArray) -> FloatArray:
        """Used fractions of the effort limits ``(N, J)`` at ``states (3, N, J)``, with their uncertainty."""
        rows = self.belief.rows_of_parameters(states)[:, : len(self.names)]
        efforts = rows @ self.belief.posterior.parameters
        deviations = self.belief.prediction_stds(rows @ self.belief.posterior.jacobian)
        return np.asarray((np.abs(efforts) + STDS_OF_95 * deviations) / self.limits.effort)

    def largest_scale(self, motion: ExcitingMotion) -> FloatArray:
        """Factors ``(J,)`` that scale each joint of a motion until it reaches its first limit of position, speed,
        acceleration or jerk."""
        states = motion.at(_times(motion, _FINE))
        displacement = states[0] - self.start
        low, high = self.limits.position.T
        room = np.stack([self.start - low - self.edge, high - self.edge - self.start])
        room = np.maximum(room, 0.0)
        farthest = np.stack([-np.min(displacement, axis=0), np.max(displacement, axis=0)])
        largest = np.max(np.abs(states[1:]), axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            fractions = np.concatenate([farthest / room, largest / ((1.0 - _RESERVE) * self.limits.derivatives)])
        worst = np.max(np.nan_to_num(fractions, nan=0.0, posinf=np.inf), axis=0)
        return np.where(worst > 0.0, 1.0 / np.where(worst > 0.0, worst, 1.0), 0.0)

    def within_limits(self, motion: ExcitingMotion) -> ExcitingMotion:
        """Shrink each joint of a motion into its limits."""
        return motion.scaled(np.minimum(1.0, self.largest_scale(motion)))

    def shrunk_to_feasible(self, motion: ExcitingMotion, halvings: int = HALVINGS) -> ExcitingMotion:
        """Shrink each joint of a motion into its limits, then the whole motion until efforts and distances keep theirs.
        With more ``halvings`` the result comes closer to the largest feasible size."""
        shrunk = self.within_limits(motion)
        if self.keeps_limits(shrunk):
            return shrunk
        low, high = 0.0, 1.0
        for _ in range(halvings):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.keeps_limits(shrunk.scaled(middle)) else (low, middle)
        return shrunk.scaled(low)

    def keeps_limits(self, motion: ExcitingMotion) -> bool:
        """True if a motion within its joints' limits keeps those of efforts and distances, too."""
        times = _times(motion, _RATE)
        if np.max(self._effort_shares(motion.at(times)[:3])) > 1.0 - _RESERVE:
            return False
        if self.collision is None:
            return True
        return PathClearance(motion.at, motion.form.period, self.collision, self.clearances).verify()

    def margins(self, motion: ExcitingMotion) -> Margins:
        """Margins of a feasible motion from all limits."""
        distance = np.zeros(0)
        if self.collision is not None:
            path = PathClearance(motion.at, motion.form.period, self.collision, self.clearances)
            path.verify()
            distance = path.bounds()
        states = motion.at(_times(motion, _FINE))
        low, high = self.limits.position.T
        fractions = np.max(np.abs(states[1:]), axis=1) / self.limits.derivatives
        efforts = np.max(self._effort_shares(motion.at(_times(motion, _RATE))[:3]), axis=0)
        return Margins(
            position=np.min(np.minimum(states[0] - low, high - states[0]), axis=0),
            velocity=fractions[0],
            acceleration=fractions[1],
            jerk=fractions[2],
            effort=efforts,
            distance=distance,
        )


def _times(motion: ExcitingMotion, rate: float) -> FloatArray:
    """Sample times of a period [s], at least at a ``rate`` [Hz]."""
    return np.linspace(0.0, motion.form.period, int(np.ceil(rate * motion.form.period)) + 1)
