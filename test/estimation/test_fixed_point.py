"""Extrapolated fixed-point iterations."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.estimation.solvers import Extrapolation


@pytest.mark.parametrize("seed", range(2))
def test_a_linear_iteration_is_at_its_fixed_point_after_one_round_more_than_it_has_dimensions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 4
    basis = rng.standard_normal((size, size))
    matrix = basis @ np.diag(rng.uniform(0.3, 0.9, size)) @ np.linalg.inv(basis)
    shift = rng.standard_normal(size)
    exact = np.linalg.solve(np.eye(size) - matrix, shift)
    extrapolation, begun = Extrapolation(), np.zeros(size)
    for _ in range(size + 1):
        begun = extrapolation.next(begun, matrix @ begun + shift)
    np.testing.assert_allclose(begun, exact, rtol=1e-6, atol=1e-6 * float(np.linalg.norm(exact)))


def test_at_the_fixed_point_it_stays() -> None:
    extrapolation, at = Extrapolation(), np.array([1.0, -2.0])
    for _ in range(10):
        np.testing.assert_array_equal(extrapolation.next(at, at), at)


def test_what_is_not_linear_at_all_is_not_extrapolated_far() -> None:
    extrapolation = Extrapolation()
    extrapolation.next(np.array([0.0]), np.array([1.0]))
    ended = np.array([2.0])
    np.testing.assert_array_equal(extrapolation.next(np.array([1.001]), ended), ended)
