"""Which rows are the same row: sparse, satisfied, zero, scaled, batched, seen from other frames and in other units."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.geometry import projection, pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.geometry.projection import NO_ROOT_HIGH, NO_ROOT_LOW, ROOT

from . import bodies
from .planes import (
    ALL,
    SHAPES,
    neighbourhood,
    norms,
    one,
    problem,
    project,
)

pytestmark = pytest.mark.usefixtures("either")

ROUNDING = 1e-9


def test_a_sparse_row_projects_as_on_the_manifold_of_its_blocks() -> None:
    """The second of three links, the first positive, no real: as if nothing else existed."""
    point, rows, targets = problem(1, ALL, 20, 0.0)
    kept = np.r_[ALL.link(1), ALL.positive.start]
    sparse = np.zeros_like(rows)
    sparse[:, kept] = rows[:, kept]
    small = ParameterManifold(1, 1, np.zeros(0))
    targets = sparse @ point.parameters + 0.5 * norms(ALL, point, sparse)
    whole, part = (
        project(ALL, point, sparse, targets),
        project(small, small.point(point.parameters[kept]), rows[:, kept], targets),
    )
    np.testing.assert_array_equal(whole.status, part.status)
    np.testing.assert_allclose(whole.half_squared, part.half_squared, rtol=1e-8, atol=ROUNDING)
    np.testing.assert_allclose(whole.tangent[:, kept], part.tangent, rtol=0, atol=1e-7)
    np.testing.assert_allclose(whole.direction[:, kept], part.direction, rtol=0, atol=1e-7)
    np.testing.assert_allclose(whole.curvature[np.ix_(kept, kept)], part.curvature, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("target", "status"), [(0.0, ROOT), (1.0, NO_ROOT_LOW), (-1.0, NO_ROOT_HIGH)])
def test_a_zero_row_moves_nothing(target: float, status: int) -> None:
    point = bodies.point(np.random.default_rng(0), ALL)
    found = one(ALL, point, np.zeros(ALL.dimension), target)
    assert found.status[0] == status
    assert found.half_squared[0] == 0.0
    assert not np.any(found.tangent)
    assert not np.any(found.direction)
    assert not np.any(found.curvature)


def test_rows_do_not_disturb_each_other() -> None:
    """Batched, singly and reversed, with zero, sparse and rootless rows among them."""
    point, rows, targets = problem(1, ALL, 12, 4.0)
    rows[3], rows[5, ALL.link(0)], rows[8, : ALL.real.start] = 0.0, 0.0, 0.0
    normals = ALL.whiten(point, rows)
    together = projection.project(ALL, point, normals, targets)
    reverse = projection.project(ALL, point, normals[::-1], targets[::-1])
    for k in range(12):
        single = projection.project(ALL, point, normals[k : k + 1], targets[k : k + 1])
        for name in ("half_squared", "tangent", "direction", "status"):
            np.testing.assert_array_equal(getattr(together, name)[k], getattr(single, name)[0])
            np.testing.assert_array_equal(getattr(reverse, name)[11 - k], getattr(single, name)[0])


@SHAPES
def test_measuring_gives_the_values_of_projecting(manifold: ParameterManifold) -> None:
    point, rows, targets = problem(1, manifold, 30, 4.0)
    rows[3] = 0.0
    normals = manifold.whiten(point, rows)
    found = projection.project(manifold, point, normals, targets)
    half, status = projection.measure(manifold, point, normals, targets)
    np.testing.assert_array_equal(status, found.status)
    np.testing.assert_allclose(half, found.half_squared, rtol=ROUNDING, atol=0)


def test_the_length_and_sign_of_a_row_do_not_matter() -> None:
    point, rows, targets = neighbourhood(1, ALL)
    found = project(ALL, point, rows, targets)
    for factor in (-1.0, 1e-6, 1e6):
        scaled = project(ALL, point, factor * rows, factor * targets)
        np.testing.assert_array_equal(scaled.status, found.status)
        np.testing.assert_allclose(scaled.half_squared, found.half_squared, rtol=1e-8, atol=ROUNDING)
        np.testing.assert_allclose(scaled.tangent, found.tangent, rtol=0, atol=1e-7)


def test_the_distance_to_a_hyperplane_has_no_frame_and_no_units() -> None:
    """Every link gets its own frame and units, coefficients too; rows follow, so that a . parameters stays."""
    point, rows, targets = problem(1, ALL, 20, 4.0)
    rng = np.random.default_rng(1)
    linear = np.diag(np.concatenate([np.ones(10 * ALL.links), 10.0 ** rng.uniform(-2.0, 2.0, size=4)]))
    for k in range(ALL.links):
        length, mass = 10.0 ** rng.uniform(-1.0, 1.0, size=2)
        factor = pseudo_inertia.change_of_frame(bodies.rotation(rng), 0.3 * rng.normal(size=3))
        factor = np.sqrt(mass) * np.diag([*np.full(3, length), 1.0]) @ factor
        images = spd.congruence(factor, pseudo_inertia.from_parameters(np.eye(10)))
        linear[ALL.link(k), ALL.link(k)] = pseudo_inertia.to_parameters(images).T
    moved = ParameterManifold(ALL.links, ALL.positives, ALL.scales * np.diag(linear)[ALL.real])
    here = project(ALL, point, rows, targets)
    there = project(moved, moved.point(linear @ point.parameters), rows @ np.linalg.inv(linear), targets)
    np.testing.assert_array_equal(there.status, here.status)
    np.testing.assert_allclose(there.half_squared, here.half_squared, rtol=1e-6, atol=1e-9)
