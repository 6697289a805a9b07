"""Zero-phase low-pass and derivative kernels, values on the time grid, and local cubic interpolation.

The same symmetric low-pass h filters every signal, which preserves the linear equations between them. A derivative is h
followed by a central difference of order six: the derivative of the filtered signal.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from geomid_ros.errors import InputError
from geomid_ros.model.samples import SAMPLES_PER_PIECE
from geomid_ros.signals.settings import LARGEST_NOISE_GAIN
from geomid_ros.types import FloatArray, IntArray

# Passband ripple and stopband below 1e-3 (Kaiser beta 6); the transition is as wide as the cutoff, centred on it.
_KAISER_BETA = 6.0
_LENGTH_IN_CUTOFF_PERIODS = 4.0
_FIRST_DIFFERENCE = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
_SECOND_DIFFERENCE = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
_SIXTH_DIFFERENCE = np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])
LOWEST_RATE_PER_CUTOFF = 2.5
_UNSURE = 0.05  # of the highest cutoff: accuracy of a period that is inferred from a part of the messages


def highest_cutoff(period: float) -> float:
    """Return the highest cutoff [Hz] on a grid of a ``period`` [s]."""
    return 1.0 / (LOWEST_RATE_PER_CUTOFF * period)


def check_cutoff(cutoff: float, period: float) -> None:
    """Raise InputError if a cutoff [Hz] is too high for a grid of a ``period`` [s]."""
    if cutoff > highest_cutoff(period) * (1.0 + _UNSURE):
        clock = "; or stamps are not in seconds" if period >= 0.5 else ""
        raise InputError(
            f"a cutoff of {cutoff:g} Hz is too high for data at {1 / period:.3g} Hz: set the parameter filter.cutoff "
            f"(--cutoff) to {highest_cutoff(period):.3g} or less{clock}"
        )


def derivative_kernels(cutoff: float, period: float) -> FloatArray:
    """Return kernels for the filtered value and its first and second time derivative.

    Args:
        cutoff: [Hz] where h falls to one half.
        period: [s] of the grid.

    Returns:
        ``(3, taps)``, to be correlated with the signal; the lag is half the taps.

    Raises:
        InputError: the grid is too coarse for the cutoff.
    """
    check_cutoff(cutoff, period)
    half = max(1, round(0.5 * _LENGTH_IN_CUTOFF_PERIODS / (cutoff * period)))
    value = np.pad(_low_pass(cutoff * period, half), len(_FIRST_DIFFERENCE) // 2)
    first = np.convolve(value, _FIRST_DIFFERENCE, mode="same") / period
    second = np.convolve(value, _SECOND_DIFFERENCE, mode="same") / period**2
    return np.array([value, first, second])


def noise_kernel(kernel: FloatArray) -> FloatArray:
    """Return a kernel ``(1, 7)`` whose result has the variance that white noise has behind ``kernel (taps,)``, and that
    motion below the cutoff hardly moves: a sixth difference."""
    return np.asarray(_SIXTH_DIFFERENCE * np.linalg.norm(kernel) / np.linalg.norm(_SIXTH_DIFFERENCE))[None]


def filtered(
    values: FloatArray, cutoff: float, period: float, at: IntArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Filter a whole recording with the zero-phase low-pass; the first and last value are repeated beyond its ends.

    Args:
        values: ``(N, K)``, one row every ``period``.
        cutoff: cutoff of the low-pass [Hz], limited to the highest that the period allows.
        period: [s].
        at: requested rows ``(n,)``; all rows if omitted.

    Returns:
        The filtered values and their first and second time derivative, each ``(N, K)`` or ``(n, K)``.
    """
    kernels = derivative_kernels(min(cutoff, highest_cutoff(period)), period)
    half = kernels.shape[1] // 2
    extended = np.pad(values, ((half, half), (0, 0)), mode="edge")
    if at is not None:
        windows = sliding_window_view(extended, 2 * half + 1, axis=0)
        pieces = range(0, max(len(at), 1), SAMPLES_PER_PIECE)
        results = np.concatenate([windows[at[begin : begin + SAMPLES_PER_PIECE]] @ kernels.T for begin in pieces])
        value, first, second = np.moveaxis(results, 2, 0)
        return value, first, second
    padded = GridValues()
    padded.extend(-half, extended)
    value, first, second = padded.correlated(range(len(values)), kernels)
    return value, first, second


def _low_pass(cutoff: float, half: int) -> FloatArray:
    """Ideal low-pass of ``cutoff`` (a fraction of the rate) under a Kaiser window, ``(2 half + 1,)``, of sum 1.

    It equals scipy.signal.firwin, whose import takes as long as a quarter of the node's start.
    """
    taps = np.sinc(2.0 * cutoff * np.arange(-half, half + 1)) * np.kaiser(2 * half + 1, _KAISER_BETA)
    return np.asarray(taps / np.sum(taps))


def cubic_weights(nodes: FloatArray, times: FloatArray) -> FloatArray:
    """Return interpolation weights of Lagrange's cubic.

    If the nodes are so uneven (messages in bursts) that the cubic would amplify noise, the weights interpolate linearly
    between the middle nodes.

    Args:
        nodes: ``(N, 4)``, increasing.
        times: ``(N,)``, between the middle two nodes.

    Returns:
        ``(N, 4)`` weights of the nodes' values.
    """
    weights = _lagrange(nodes.T, times).T
    noisy = np.sum(weights**2, axis=1) > LARGEST_NOISE_GAIN**2
    if np.any(noisy):
        before, after = nodes[noisy, 1], nodes[noisy, 2]
        fraction = (times[noisy] - before) / (after - before)
        weights[noisy] = np.stack([0.0 * fraction, 1.0 - fraction, fraction, 0.0 * fraction], axis=1)
    return weights


_OTHERS = ~np.eye(4, dtype=np.bool_)[:, :, None]


def _lagrange(nodes: FloatArray, time: FloatArray) -> FloatArray:
    factors = np.ones((4, *nodes.shape))
    np.divide(time - nodes, nodes[:, None] - nodes, out=factors, where=_OTHERS)
    return np.asarray(np.multiply.reduce(factors, axis=1))


class GridValues:
    """Vectors at consecutive grid points; ``first`` is the index of the oldest."""

    def __init__(self) -> None:
        self.first = 0
        self._buffer = np.zeros((0, 0))
        self._span = slice(0, 0)  # of the values in the buffer, which has room for more

    @property
    def values(self) -> FloatArray:
        """The vectors ``(N, ...)``."""
        return np.asarray(self._buffer[self._span])

    @property
    def end(self) -> int:
        """Index of the grid point after the last."""
        return self.first + len(self.values)

    def extend(self, start: int, values: FloatArray) -> None:
        """Append ``values (N, ...)`` from grid point ``start`` on: the :attr:`end`, unless there are no values yet."""
        kept, end = self.values, self._span.stop
        if not len(kept):
            self.first, kept = start, values[:0]
        if end + len(values) >= len(self._buffer):  # make room for as many again
            end = len(kept)
            self._buffer = np.concatenate([kept, np.empty((end + 2 * len(values), *values.shape[1:]))])
        self._buffer[end : end + len(values)] = values
        self._span = slice(end - len(kept), end + len(values))

    def correlated(self, instants: range, kernels: FloatArray, columns: int | None = None) -> FloatArray:
        """Correlate with ``kernels (kernels, 2 half + 1)`` around each grid point.

        Args:
            instants: N grid points, each with ``half`` neighbours on both sides.
            kernels: ``(kernels, 2 half + 1)``.
            columns: number of leading values; all if omitted.

        Returns:
            ``(kernels, N, values)``.
        """
        half = kernels.shape[1] // 2
        values = self.values[instants.start - half - self.first : instants[-1] + half + 1 - self.first, :columns]
        result = np.empty((len(kernels), len(instants), values.shape[1]))
        # Separate sums of a fixed length: rounding does not depend on how many are requested at once.
        if instants.step == 1:
            for column, signal in enumerate(np.ascontiguousarray(values.T)):
                for kernel, filtered in zip(kernels, result, strict=True):
                    filtered[:, column] = np.correlate(signal, kernel, "valid")
        else:
            for index, start in enumerate(range(0, len(instants) * instants.step, instants.step)):
                result[:, index] = kernels @ values[start : start + kernels.shape[1]]
        return result

    def drop_before(self, instant: int) -> None:
        """Discard older grid points."""
        surplus = instant - self.first
        if surplus > 0:
            self._span = slice(min(self._span.start + surplus, self._span.stop), self._span.stop)
            self.first += surplus
