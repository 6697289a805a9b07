"""Joint motions: trajectories by points in time (as in trajectory_msgs/JointTrajectory), and exciting motions.

Exciting motions are at rest at both ends of each period and linear in their coefficients: joint j moves as
``q_j(t) = start_j + sum_m basis_m(t) coefficients_mj``. The basis has two parts. In the first part of a period: sums of
harmonics that begin and end with zero position, velocity, acceleration and jerk. In the rest: runs to and fro at
constant speed, each at a different one. Periods follow each other without a pause.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from geomid_ros.types import FloatArray, frozen

if TYPE_CHECKING:
    from scipy.interpolate import PPoly


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Positions, velocities and accelerations of ``joints`` at N points in time. Quintic polynomials interpolate, cubic
    ones where there are no accelerations. Arrays are read-only.

    Attributes:
        joints: Names, in the order of the columns.
        times: ``(N,)`` [s] after the start, increasing.
        positions: ``(N, joints)`` [rad, m].
        velocities: ``(N, joints)`` [rad/s, m/s].
        accelerations: ``(N, joints)`` [rad/s^2, m/s^2], or ``(N, 0)``.
        efforts: ``(N, joints)`` [N m, N], interpolated linearly, or ``(N, 0)``.
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
        """Largest speed of each joint at the points ``(joints,)`` [rad/s, m/s]."""
        return np.asarray(np.max(np.abs(self.velocities), axis=0))

    def at_speed(self, factor: float) -> Trajectory:
        """Return the same path, ``factor`` times as fast, without efforts."""
        return Trajectory(
            self.joints,
            self.times / factor,
            self.positions,
            self.velocities * factor,
            self.accelerations * factor**2,
        )

    def followed_by(self, other: Trajectory) -> Trajectory:
        """Append another trajectory of the same joints, which begins where this one ends."""
        return Trajectory(
            self.joints,
            np.concatenate([self.times, self.duration + other.times[1:]]),
            np.vstack([self.positions, other.positions[1:]]),
            np.vstack([self.velocities, other.velocities[1:]]),
            np.vstack([self.accelerations, other.accelerations[1:]]),
        )

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities ``(joints,)`` at a ``time`` [s], which is clamped to the first and last point."""
        positions, velocities, *_ = self.states(np.array([time]))
        return positions[0], velocities[0]

    def states(self, times: FloatArray) -> FloatArray:
        """Positions, velocities, accelerations and jerks ``(4, N, joints)`` at ``times (N,)`` [s], clamped likewise."""
        times = np.clip(times, self.times[0], self.duration)
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        pairs = np.array([after - 1, after])
        span, elapsed = np.diff(self.times[pairs], axis=0)[0], times - self.times[after - 1]
        powers = np.arange(6)
        ends = span[:, None], self.positions[pairs], self.velocities[pairs]
        coefficients = _quintic(*ends, self.accelerations[pairs]) if self.accelerations.shape[1] else _cubic(*ends)
        derivatives, factors = [], np.ones(6)
        for order in range(4):
            terms = factors * elapsed[:, None] ** np.maximum(powers - order, 0)
            derivatives.append(np.einsum("np,pnj->nj", terms, coefficients))
            factors = factors * (powers - order)
        return np.array(derivatives)


def _quintic(span: FloatArray, positions: FloatArray, velocities: FloatArray, accelerations: FloatArray) -> FloatArray:
    """Coefficients ``(6, N, joints)``, by power of time [s], of quintic polynomials between two points
    ``(2, N, joints)`` that lie a ``span (N, 1)`` [s] apart."""
    (p, end), (v, last_v), (a, last_a) = positions, velocities, accelerations
    rest = (end - p) / span - v - a * span / 2.0  # displacement left to the powers above two
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
    """Coefficients of cubic polynomials, in the form of :func:`_quintic`, for points without accelerations."""
    (p, end), (v, last_v) = positions, velocities
    rest, speed = (end - p) / span - v, last_v - v
    zeros = np.zeros_like(p)
    return np.array([p, v, (3.0 * rest - speed) / span, (speed - 2.0 * rest) / span**2, zeros, zeros])


DERIVATIVES = 4
"""Position, velocity, acceleration and jerk."""
_FASTEST = 0.8  # [Hz] of the highest harmonic
_HARMONICS = (4, 10)  # smallest and largest number
_BLEND = 0.3  # fraction of a one-way run for speeding up, and again for slowing down
_RUN = 2.5  # [s] to and fro, approximately
_SPEEDS = (1.0, 2.0, 4.0)  # relative speeds of the runs


@dataclass(frozen=True, kw_only=True)
class MotionForm:
    """Timing of an exciting motion, which also determines its number of basis functions.

    Attributes:
        period: [s].
        slow_fraction: fraction of a period for the slow runs, 0 to 1.
        repeats: number of periods, 1 or more.
    """

    period: float
    slow_fraction: float = 0.2
    repeats: int = 1

    @property
    def duration(self) -> float:
        """Total duration of all periods [s]."""
        return self.period * self.repeats

    @property
    def size(self) -> int:
        """Number of coefficients per joint."""
        return self.waves + self.runs

    @property
    def waves(self) -> int:
        """Number of coefficients of harmonics, which come first."""
        return 2 * self._harmonics + 1 - DERIVATIVES

    @property
    def runs(self) -> int:
        """Number of coefficients of slow runs."""
        slow = self.slow_fraction * self.period
        return min(len(_SPEEDS), max(1, round(slow / _RUN))) if slow > 0.0 else 0

    @property
    def _fast(self) -> float:
        return (1.0 - self.slow_fraction) * self.period

    @property
    def _harmonics(self) -> int:
        return int(np.clip(round(_FASTEST * self._fast), *_HARMONICS))

    @cached_property
    def _weights(self) -> FloatArray:
        """Weights of cosines, sines and a constant in waves at rest at the ends, ``(2 harmonics + 1, waves)``."""
        from scipy.linalg import null_space  # noqa: PLC0415 of exciting motions alone, takes long to load

        return np.asarray(null_space(self._harmonic_table(np.zeros(1))[:, 0]))

    def _harmonic_table(self, times: FloatArray) -> FloatArray:
        """Derivatives ``(4, N, 2 harmonics + 1)`` of harmonics with equal speed amplitudes, and of a constant."""
        omega = 2.0 * np.pi * np.arange(1, self._harmonics + 1) / self._fast
        angle = times[:, None] * omega
        table = np.zeros((DERIVATIVES, len(times), 2 * self._harmonics + 1))
        for order in range(DERIVATIVES):
            phase = angle + 0.5 * np.pi * order
            table[order, :, :-1] = np.tile(omega ** (order - 1), 2) * np.hstack([np.cos(phase), np.sin(phase)])
        table[0, :, -1] = 1.0
        return table

    @cached_property
    def _run_curves(self) -> list[tuple[float, float, tuple[PPoly, ...]]]:
        """Begin and end [s] of each run, and its position, velocity, acceleration and jerk."""
        fractions = 1.0 / np.array(_SPEEDS[: self.runs])
        ends = self._fast + self.slow_fraction * self.period * np.cumsum([0.0, *(fractions / np.sum(fractions))])
        return [(begin, end, _to_and_fro(begin, end)) for begin, end in pairwise(ends.tolist())]

    def basis(self, times: FloatArray) -> FloatArray:
        """Basis functions and their derivatives ``(4, N, size)`` at ``times (N,)`` [s] within all periods."""
        within = np.mod(times, self.period)
        table = np.zeros((DERIVATIVES, len(times), self.size))
        waves = within < self._fast
        table[:, waves, : self.waves] = self._harmonic_table(within[waves]) @ self._weights
        for column, (begin, end, curves) in enumerate(self._run_curves, self.waves):
            inside = (within >= begin) & (within < end)
            for order, curve in enumerate(curves):
                table[order, inside, column] = curve(within[inside])
        return table


def _to_and_fro(begin: float, end: float) -> tuple[PPoly, ...]:
    """Position, velocity, acceleration and jerk of a run to and fro at constant speed, with smooth blends."""
    from scipy.interpolate import PPoly  # noqa: PLC0415 of exciting motions alone, takes long to load

    half = 0.5 * (end - begin)
    blend = _BLEND * half
    knots = np.cumsum([begin, blend, half - 2.0 * blend, blend, blend, half - 2.0 * blend, blend])
    # Speed rises as 6 x^5 - 15 x^4 + 10 x^3 of x = t / blend.
    step = np.array([6.0 / blend**5, -15.0 / blend**4, 10.0 / blend**3, 0.0, 0.0, 0.0])
    one = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    speed = PPoly(np.array([step, one, one - step, -step, -one, step - one]).T, knots)
    return speed.antiderivative(), speed, speed.derivative(), speed.derivative(2)


@dataclass(frozen=True, eq=False)
class ExcitingMotion:
    """Exciting motion of J joints: ``form``, ``start (J,)``, where it also ends, and ``coefficients (size, J)``."""

    form: MotionForm
    start: FloatArray
    coefficients: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", frozen(self.start))
        object.__setattr__(self, "coefficients", frozen(self.coefficients))

    def at(self, times: FloatArray) -> FloatArray:
        """Position, velocity, acceleration and jerk ``(4, N, J)`` at ``times (N,)`` [s]; at rest before and after."""
        inside = (times > 0.0) & (times < self.form.duration)
        states = np.zeros((DERIVATIVES, len(times), len(self.start)))
        states[:, inside] = self.form.basis(times[inside]) @ self.coefficients
        states[0] += self.start
        return states

    def scaled(self, factor: FloatArray | float) -> ExcitingMotion:
        """Scale the displacement from the start, by one factor or by one per joint."""
        return ExcitingMotion(self.form, self.start, self.coefficients * factor)
