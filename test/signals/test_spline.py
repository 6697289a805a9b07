"""Cubic splines beside those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from geomid_ros.signals.spline import spline

SIZES = pytest.mark.parametrize("size", [2, 3, 4, 5, 300])


@SIZES
def test_it_is_the_spline_of_scipy(size: int) -> None:
    """Between the samples, at them, and a little outside."""
    rng = np.random.default_rng(size)
    times = 3.0 + np.cumsum(rng.uniform(0.5, 1.5, size=size))
    values = rng.normal(size=(size, 3))
    at = np.concatenate([times, rng.uniform(times[0] - 0.2, times[-1] + 0.2, size=40 + size % 2)]).reshape(2, -1)[
        :, ::-1
    ]
    np.testing.assert_allclose(spline(times, values, at), CubicSpline(times, values)(at), rtol=1e-8, atol=1e-8)


def test_cubics_are_exact() -> None:
    times = np.array([0.0, 0.3, 1.0, 1.1, 2.0])
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0])
    at = np.linspace(-0.5, 2.5, 31)
    np.testing.assert_allclose(spline(times, cubic(times)[:, None], at)[:, 0], cubic(at), rtol=1e-10, atol=1e-10)
