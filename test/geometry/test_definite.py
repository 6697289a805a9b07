"""Symmetric positive definite matrices: as numpy has them, and what is done where rounding leaves them indefinite."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from geomid_ros.geometry import spd
from geomid_ros.types import FloatArray


def of_size(size: int) -> FloatArray:
    """A matrix of well-conditioned rows' products."""
    rows = np.random.default_rng(0).normal(size=(3 * size + 1, size))
    return np.asarray(rows.T @ rows)


@pytest.mark.usefixtures("either")
@pytest.mark.parametrize("size", [1, 2, 7, 60])
def test_they_are_solved_and_inverted_as_by_general_methods(size: int) -> None:
    matrix, right = of_size(size), np.arange(1.0, size + 1.0)
    given, both = matrix.copy(), np.column_stack([right, right**2.0])
    assert spd.solve_or_least_squares(matrix, right) == pytest.approx(np.linalg.solve(matrix, right), rel=1e-12)
    assert spd.solve_or_least_squares(matrix, both) == pytest.approx(np.linalg.solve(matrix, both), rel=1e-11)
    inverse = spd.inverse(matrix)
    assert inverse == pytest.approx(np.linalg.inv(matrix), rel=1e-12, abs=1e-15)
    assert np.array_equal(inverse, inverse.T)
    whitener = spd.whitener(matrix)
    assert whitener @ matrix @ whitener.T == pytest.approx(np.eye(size), abs=1e-12)
    assert any(np.array_equal(whitener, half(whitener)) for half in (np.tril, np.triu))
    assert np.array_equal(matrix, given)
    assert np.array_equal(right, np.arange(1.0, size + 1.0))


def of_limbs(size: int) -> FloatArray:
    """The same, in which every other unknown has rows of its own with the first ones alone, and all else are zeros."""
    matrix = of_size(size)
    limbs = np.arange(size) % 2 == 1
    matrix[np.ix_(limbs, limbs)] = np.diag(np.diag(matrix)[limbs])
    matrix[: size // 3, limbs] = matrix[limbs, : size // 3] = 0.0
    return matrix + size * np.eye(size)


def of_stretches(size: int) -> FloatArray:
    """One whose last unknown has rows with every other eight of the others, which have none together."""
    matrix = size * np.eye(size)
    felt = np.flatnonzero(np.arange(size - 1) // 8 % 2 == 0)
    matrix[-1, felt] = matrix[felt, -1] = 1.0
    return matrix


@pytest.mark.usefixtures("either")
@pytest.mark.parametrize(
    ("of", "size"), [*product([of_size, of_limbs], [1, 2, 7, 60]), (of_stretches, 60), (of_stretches, 600)]
)
def test_steps_and_variances_are_those_of_the_dense_inverse(of: Callable[[int], FloatArray], size: int) -> None:
    matrix, gradient, damping = of(size), np.arange(1.0, size + 1.0), 0.3
    given, inverse = matrix.copy(), np.linalg.inv(matrix + damping * np.eye(size))
    step, bend = spd.damped_step(matrix, gradient, damping)
    assert step == pytest.approx(-inverse @ gradient, rel=1e-9)
    assert bend == pytest.approx(step @ inverse @ step, rel=1e-9)
    count = (size + 1) // 2
    covariance = np.linalg.inv(matrix)[:count, :count]
    root = spd.roots(matrix, count)
    assert root @ root.T == pytest.approx(covariance, rel=1e-9, abs=1e-12)
    assert spd.variances(matrix, count) == pytest.approx(np.diag(covariance), rel=1e-9)
    assert spd.log_determinant(matrix) == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-9)
    assert np.array_equal(matrix, given)
    with pytest.raises(np.linalg.LinAlgError):
        spd.damped_step(matrix - 2.0 * np.max(np.diag(matrix)) * np.eye(size), gradient, 0.0)


def test_an_indefinite_one_is_solved_and_inverted_by_general_methods() -> None:
    matrix = np.diag([1.0, -2.0, 4.0])
    assert spd.variances(matrix, 1) == pytest.approx([1.0])
    assert spd.inverse(matrix) == pytest.approx(np.diag([1.0, -0.5, 0.25]))
    assert spd.solve_or_least_squares(matrix, np.ones(3)) == pytest.approx([1.0, -0.5, 0.25])


def test_a_whitener_of_one_that_rounding_made_indefinite_is_triangular_and_that_of_the_nearest() -> None:
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    whitener = spd.whitener((turn * [1.0, 4.0, -1e-17]) @ turn.T)
    assert whitener[np.tril_indices(3, -1)] == pytest.approx(0.0, abs=1e-6)
    large, *found = np.linalg.svd(whitener, compute_uv=False)
    assert found == pytest.approx([1.0, 0.5], rel=1e-6)
    assert 1e7 < large < np.inf
    assert spd.whitener(np.zeros((0, 0))).shape == (0, 0)
