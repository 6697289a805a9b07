"""The form of a motion: at rest at both ends of each period, linear in its coefficients.

Joint j moves as ``q_j(t) = start_j + sum_m basis_m(t) coefficients_mj``. The basis has two parts. In the first share of
a period they are those sums of harmonics that begin and end with zero position, velocity, acceleration and jerk; in the
rest, runs to and fro at constant speed, each at its own. Periods follow each other without a pause.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import PPoly
from scipy.linalg import null_space

from geomid_ros.types import FloatArray, frozen

DERIVATIVES = 4
"""Position, velocity, acceleration and jerk."""
_FASTEST = 0.8  # [Hz] of the harmonics
_HARMONICS = (4, 10)  # least and most
_BLEND = 0.3  # of a run's time goes into speeding up, and as much into slowing down
_RUN = 2.5  # [s] to and fro, about
_SPEEDS = (1.0, 2.0, 4.0)  # of the runs, one to another


@dataclass(frozen=True, kw_only=True)
class MotionForm:
    """How long a period lasts, what share of it the slow runs take, and how often it is repeated.

    Attributes:
        period: [s].
        slow_share: 0 to 1.
        repeats: 1 or more.
    """

    period: float
    slow_share: float = 0.2
    repeats: int = 1

    @property
    def duration(self) -> float:
        """Of all periods [s]."""
        return self.period * self.repeats

    @property
    def size(self) -> int:
        """How many coefficients each joint has."""
        return self.waves + self.runs

    @property
    def waves(self) -> int:
        """How many of them are of harmonics; they come first."""
        return 2 * self._harmonics + 1 - DERIVATIVES

    @property
    def runs(self) -> int:
        """How many of them are of slow runs."""
        slow = self.slow_share * self.period
        return min(len(_SPEEDS), max(1, round(slow / _RUN))) if slow > 0.0 else 0

    @property
    def _fast(self) -> float:
        return (1.0 - self.slow_share) * self.period

    @property
    def _harmonics(self) -> int:
        return int(np.clip(round(_FASTEST * self._fast), *_HARMONICS))

    @cached_property
    def _weights(self) -> FloatArray:
        """Of cosines, sines and a constant in each wave, ``(2 harmonics + 1, waves)``: at rest at the ends."""
        return np.asarray(null_space(self._harmonic_table(np.zeros(1))[:, 0]))

    def _harmonic_table(self, times: FloatArray) -> FloatArray:
        """Derivatives ``(4, N, 2 harmonics + 1)`` of harmonics whose speeds are all of one size, and of a constant."""
        omega = 2.0 * np.pi * np.arange(1, self._harmonics + 1) / self._fast
        angle = times[:, None] * omega
        table = np.zeros((DERIVATIVES, len(times), 2 * self._harmonics + 1))
        for order in range(DERIVATIVES):
            turned = angle + 0.5 * np.pi * order
            table[order, :, :-1] = np.tile(omega ** (order - 1), 2) * np.hstack([np.cos(turned), np.sin(turned)])
        table[0, :, -1] = 1.0
        return table

    @cached_property
    def _run_curves(self) -> list[tuple[float, float, tuple[PPoly, ...]]]:
        """Beginning, end and the four derivatives of each run."""
        shares = 1.0 / np.array(_SPEEDS[: self.runs])
        ends = self._fast + self.slow_share * self.period * np.cumsum([0.0, *(shares / np.sum(shares))])
        return [(begin, end, _to_and_fro(begin, end)) for begin, end in pairwise(ends.tolist())]

    def basis(self, times: FloatArray) -> FloatArray:
        """Values and derivatives ``(4, N, size)`` of the basis at ``times (N,)`` [s] within all periods."""
        within = np.mod(times, self.period)
        table = np.zeros((DERIVATIVES, len(times), self.size))
        waves = within < self._fast
        table[:, waves, : self.waves] = self._harmonic_table(within[waves]) @ self._weights
        for place, (begin, end, curves) in enumerate(self._run_curves, self.waves):
            own = (within >= begin) & (within < end)
            for order, curve in enumerate(curves):
                table[order, own, place] = curve(within[own])
        return table


def _to_and_fro(begin: float, end: float) -> tuple[PPoly, ...]:
    """One run there at constant speed and one back, with smooth blends; its four derivatives."""
    half = 0.5 * (end - begin)
    blend = _BLEND * half
    knots = np.cumsum([begin, blend, half - 2.0 * blend, blend, blend, half - 2.0 * blend, blend])
    # Smooth steps of speed: 6 x^5 - 15 x^4 + 10 x^3 of x = t / blend.
    step = np.array([6.0 / blend**5, -15.0 / blend**4, 10.0 / blend**3, 0.0, 0.0, 0.0])
    one = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    speed = PPoly(np.array([step, one, one - step, -step, -one, step - one]).T, knots)
    return speed.antiderivative(), speed, speed.derivative(), speed.derivative(2)


@dataclass(frozen=True, eq=False)
class ExcitingMotion:
    """A motion of J joints: its ``form``, where it begins and ends ``start (J,)``, and ``coefficients (size, J)``."""

    form: MotionForm
    start: FloatArray
    coefficients: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", frozen(self.start))
        object.__setattr__(self, "coefficients", frozen(self.coefficients))

    def at(self, times: FloatArray) -> FloatArray:
        """Position, velocity, acceleration and jerk ``(4, N, J)`` at ``times (N,)`` [s]; at rest before and after."""
        inside = (times > 0.0) & (times < self.form.duration)
        found = np.zeros((DERIVATIVES, len(times), len(self.start)))
        found[:, inside] = self.form.basis(times[inside]) @ self.coefficients
        found[0] += self.start
        return found

    def scaled(self, factor: FloatArray | float) -> ExcitingMotion:
        """The motion shrunk towards its start, by one factor or by one of each joint."""
        return ExcitingMotion(self.form, self.start, self.coefficients * factor)
