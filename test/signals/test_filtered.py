"""A whole recording through the low-pass."""

from __future__ import annotations

import numpy as np

from geomid_ros.signals.kernels import filtered


def test_rows_that_are_asked_for_are_those_of_the_whole() -> None:
    """At the ends, too, beyond which the outermost values go on."""
    values = np.random.default_rng(0).normal(size=(200, 3))
    at = np.array([0, 1, 50, 51, 199])
    for some, whole in zip(filtered(values, 8.0, 0.01, at), filtered(values, 8.0, 0.01), strict=True):
        np.testing.assert_allclose(some, whole[at], rtol=1e-12, atol=1e-12 * np.max(np.abs(whole)))
