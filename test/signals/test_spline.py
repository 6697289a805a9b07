"""Cubic splines: what they are by definition, and as scipy has them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from geomid_ros.signals.spline import spline
from geomid_ros.types import FloatArray


def sampled(count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times apart by different steps, values of three columns, and instants, some of them beyond the ends."""
    random = np.random.default_rng(count)
    times = np.cumsum(random.uniform(0.5, 1.5, count)) - 3.0
    return times, random.normal(size=(count, 3)), random.uniform(times[0] - 0.5, times[-1] + 0.5, (4, 5))


@pytest.mark.parametrize("count", [2, 3, 4, 5, 40])
def test_it_is_the_spline_without_a_knot_next_to_the_ends(count: int) -> None:
    times, values, at = sampled(count)
    assert spline(times, values, at) == pytest.approx(CubicSpline(times, values)(at), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 12])
def test_it_passes_through_the_values_and_is_every_cubic(count: int) -> None:
    times, values, at = sampled(count)
    assert spline(times, values, times) == pytest.approx(values, abs=1e-12)
    powers = np.arange(min(count, 4))
    coefficients = np.array([2.0, -1.0, 0.5, 0.3])[: len(powers), None]
    found = spline(times, times[:, None] ** powers @ coefficients, at)
    assert found == pytest.approx(at[..., None] ** powers @ coefficients, rel=1e-10, abs=1e-10)
