"""The isometry S(4) -> R^10."""

from __future__ import annotations

import numpy as np

from geomid_ros.geometry import spd

from . import bodies

ROUNDING = 1e-14


def test_coordinates_keep_the_frobenius_inner_product() -> None:
    x, y = bodies.symmetric(np.random.default_rng(0), 2, 50)
    dots = np.sum(spd.to_vector(x) * spd.to_vector(y), axis=-1)
    np.testing.assert_allclose(dots, np.trace(x @ y, axis1=-2, axis2=-1), rtol=0, atol=20 * ROUNDING)


def test_the_order_is_the_diagonal_then_the_upper_triangle() -> None:
    matrix = np.array([[0.0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]])
    expected = np.arange(10.0) * np.where(np.arange(10) < 4, 1.0, np.sqrt(2.0))
    np.testing.assert_allclose(spd.to_vector(matrix), expected, rtol=ROUNDING)


def test_a_congruence_is_a_matrix_of_coordinates() -> None:
    rng = np.random.default_rng(2)
    factor, x = rng.normal(size=(3, 4, 4)), bodies.symmetric(rng, 3)
    moved = (spd.congruence_matrix(factor) @ spd.to_vector(x)[..., None])[..., 0]
    expected = spd.to_vector(factor @ x @ factor.swapaxes(-1, -2))
    np.testing.assert_allclose(moved, expected, rtol=0, atol=100 * ROUNDING)
