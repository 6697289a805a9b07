"""A motion of joints by points in time, as trajectory_msgs/JointTrajectory has it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geomid_ros.types import FloatArray, frozen


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Positions, velocities and accelerations of ``joints`` at N instants; quintic polynomials lead from one to the
    next, cubic ones where there are no accelerations. Arrays are read-only.

    Attributes:
        joints: Names, in the order of the columns.
        times: ``(N,)`` [s] after the start, increasing.
        positions: ``(N, joints)`` [rad, m].
        velocities: ``(N, joints)`` [rad/s, m/s].
        accelerations: ``(N, joints)`` [rad/s^2, m/s^2], or ``(N, 0)``.
        efforts: ``(N, joints)`` [N m, N], between which they are linear, or ``(N, 0)``.
    """

    joints: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    efforts: FloatArray = field(default=None)  # type: ignore[arg-type]  # replaced by an array without columns

    def __post_init__(self) -> None:
        if self.efforts is None:
            object.__setattr__(self, "efforts", np.zeros((len(self.times), 0)))
        for name in ("times", "positions", "velocities", "accelerations", "efforts"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def duration(self) -> float:
        """Time of the last point [s]."""
        return float(self.times[-1])

    @property
    def speeds(self) -> FloatArray:
        """Each joint's largest speed at a point ``(joints,)`` [rad/s, m/s]."""
        return np.asarray(np.max(np.abs(self.velocities), axis=0))

    def at_speed(self, factor: float) -> Trajectory:
        """The same path, ``factor`` times as fast, without efforts."""
        return Trajectory(
            self.joints,
            self.times / factor,
            self.positions,
            self.velocities * factor,
            self.accelerations * factor**2,
        )

    def followed_by(self, other: Trajectory) -> Trajectory:
        """This and then another one of the same joints, which begins where this one ends."""
        return Trajectory(
            self.joints,
            np.concatenate([self.times, self.duration + other.times[1:]]),
            np.vstack([self.positions, other.positions[1:]]),
            np.vstack([self.velocities, other.velocities[1:]]),
            np.vstack([self.accelerations, other.accelerations[1:]]),
        )

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities ``(joints,)`` at a ``time`` [s]; before the first point and after the last one those
        of this point."""
        positions, velocities, *_ = self.states(np.array([time]))
        return positions[0], velocities[0]

    def states(self, times: FloatArray) -> FloatArray:
        """The same, and accelerations and jerks, ``(4, N, joints)`` at ``times (N,)`` [s]."""
        times = np.clip(times, self.times[0], self.duration)
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        pairs = np.array([after - 1, after])
        span, passed = np.diff(self.times[pairs], axis=0)[0], times - self.times[after - 1]
        powers = np.arange(6)
        ends = span[:, None], self.positions[pairs], self.velocities[pairs]
        coefficients = _quintic(*ends, self.accelerations[pairs]) if self.accelerations.shape[1] else _cubic(*ends)
        found, factors = [], np.ones(6)
        for order in range(4):
            terms = factors * passed[:, None] ** np.maximum(powers - order, 0)
            found.append(np.einsum("np,pnj->nj", terms, coefficients))
            factors = factors * (powers - order)
        return np.array(found)


def _quintic(span: FloatArray, positions: FloatArray, velocities: FloatArray, accelerations: FloatArray) -> FloatArray:
    """Coefficients ``(6, N, joints)``, by power of the time [s], of the polynomials between two points
    ``(2, N, joints)`` that lie a ``span (N, 1)`` [s] apart."""
    (p, end), (v, last_v), (a, last_a) = positions, velocities, accelerations
    rest = (end - p) / span - v - a * span / 2.0  # what the powers above two must add
    speed = last_v - v - a * span
    bend = (last_a - a) * span
    return np.array(
        [
            p,
            v,
            a / 2.0,
            (10.0 * rest - 4.0 * speed + bend / 2.0) / span**2,
            (-15.0 * rest + 7.0 * speed - bend) / span**3,
            (6.0 * rest - 3.0 * speed + bend / 2.0) / span**4,
        ]
    )


def _cubic(span: FloatArray, positions: FloatArray, velocities: FloatArray) -> FloatArray:
    """The same of the polynomials of order three, without accelerations at the points."""
    (p, end), (v, last_v) = positions, velocities
    rest, speed = (end - p) / span - v, last_v - v
    nothing = np.zeros_like(p)
    return np.array([p, v, (3.0 * rest - speed) / span, (speed - 2.0 * rest) / span**2, nothing, nothing])
