"""Axes of pictures."""

import numpy as np
import pytest

from geomid_ros.report.page import ticks


@pytest.mark.parametrize(("low", "high"), [(-0.4, 1.1), (-1.6, 0.9), (0.0, 4.58), (-300.0, -20.0), (1e-4, 2e-3)])
@pytest.mark.parametrize("most", [2, 5, 7])
def test_ticks_are_equally_far_apart_within_the_ends_and_zero_has_no_sign(low: float, high: float, most: int) -> None:
    found = ticks(low, high, most)
    assert 1 <= len(found) <= most + 1
    assert low <= found[0]
    assert found[-1] <= high
    np.testing.assert_allclose(np.diff(found, 2), 0.0, atol=1e-9 * (high - low))
    assert "-0" not in [f"{value:g}" for value in found]
    if low <= 0.0 <= high:
        assert min(map(abs, found)) < 1e-12
