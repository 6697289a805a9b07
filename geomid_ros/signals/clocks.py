"""Checks and corrects the times of messages: wrong clocks, shown by velocities that are not the derivatives of
positions, times of messages that arrive in bursts, and stamps that are not the times of measurement.

Messages that wait somewhere and arrive together (wireless links, batches of a bus) are stamped on arrival. If they were
measured with a fixed period, their running numbers give the times: the last message of a burst waits the least, and
these lie on a line.

A node that publishes the latest measurement of a source with another period (``joint_state_publisher``) stamps it with
the time of publishing, as does a driver on a busy computer with the time at which it gets to it. The measurement is
older by a time that varies, and positions seem to jerk. Velocities tell how much time has passed between two positions.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from geomid_ros.model.samples import REST_SPEED
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.settings import CLEAR_RATIO
from geomid_ros.types import BoolArray, FloatArray, IntArray

_Numbers = TypeVar("_Numbers", FloatArray, IntArray)
FEWEST = 32
"""Number of messages from which the period is inferred."""
FEWEST_IN_BURSTS = 320
"""Number of messages from which the period is inferred if they arrive in bursts."""
_UNEVEN = 0.35  # largest RMS distance of burst ends from a line, as a fraction of the time between bursts
MISSED = 2.5
"""Periods between two messages, or between bursts, above which there is a pause."""
_FOLLOWS = 0.05  # fraction of a burst's lateness by which times are corrected


def steps(values: _Numbers, before: _Numbers | int) -> _Numbers:
    """Return the steps between values ``(N, ...)``, the first one from the value ``before``."""
    result = values.copy()
    result[1:] -= values[:-1]
    result[:1] -= before
    return result


def in_bursts(stamps: IntArray, max_gap: int) -> bool:
    """True if more than a quarter of the steps between increasing stamps are shorter than a quarter of the mean step.
    Steps longer than ``max_gap`` [ns] do not count."""
    steps = np.diff(stamps)
    steps = steps[steps <= max_gap]
    return bool(len(steps) and np.mean(steps < np.mean(steps) / CLEAR_RATIO) > 1.0 / CLEAR_RATIO)


class RegularClock:
    """Times of messages that arrive in bursts, from their running numbers."""

    def __init__(self, stamps: IntArray) -> None:
        """
        Args:
            stamps: stamps of the first messages [ns], which are still to be passed to :meth:`times`.
        """
        steps = np.diff(stamps)
        ends = np.flatnonzero(steps > np.mean(steps))
        times = (stamps[ends] - stamps[0]).astype(float)
        period, begin = map(float, np.polyfit(ends, times, 1))
        self.period = period
        """Time between messages [ns]."""
        self._between = float(period * np.mean(np.diff(ends)))  # [ns] time between bursts
        self.is_right = bool(period > 0.0 and np.std(times - begin - period * ends) < _UNEVEN * self._between)
        """True if running numbers determine the times of measurement."""
        self._origin = self._last = int(stamps[0])
        self._time = begin - period  # time of the message before, since the origin [ns]

    def times(self, stamps: IntArray) -> IntArray:
        """Return the times [ns] of the next messages from their stamps ``(N,)``."""
        result = np.empty(len(stamps))
        for index, stamp in enumerate(stamps.tolist()):
            result[index] = self._time = self._time + max(self._step(stamp), 0.5 * self.period)
            self._last = stamp
        return self._origin + np.round(result).astype(np.int64)

    def _step(self, stamp: int) -> float:
        """Return the time [ns] from the message before to the one with this stamp."""
        waited = stamp - self._last
        if waited > MISSED * self._between:
            return waited - self._between + self.period
        if waited < self.period:
            return self.period
        late = self._last - self._origin - self._time  # the message before was the last of a burst
        return self.period + (late if abs(late) > MISSED * self.period else _FOLLOWS * late)


class MotionClock:
    """Times at which joint messages were measured, from the positions and velocities in them.

    In a step from one message to the next, joints move by d at the mean velocity v. If the stamps are right, d is v
    times the time between them, but for noise. Else the time that passed is ``sum w d v / sum w v^2`` over the joints,
    each with the weight w of its errors ``d - v time``; that its mean differs is an error of the velocities. A lag is
    forgotten slowly, as the age of the measurements is unknown.

    These times are used if positions alone bear them out: their rates ``d / time`` must bend far less from step to step
    than with the time between stamps. Steps in which at least two joints move count, as noise is not common to them.
    The first :data:`FEWEST_IN_BURSTS` decide whether to look further.
    """

    _LEAST = 0.05  # RMS of how much steps and time that passed differ, as a fraction: the filter removes less
    _FORGOTTEN = 0.01  # fraction of the lag, in each step

    def __init__(self, joints: int, period: float) -> None:
        """
        Args:
            joints: number of joints.
            period: usual time between messages [ns]. After lost messages the mean velocity is unknown.
        """
        self._longest = MISSED * period
        self._is_open = joints > 1  # False once the stamps are known to be right
        self.is_used = False
        """True if the stamps are wrong, and times are computed from the motion."""
        self._lag = 0  # [ns] of the last message
        self._count = 0  # steps in which joints move
        self._squares = np.zeros((1, joints))  # of the errors, summed over them
        self._scatter = np.zeros((1, 3))  # these, too: what steps tell, times its squared changes, and noise
        self._passed = np.zeros((1, 2))  # time between stamps, and time that passed
        self._bends = np.zeros((1, 2))  # by stamps, and by the motion
        self.restart()

    def restart(self) -> None:
        """Restart after a clock was set or positions leapt."""
        self._last: tuple[int, FloatArray, FloatArray] | None = None
        self._rates = np.full((2, 2, self._squares.shape[1]), np.nan)  # of the last two steps, by stamps and motion

    def times(self, stamps: IntArray, positions: FloatArray, velocities: FloatArray) -> IntArray:
        """Return the times [ns] of the next messages ``(N,)``, which increase.

        Args:
            stamps: ``(N,)`` [ns], increasing.
            positions, velocities: ``(N, joints)``; NaN for velocities that are not measured.
        """
        if not (self._is_open or self._lag):
            return stamps
        if not self._lag and np.isnan(velocities).all():
            self.restart()
            return stamps
        stamp, position, velocity = self._last or (int(stamps[0]), positions[0], velocities[0])
        self._last = int(stamps[-1]), positions[-1].copy(), velocities[-1].copy()
        waited = steps(stamps, stamp).astype(float)
        moved, mean = steps(positions, position), velocities - 0.5 * steps(velocities, velocity)
        expected = mean * 1e-9 * waited[:, None]
        is_moving = np.fmin(np.abs(moved), np.abs(expected)) > REST_SPEED * 1e-9 * waited[:, None]
        is_moving &= np.isfinite(expected)
        moves = (np.sum(is_moving, axis=1) > 1) & (waited <= self._longest)
        if not (moves.any() or self._lag):
            self._rates[:] = np.nan
            return stamps
        moved, expected = (np.where(moves[:, None] & np.isfinite(expected), of, 0.0) for of in (moved, expected))
        counts = self._count + np.cumsum(moves)
        squares = np.cumsum(np.concatenate([self._squares, (moved - expected) ** 2]), axis=0)[1:]
        weights = np.divide(counts[:, None], squares, out=np.zeros_like(squares), where=squares > 0.0)
        share, shown, matters = self._share(moved, expected, weights, counts, waited)
        used = matters & self._bears_out(moved, waited, np.where(moves, share, np.nan), weights)
        used &= self._is_open & (counts >= FEWEST)
        if self._count < FEWEST_IN_BURSTS <= counts[-1]:
            decided = int(np.searchsorted(counts, FEWEST_IN_BURSTS))
            self._is_open = bool(used[decided])
            used[decided:] &= self._is_open
        self.is_used, self._count, self._squares = bool(used[-1]), int(counts[-1]), squares[-1:]
        return stamps - self._lags(waited, used * waited * shown * (1.0 - share))

    def _share(
        self, moved: FloatArray, expected: FloatArray, weights: FloatArray, counts: IntArray, waited: FloatArray
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the share of the time between stamps that passed in each step, relative to its mean; how much of what
        the step shows is no noise; and True where shares have differed so far as to matter. Each is ``(N,)``.

        Args:
            moved, expected: d, and v times the time between stamps, ``(N, joints)``; zero where nothing moves.
            weights: ``(N, joints)``.
            counts, waited: steps up to each, and time between stamps, ``(N,)``.
        """
        squares, known = _total(weights * expected**2), np.maximum(_total(weights * expected * moved), 0.0)
        share = np.divide(known, squares, out=np.ones(len(known)), where=squares > 0.0)
        errors = _total(weights * (moved - expected * share[:, None]) ** 2) / (weights.shape[1] - 1.0)
        self._scatter, all_known, jitter, noise = _summed(self._scatter, known, known * (share - 1.0) ** 2, errors)
        signal = counts * known * jitter  # Wiener's filter
        shown = np.divide(signal, signal + all_known * noise, out=np.zeros_like(signal), where=signal > 0.0)
        self._passed, time, passed = _summed(self._passed, shown * waited, shown * waited * share)
        mean = np.divide(passed, time, out=np.ones(len(time)), where=time > 0.0)
        matters = jitter > self._LEAST**2 * all_known
        return np.clip(share / mean, 1.0 / CLEAR_RATIO, CLEAR_RATIO), shown, np.asarray(matters)

    def _bears_out(self, moved: FloatArray, waited: FloatArray, share: FloatArray, weights: FloatArray) -> BoolArray:
        """True where the rates of positions have bent far less by the motion than by stamps so far ``(N,)``."""
        times, known = 1e-9 * np.stack([waited, waited * share], axis=1)[:, :, None], ~np.isnan(share)[:, None, None]
        new = np.full((len(waited), *self._rates.shape[1:]), np.nan)
        rates = np.concatenate([self._rates, np.divide(moved[:, None], times, out=new, where=known)])
        self._rates = rates[-2:]
        bends = np.nan_to_num(_total(weights[:, None] * (rates[2:] - 2.0 * rates[1:-1] + rates[:-2]) ** 2))
        self._bends, by_stamps, by_motion = _summed(self._bends, *bends.T)
        return np.asarray(CLEAR_RATIO * by_motion < by_stamps)

    def _lags(self, waited: FloatArray, excess: FloatArray) -> IntArray:
        """Return the lags [ns] of the next messages ``(N,)``, such that times increase."""
        lags = np.empty(len(waited), dtype=np.int64)
        for index, (step, added) in enumerate(zip(waited.tolist(), excess.tolist(), strict=True)):
            longest = step - max(1.0, step / CLEAR_RATIO) if step else 0.0
            lags[index] = self._lag = int(min((1.0 - self._FORGOTTEN) * (self._lag + added), self._lag + longest))
        return lags


def _summed(before: FloatArray, *terms: FloatArray) -> tuple[FloatArray, ...]:
    """Return the last sums ``(1, kinds)`` of some kinds of terms, added to those before, and the sums up to each term
    of every kind ``(N,)``."""
    sums = np.cumsum(np.concatenate([before, np.column_stack(terms)]), axis=0)[1:]
    return sums[-1:], *sums.T


def _total(terms: FloatArray) -> FloatArray:
    """Sum over the last axis, in order, so that the sums do not depend on the number of messages taken together."""
    return np.asarray(np.cumsum(terms, axis=-1)[..., -1])


SCALED = Reason(
    "velocities differ from the derivatives of positions by a constant factor; check the clock and the unit of "
    "velocities; they are not used",
    "told",
)
_UNITS_OF_SPEED = (180.0 / np.pi, 1000.0, 30.0 / np.pi, 0.5 / np.pi)  # degrees, mrad, 1/min, turns in a rad/s


class VelocityCheck:
    """Detects a wrong clock or unit by the messages' velocities.

    Samples derive velocities from positions alone, as effects' columns do. With measured velocities, noise or a delay
    would falsely distinguish the inertia of links from that of rotors, and from a carriage's mass.
    """

    _FEWEST = 100  # number of samples
    _OFF = 0.05  # largest difference of a factor from one, and of a squared correlation
    _WRONG_CLOCK = 1.5  # times; a smaller factor may be due to a gear or a filter

    def __init__(self, joints: int) -> None:
        self._sums = np.zeros((4, joints))  # sums of _moments
        self._reported = False

    def add(self, given: FloatArray, derived: FloatArray) -> FloatArray:
        """Take filtered velocities of samples.

        Args:
            given: velocities in the messages ``(N, joints)``, NaN where there are none.
            derived: derivatives of positions ``(N, joints)``.

        Returns:
            Sums over the samples up to each ``(4, N, joints)``, for :meth:`are_derivatives`.
        """
        sums = np.cumsum(np.concatenate([self._sums[:, None], _moments(given, derived)], axis=1), axis=1)
        self._sums = sums[:, -1]
        return np.asarray(sums[:, 1:])

    def are_derivatives(self, given: FloatArray, sums: FloatArray) -> BoolArray:
        """True where a message's velocity is the derivative but for noise ``(N, joints)``; sums are from
        :meth:`add`."""
        _, _, product, square = sums
        similar = (product > square / self._WRONG_CLOCK) & (product < square * self._WRONG_CLOCK)
        return np.asarray(np.isfinite(given) & similar & ~self._scaled(sums))

    def _informative(self, sums: FloatArray) -> BoolArray:
        """True for joints with informative sums ``(4, ...)``; a joint at rest has the filter's tails only."""
        count, _, product, derived = sums
        return np.asarray((count >= self._FEWEST) & (derived > count * REST_SPEED**2) & (product > 0.0))

    def _scaled(self, sums: FloatArray) -> BoolArray:
        """True for joints whose velocities differ from the derivatives by a factor, from sums ``(4, ...)``."""
        _, given, product, derived = sums
        off = np.abs(product - derived) > self._OFF * derived
        in_proportion = product**2 > (1.0 - self._OFF) * given * derived
        return np.asarray(off & in_proportion & self._informative(sums))

    def remark(self) -> Reason | None:
        """Return a remark on the messages' velocities, once; None if there is none."""
        scaled = self._scaled(self._sums)
        if self._reported or not scaled.any():
            return None
        self._reported = True
        _, _, product, derived = self._sums
        rates = product[scaled] / derived[scaled]
        rate = float(np.median(rates))
        is_common = len(rates) > 1 and np.all(np.abs(rates / rate - 1.0) < self._OFF)
        is_unit = np.any(np.abs(np.abs(np.log(rate)) - np.abs(np.log(_UNITS_OF_SPEED))) < self._OFF)
        is_large = abs(np.log(rate)) > np.log(self._WRONG_CLOCK)
        is_everywhere = np.all(scaled | ~self._informative(self._sums))
        return _wrong_clock(rate) if is_common and not is_unit and is_large and is_everywhere else SCALED


def _moments(given: FloatArray, derived: FloatArray) -> FloatArray:
    """Moments ``(4, N, joints)``: 1 if a velocity is given, its square, its product with the derivative, and the
    derivative's square where it is given."""
    is_given = np.isfinite(given)
    velocity = np.where(is_given, given, 0.0)
    return np.array([is_given, velocity**2, velocity * derived, is_given * derived**2])


def _wrong_clock(rate: float) -> Reason:
    return driver_error(
        f"stamps run {max(rate, 1.0 / rate):.3g} times too {'slow' if rate < 1.0 else 'fast'}: at all "
        "joints the velocities are so many times as small or large as the positions' derivatives; stamp messages in "
        "seconds, when they are measured"
    )
