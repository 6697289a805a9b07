"""Projection on hyperplanes within the neighbourhood: Proposition 2 and its extension to coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.geometry.projection import ROOT

from . import bodies
from .planes import (
    ALL,
    MASS,
    POSITIVE,
    SHAPES,
    neighbourhood,
    norms,
    one,
    project,
)

pytestmark = pytest.mark.usefixtures("either")

ON_THE_PLANE = 1e-11  # residual over the row's dual norm
ROUNDING = 1e-9


@SHAPES
def test_the_projected_point_lies_on_the_hyperplane_at_the_distance_that_is_said(manifold: ParameterManifold) -> None:
    point, rows, targets = neighbourhood(1, manifold)
    found = project(manifold, point, rows, targets)
    np.testing.assert_allclose(found.half_squared, 0.5 * np.sum(found.tangent**2, axis=1), rtol=ROUNDING)
    for row, target, tangent, length in zip(rows, targets, found.tangent, norms(manifold, point, rows), strict=True):
        there = manifold.exp(point, tangent)
        scale = max(length, float(np.abs(row) @ np.abs(there.parameters)) * 1e-4)
        assert abs(row @ there.parameters - target) <= ON_THE_PLANE * scale
        assert manifold.distance(point, there) == pytest.approx(np.linalg.norm(tangent), rel=ROUNDING)


def test_the_logarithm_back_is_the_multiplier_times_the_normal() -> None:
    """The first-order condition before (24): ``Log_Phat(P) = lambda Phat X Phat``, one lambda for all blocks.

    The same condition for a positive coefficient is ``-c-hat log(c-hat/c) = lambda c-hat a c-hat``, and for a real
    ``(r - r-hat)/scale^2 = lambda a``.
    """
    point, rows, targets = neighbourhood(1, ALL)
    found = project(ALL, point, rows, targets)
    for row, tangent in zip(rows, found.tangent, strict=True):
        there = ALL.exp(point, tangent)
        coefficients = np.tensordot(
            row[ALL.inertial].reshape(-1, 10), spd.to_matrix(pseudo_inertia.COEFFICIENTS_TO_COORDINATES), 1
        )
        multiplier = (point.reals - there.reals)[0] / (ALL.scales[0] ** 2 * row[ALL.real][0])
        back = bodies.logarithm(there.pseudo_inertias, point.pseudo_inertias)
        expected = multiplier * spd.congruence(there.pseudo_inertias, coefficients)
        sizes = np.max(np.abs(there.pseudo_inertias), axis=(1, 2), keepdims=True)
        np.testing.assert_allclose(back / sizes, expected / sizes, rtol=0, atol=1e-7)
        expected = multiplier * there.positives * row[ALL.positive]
        np.testing.assert_allclose(np.log(point.positives / there.positives), expected, rtol=0, atol=1e-8)
        expected = multiplier * ALL.scales * row[ALL.real]
        np.testing.assert_allclose((point.reals - there.reals) / ALL.scales, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("count", [1, 4])
def test_a_mass_row_moves_every_link_by_its_own_share(count: int) -> None:
    """Rank one: the row's only eigenvalue in a link is that link's mass. One link: its mass becomes the target."""
    rng, manifold = np.random.default_rng(1), ParameterManifold(count, 0, np.zeros(0))
    point = bodies.point(rng, manifold)
    masses = point.parameters[::10]
    target = float(masses.sum()) * rng.uniform(0.3, 1.8)
    found = one(manifold, point, np.tile(MASS, count), target)
    moved = manifold.exp(point, found.tangent[0]).parameters[::10]
    assert found.status[0] == ROOT
    assert moved.sum() == pytest.approx(target, rel=ROUNDING)
    ratios = moved / masses  # log(ratio)/ratio = -multiplier * mass
    np.testing.assert_allclose(np.log(ratios) / moved, np.log(ratios[0]) / moved[0], rtol=1e-6, atol=1e-9)
    assert found.half_squared[0] == pytest.approx(0.5 * np.sum(np.log(ratios) ** 2), rel=1e-8, abs=ROUNDING)


@pytest.mark.parametrize("ratio", [1e-3, 1e-9, 1e-12, 1e-15, 1e-20])
def test_targets_near_zero_are_reached_with_relative_accuracy(ratio: float) -> None:
    """The distance is logarithmic: a coefficient of 1e-12 of what it was is not one of 1.01e-12."""
    found = one(POSITIVE, POSITIVE.point(np.array([2.0])), np.array([3.0]), 6.0 * ratio)
    assert found.status[0] == ROOT
    assert found.tangent[0, 0] == pytest.approx(np.log(ratio), rel=ROUNDING)
