"""The weighted Karcher mean (23)."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.mean import karcher_mean
from geomid_ros.types import FloatArray

from . import bodies

STATIONARY = 1e-9  # geodesic length
SEEDS = pytest.mark.parametrize("seed", range(6))
ALL = ParameterManifold(2, 2, np.array([0.1, 20.0]))
LINK = ParameterManifold(1, 0, np.zeros(0))


def sample(seed: int, manifold: ParameterManifold, count: int) -> tuple[list[Point], FloatArray]:
    rng = np.random.default_rng(seed)
    return [bodies.point(rng, manifold) for _ in range(count)], rng.uniform(0.2, 5.0, size=count)


def of_matrices(matrices: FloatArray) -> list[Point]:
    return [Point(matrix[None], np.zeros(0), np.zeros(0)) for matrix in matrices]


@SEEDS
def test_weighted_logarithms_at_the_mean_cancel(seed: int) -> None:
    points, weights = sample(seed, ALL, 7)
    mean = karcher_mean(ALL, points, weights)
    gradient = sum(w * ALL.log(mean, p) for w, p in zip(weights, points, strict=True)) / weights.sum()
    assert float(np.linalg.norm(gradient)) <= STATIONARY


@SEEDS
def test_no_other_point_has_a_smaller_sum(seed: int) -> None:
    points, weights = sample(seed, ALL, 5)
    mean, rng = karcher_mean(ALL, points, weights), np.random.default_rng(seed)

    def objective(base: Point) -> float:
        return sum(w * ALL.distance(base, p) ** 2 for w, p in zip(weights, points, strict=True))

    for size in (1e-3, 0.1, 1.0):
        assert objective(bodies.near(rng, ALL, mean, size)) > objective(mean)


@SEEDS
def test_the_mean_of_matrices_is_pyriemanns(seed: int) -> None:
    reference = pytest.importorskip("pyriemann.utils.mean")
    rng = np.random.default_rng(seed)
    matrices, weights = bodies.spd(rng, 8), rng.uniform(0.2, 5.0, size=8)
    expected = reference.mean_riemann(matrices, sample_weight=weights, tol=1e-12, maxiter=500)
    found = karcher_mean(LINK, of_matrices(matrices), weights).pseudo_inertias[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@SEEDS
def test_the_mean_moves_with_gl4(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrices, weights = bodies.spd(rng, 5), rng.uniform(0.2, 5.0, size=5)
    g = rng.normal(size=(4, 4))
    there = karcher_mean(LINK, of_matrices(g @ matrices @ g.T), weights)
    here = karcher_mean(LINK, of_matrices(matrices), weights).pseudo_inertias[0]
    assert LINK.distance(there, of_matrices((g @ here @ g.T)[None])[0]) <= 1e-7


@SEEDS
@pytest.mark.parametrize("share", [0.5, 0.2])
def test_the_mean_of_two_points_lies_on_their_geodesic(seed: int, share: float) -> None:
    (a, b), _ = sample(seed, ALL, 2)
    mean = karcher_mean(ALL, [a, b], np.array([1.0 - share, share]))
    assert ALL.distance(mean, ALL.exp(a, share * ALL.log(a, b))) <= 10 * STATIONARY


@SEEDS
def test_positives_have_the_geometric_and_reals_the_arithmetic_mean(seed: int) -> None:
    points, weights = sample(seed, ALL, 6)
    mean = karcher_mean(ALL, points, weights)
    logarithms = np.average([np.log(p.positives) for p in points], axis=0, weights=weights)
    np.testing.assert_allclose(mean.positives, np.exp(logarithms), rtol=STATIONARY)
    np.testing.assert_allclose(mean.reals, np.average([p.reals for p in points], axis=0, weights=weights), atol=1e-8)


@SEEDS
def test_commuting_matrices_have_the_geometric_mean(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vectors, exponents = np.linalg.qr(rng.normal(size=(4, 4)))[0], rng.normal(size=(6, 4))
    matrices = np.array([(vectors * np.exp(e)) @ vectors.T for e in exponents])
    expected = (vectors * np.exp(exponents.mean(axis=0))) @ vectors.T
    found = karcher_mean(LINK, of_matrices(matrices), np.ones(6)).pseudo_inertias[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@SEEDS
def test_the_order_of_the_points_and_the_size_of_the_weights_do_not_matter(seed: int) -> None:
    points, weights = sample(seed, ALL, 5)
    mean = karcher_mean(ALL, points, weights)
    assert ALL.distance(mean, karcher_mean(ALL, points[::-1], 1e3 * weights[::-1])) <= 10 * STATIONARY


def test_the_mean_of_one_point_is_that_point() -> None:
    (point,), _ = sample(0, ALL, 1)
    assert ALL.distance(karcher_mean(ALL, [point], np.ones(1)), point) <= STATIONARY


@pytest.mark.parametrize("seed", [4, 25, 34, 39, 47])
def test_points_far_apart_have_a_mean(seed: int) -> None:
    """Bodies of a gram and of 100 kg, eigenvalue ratios of e^8 and more: plain gradient steps overshoot or crawl."""
    rng = np.random.default_rng(seed)
    matrices, weights = of_matrices(bodies.spd(rng, 6, spread=4.0)), rng.uniform(0.2, 5.0, size=6)
    for manifold, points, shares in ((LINK, matrices, weights), (ALL, *sample(seed, ALL, 7))):
        mean = karcher_mean(manifold, points, shares)
        gradient = shares @ np.array([manifold.log(mean, p) for p in points]) / shares.sum()
        assert float(np.linalg.norm(gradient)) <= STATIONARY
