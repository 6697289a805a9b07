"""Moments of solid shapes: volume, first and second moments in one symmetric 4x4 matrix.

The moments of a solid are ``M = integral of (r, 1)(r, 1)^T dV``: its pseudo-inertia (3) at density 1, with the volume
in the last corner. A solid of constant density has the pseudo-inertia ``density M``. Moments of solids that do not
overlap add up; affine maps of homogeneous coordinates move and scale them.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray, IntArray


def box(size: FloatArray) -> FloatArray:
    """Moments ``(4, 4)`` of a box with edges ``size (3,)`` [m] about its centre."""
    volume = float(np.prod(size))
    return volume * np.diag([*(np.asarray(size) ** 2 / 12.0), 1.0])


def cylinder(radius: float, length: float) -> FloatArray:
    """Moments ``(4, 4)`` about its centre of a cylinder with axis z; sizes in m."""
    volume = np.pi * radius**2 * length
    across = radius**2 / 4.0
    return volume * np.diag([across, across, length**2 / 12.0, 1.0])


def sphere(radius: float) -> FloatArray:
    """Moments ``(4, 4)`` about its centre of a ball; radius in m."""
    volume = 4.0 / 3.0 * np.pi * radius**3
    return volume * np.diag([*np.full(3, radius**2 / 5.0), 1.0])


def polyhedron(vertices: FloatArray, triangles: IntArray) -> FloatArray:
    """Moments ``(4, 4)`` of the solid inside closed, outward facing ``triangles (T, 3)`` of ``vertices (V, 3)`` [m].

    They are sums over signed tetrahedra from one point to every triangle. With corners x_k in homogeneous coordinates
    and s their sum, a tetrahedron of volume v has the moments ``v/20 (sum x_k x_k^T + s s^T)``. The point is in the
    middle, where cancellation is least.
    """
    homogeneous = np.column_stack([vertices, np.ones(len(vertices))])
    corners = np.empty((len(triangles), 4, 4))  # tetrahedron, corner, coordinate
    corners[:, :3] = homogeneous[triangles]
    corners[:, 3] = homogeneous.mean(axis=0)
    volumes = np.linalg.det(corners[:, :3, :3] - corners[:, 3:, :3]) / 6.0
    weighted = volumes[:, None, None] * corners / 20.0
    total = corners.sum(axis=1)
    return np.asarray(np.einsum("tki,tkj->ij", weighted, corners) + (volumes / 20.0 * total.T) @ total)


def moved(moments: FloatArray, placement: FloatArray) -> FloatArray:
    """Transform moments ``(4, 4)`` by an affine map ``(4, 4)`` of homogeneous coordinates: motion, scale or mirror."""
    stretch = abs(float(np.linalg.det(placement[:3, :3])))
    return stretch * placement @ moments @ placement.T


def volume(moments: FloatArray) -> float:
    """Volume of a solid [m^3]."""
    return float(moments[3, 3])
