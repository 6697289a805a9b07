"""Zero-phase low-pass and derivative kernels, and local cubic interpolation: the whole of the signal filtering.

One symmetric low-pass h serves every signal, so that filtering keeps the (linear) equations between them; a derivative
is h followed by a central difference of order six, so that derivatives belong to the filtered signal itself.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import firwin

from geomid_ros.errors import InputError
from geomid_ros.types import FloatArray

# Passband ripple and stopband below 1e-3 (Kaiser beta 6); the transition is as wide as the cutoff, centred on it.
_KAISER_BETA = 6.0
_LENGTH_IN_CUTOFF_PERIODS = 4.0
_FIRST_DIFFERENCE = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
_SECOND_DIFFERENCE = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
_HALF_DIFFERENCE = 3
LOWEST_RATE_PER_CUTOFF = 2.5
_LARGEST_NOISE_GAIN = 2.0
_DIFFERENT_NODES = ~np.eye(4, dtype=bool)


def derivative_kernels(cutoff: float, period: float) -> FloatArray:
    """Correlation kernels ``(3, taps)`` for the filtered value and its first and second derivative by time.

    ``cutoff`` [Hz] is where h falls to one half, ``period`` [s] the grid's. The lag is half the taps. Raises InputError
    when the grid is too coarse for the cutoff.
    """
    if cutoff * period * LOWEST_RATE_PER_CUTOFF > 1.0 + 1e-9:  # a cutoff at the limit is rounded
        raise InputError(
            f"filter cutoff of {cutoff:g} Hz is too high for data at {1 / period:.3g} Hz: "
            f"at most {1 / period / LOWEST_RATE_PER_CUTOFF:.3g} Hz"
        )
    half = max(1, round(0.5 * _LENGTH_IN_CUTOFF_PERIODS / (cutoff * period)))
    low_pass = firwin(2 * half + 1, cutoff, window=("kaiser", _KAISER_BETA), fs=1.0 / period)
    value = np.pad(low_pass, _HALF_DIFFERENCE)
    first = np.convolve(low_pass, _FIRST_DIFFERENCE) / period
    second = np.convolve(low_pass, _SECOND_DIFFERENCE) / period**2
    return np.array([value, first, second])


def cubic_weights(nodes: FloatArray, times: FloatArray) -> FloatArray:
    """Weights ``(N, 4)`` of four increasing ``nodes (N, 4)`` for the values at ``times (N,)`` between the middle two.

    Lagrange's cubic; where the nodes lie so unevenly (messages in bursts) that it would amplify noise, the line between
    the middle nodes.
    """
    spacings = nodes[:, :, None] - nodes[:, None, :]
    factors = np.ones(spacings.shape)
    np.divide((times[:, None] - nodes)[:, None, :], spacings, out=factors, where=_DIFFERENT_NODES)
    weights: FloatArray = factors.prod(axis=2)
    noisy = np.sum(weights**2, axis=1) > _LARGEST_NOISE_GAIN**2
    if np.any(noisy):
        share = (times - nodes[:, 1]) / (nodes[:, 2] - nodes[:, 1])
        linear = np.stack([np.zeros_like(share), 1.0 - share, share, np.zeros_like(share)], axis=1)
        weights[noisy] = linear[noisy]
    return weights
