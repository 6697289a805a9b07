"""Moments of solids: closed forms against integration on points, meshes against primitives, and how moments move."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, Delaunay
from scipy.stats import qmc

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model import shapes
from geomid_ros.types import FloatArray, IntArray

SIZE = np.array([0.3, 0.5, 0.7])
SURFACE = trimesh.creation.box(SIZE)


def points_in(low: FloatArray, high: FloatArray, inside: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Moments by integration over evenly spread points of a box: an independent route to a per mille."""
    points = qmc.scale(qmc.Sobol(3, rng=0).random_base2(18), low, high)
    kept = np.column_stack([points, np.ones(len(points))])[inside(points)]
    return float(np.prod(high - low)) / len(points) * kept.T @ kept


def assert_close(found: FloatArray, expected: FloatArray, share: float) -> None:
    """Every moment agrees within a share of the size that it could have."""
    sizes = np.sqrt(np.diag(expected))
    assert np.all(np.abs(found - expected) <= share * np.outer(sizes, sizes)), found - expected


@pytest.mark.parametrize(
    ("moments", "mass", "inertia"),
    [
        (shapes.sphere(2.0), 4 / 3 * np.pi * 8, [0.4 * 4] * 3),
        (shapes.cylinder(2.0, 3.0), 12 * np.pi, [(3 * 4 + 9) / 12, (3 * 4 + 9) / 12, 0.5 * 4]),
        (shapes.box(np.array([1.0, 2.0, 3.0])), 6.0, [13 / 12, 10 / 12, 5 / 12]),
    ],
)
def test_textbook_inertias(moments: FloatArray, mass: float, inertia: list[float]) -> None:
    parameters = pseudo_inertia.to_parameters(moments)
    np.testing.assert_allclose(parameters[0], mass, rtol=1e-14)
    expected = mass * np.diag(inertia)
    np.testing.assert_allclose(pseudo_inertia.rotational_inertia(parameters), expected, rtol=1e-13, atol=1e-13)


def test_the_mesh_of_a_box_is_the_box() -> None:
    np.testing.assert_allclose(shapes.polyhedron(SURFACE.vertices, SURFACE.faces), shapes.box(SIZE), atol=1e-16)


def random_hull(rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    points = rng.normal(size=(12, 3)) + rng.normal(size=3)
    hull = ConvexHull(points)
    triangles = hull.simplices.copy()
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normals * (corners[:, 0] - points.mean(axis=0)), axis=1) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return points, triangles


def test_any_polyhedron_against_points() -> None:
    points, triangles = random_hull(np.random.default_rng(1))
    cells = Delaunay(points)
    found = points_in(points.min(axis=0), points.max(axis=0), lambda p: cells.find_simplex(p) >= 0)
    assert_close(shapes.polyhedron(points, triangles), found, 3e-3)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_moments_follow_any_affine_map(mirror: float) -> None:
    """Motions, scales and mirrors: to move the corners is to move the moments."""
    rng = np.random.default_rng(1)
    points, triangles = random_hull(rng)
    placement = np.eye(4)
    placement[:3] = rng.normal(size=(3, 4))
    placement[:3, 0] *= mirror * np.sign(np.linalg.det(placement[:3, :3]))
    corners = points @ placement[:3, :3].T + placement[:3, 3]
    expected = shapes.polyhedron(corners, triangles if mirror > 0.0 else triangles[:, ::-1])
    assert shapes.volume(expected) > 0.0
    assert_close(shapes.moved(shapes.polyhedron(points, triangles), placement), expected, 1e-12)


def test_far_from_the_origin_little_is_lost() -> None:
    """A link of 10 cm, 10 m from its frame: its own inertia is 1e-4 of the moments there."""
    small, offset = np.full(3, 0.1), np.array([10.0, -5.0, 3.0])
    mesh = trimesh.creation.box(small)
    parameters = pseudo_inertia.to_parameters(shapes.polyhedron(mesh.vertices + offset, mesh.faces))
    central = pseudo_inertia.central_inertia(parameters)
    np.testing.assert_allclose(central, np.eye(3) * 1e-3 * 0.02 / 12, rtol=1e-8, atol=1e-14)
