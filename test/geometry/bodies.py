"""Random bodies, points and rows, made without the code under test: a body is a cloud of point masses."""

from __future__ import annotations

import numpy as np
from scipy.linalg import logm

from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

PINOCCHIO_PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def rotation(rng: np.random.Generator) -> FloatArray:
    """A uniformly random rotation ``(3, 3)``."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def cloud(rng: np.random.Generator, count: int = 12) -> tuple[FloatArray, FloatArray]:
    """Masses ``(count,)`` [kg] and positions ``(count, 3)`` [m] of a body between a finger's and a torso's size."""
    total = 10.0 ** rng.uniform(-3.0, 2.0)
    sizes = 0.08 * total ** (1.0 / 3.0) * rng.uniform(0.3, 2.0, size=3)
    masses = total * rng.dirichlet(np.ones(count))
    positions = (rng.normal(size=(count, 3)) + rng.normal(size=3)) * sizes
    return masses, positions @ rotation(rng).T


def parameters_of_cloud(masses: FloatArray, positions: FloatArray) -> FloatArray:
    """The ten parameters from their definitions as sums over point masses, in pinocchio's order."""
    inertia = np.zeros((3, 3))
    for mass, r in zip(masses, positions, strict=True):
        inertia += mass * (r @ r * np.eye(3) - np.outer(r, r))
    return np.array([masses.sum(), *(masses @ positions), *(inertia[pair] for pair in PINOCCHIO_PAIRS)])


def pseudo_inertia_of_cloud(masses: FloatArray, positions: FloatArray) -> FloatArray:
    """The integral of (3), for point masses."""
    homogeneous = np.column_stack([positions, np.ones(len(masses))])
    return sum(mass * np.outer(r, r) for mass, r in zip(masses, homogeneous, strict=True))


def links(rng: np.random.Generator, count: int) -> FloatArray:
    """Parameters ``(count, 10)`` of random bodies of very different size."""
    return np.array([parameters_of_cloud(*cloud(rng)) for _ in range(count)])


def spd(rng: np.random.Generator, *shape: int, spread: float = 1.0) -> FloatArray:
    """Random SPD matrices ``(*shape, 4, 4)``, the logarithms of whose eigenvalues have deviation ``spread``."""
    vectors = np.linalg.qr(rng.normal(size=(*shape, 4, 4)))[0]
    values = np.exp(spread * rng.normal(size=(*shape, 1, 4)))
    matrices = (vectors * values) @ np.swapaxes(vectors, -1, -2)
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))


def symmetric(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Random symmetric matrices ``(*shape, 4, 4)``."""
    matrices = rng.normal(size=(*shape, 4, 4))
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))


def logarithm(base: FloatArray, point: FloatArray) -> FloatArray:
    """The logarithm (8) of matrices ``(N, n, n)`` as ``P log(P^-1 Q)``, by the logarithm of general matrices."""
    return np.array([p @ logm(np.linalg.solve(p, q)) for p, q in zip(base, point, strict=True)])


def point(rng: np.random.Generator, manifold: ParameterManifold) -> Point:
    """A random point: clouds for the links, positives over four decades, reals of their scales' size."""
    positives = 10.0 ** rng.uniform(-3.0, 1.0, size=manifold.positives)
    reals = manifold.scales * rng.normal(size=len(manifold.scales))
    return manifold.point(np.concatenate([links(rng, manifold.links).ravel(), positives, reals]))


def near(rng: np.random.Generator, manifold: ParameterManifold, base: Point, distance: float) -> Point:
    """A point at this geodesic distance from ``base``, in a random direction."""
    tangent = rng.normal(size=manifold.dimension)
    return manifold.exp(base, distance * tangent / np.linalg.norm(tangent))


def rows(rng: np.random.Generator, manifold: ParameterManifold, base: Point, count: int) -> FloatArray:
    """Rows ``(count, D)`` to which every block contributes alike at ``base``, whatever its size."""
    blocks = [np.linalg.inv(manifold.jacobian(base)[0]), manifold.jacobian(base)[1]]
    tangent = rng.normal(size=(count, manifold.dimension))
    inertial = np.einsum("nlk,lkj->nlj", tangent[:, manifold.inertial].reshape(count, -1, 10), blocks[0])
    return np.hstack([inertial.reshape(count, -1), tangent[:, manifold.inertial.stop :] / blocks[1]])
