"""Random hyperplanes near and far, shared by the tests of the projection."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import lambertw

from geomid_ros.geometry import projection, pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.projection import NO_ROOT_LOW, ROOT, Projection
from geomid_ros.types import FloatArray

from . import bodies

ALL = ParameterManifold(3, 2, np.array([0.1, 20.0]))
LINKS = ParameterManifold(2, 0, np.zeros(0))
LINK = ParameterManifold(1, 0, np.zeros(0))
POSITIVE = ParameterManifold(0, 1, np.zeros(0))
MASS = np.eye(10)[0]

SHAPES = pytest.mark.parametrize("manifold", [ALL, LINKS], ids=["all", "links"])


def project(manifold: ParameterManifold, point: Point, rows: FloatArray, targets: FloatArray) -> Projection:
    return projection.project(manifold, point, manifold.whiten(point, rows), targets)


def one(manifold: ParameterManifold, point: Point, row: FloatArray, target: float) -> Projection:
    return project(manifold, point, row[None], np.array([target]))


def norms(manifold: ParameterManifold, point: Point, rows: FloatArray) -> FloatArray:
    """The rows' dual norms ``(N,)`` at the point."""
    return np.linalg.norm(manifold.whiten(point, rows), axis=1)


def problem(seed: int, manifold: ParameterManifold, count: int, reach: float) -> tuple[Point, FloatArray, FloatArray]:
    """A point, rows, and targets up to ``reach`` dual norms away from what the point predicts."""
    rng = np.random.default_rng(seed)
    point = bodies.point(rng, manifold)
    rows = bodies.rows(rng, manifold, point, count)
    shifts = reach * rng.uniform(-1.0, 1.0, size=count) * norms(manifold, point, rows)
    return point, rows, rows @ point.parameters + shifts


def neighbourhood(seed: int, manifold: ParameterManifold, count: int = 40) -> tuple[Point, FloatArray, FloatArray]:
    """Rows that have their root, whatever the side and the distance."""
    point, rows, targets = problem(seed, manifold, count, 0.8)
    rooted = project(manifold, point, rows, targets).status == ROOT
    assert np.sum(rooted) >= 0.8 * count
    return point, rows[rooted], targets[rooted]


def beyond(
    seed: int, manifold: ParameterManifold, status: int, count: int = 10
) -> tuple[Point, FloatArray, FloatArray]:
    """Rows whose target lies beyond the neighbourhood on one side."""
    point, rows, targets = problem(seed, manifold, count, 0.0)
    targets += norms(manifold, point, rows) * (8.0 if status == NO_ROOT_LOW else -8.0)
    assert np.all(project(manifold, point, rows, targets).status == status)
    return point, rows, targets


def row_of(point: Point, bar: FloatArray) -> FloatArray:
    """The row of a single link whose X-bar at ``point`` this is: its value on each unit parameter vector."""
    x = spd.congruence(point.inverse_root[0], bar)
    return np.array([np.trace(x @ pseudo_inertia.from_parameters(unit)) for unit in np.eye(10)])


def spectrum(manifold: ParameterManifold, normal: FloatArray) -> FloatArray:
    """The eigenvalues s of a whitened row: of its links' X-bar, then its positives."""
    matrices = spd.to_matrix(normal[manifold.inertial].reshape(-1, 10))
    return np.concatenate([np.linalg.eigvalsh(matrices).ravel(), normal[manifold.positive]])


def end_of_the_interval(manifold: ParameterManifold, point: Point, row: FloatArray, side: int) -> float:
    """The target whose root is the lower or the upper end of the interval, from (21) itself."""
    normal = manifold.whiten(point, row[None])[0]
    s, reals = spectrum(manifold, normal), normal[manifold.real]
    multiplier = -1.0 / (np.e * (s.max() if side == NO_ROOT_LOW else s.min()))
    w = lambertw(multiplier * s * (1.0 - 1e-15)).real
    return float(s @ np.exp(-w) + reals @ (point.reals / manifold.scales) - multiplier * reals @ reals)
