"""Bodies of a robot as ellipsoids of visible size, and their projection onto the picture.

The projection is orthographic, in which the outline of an ellipsoid is an ellipse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.report.page import round_step
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Equivalent uniform ellipsoid of a body in the pose of the robot, in the world frame.

    ``centre (3,)`` and ``semi_axes (3,)`` [m], ``axes (3, 3)`` with their directions as columns, ``mass`` [kg].
    """

    centre: FloatArray
    semi_axes: FloatArray
    axes: FloatArray
    mass: float

    @staticmethod
    def of(parameters: FloatArray, rotation: FloatArray, origin: FloatArray) -> Ellipsoid:
        """Ellipsoid of inertial ``parameters (10,)`` of a link, given the pose of its frame in the world."""
        semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(parameters)
        centre = origin + rotation @ pseudo_inertia.centre_of_mass(parameters)
        return Ellipsoid(centre, semi_axes, rotation @ axes, float(parameters[0]))

    @property
    def is_finite(self) -> bool:
        """True if the ellipsoid can be drawn."""
        return all(np.all(np.isfinite(part)) for part in (self.centre, self.semi_axes, self.axes))

    def reach_from(self, origin: FloatArray) -> float:
        """Largest reach from an ``origin (3,)`` [m]."""
        return float(np.linalg.norm(self.centre - origin) + np.max(self.semi_axes))


@dataclass(frozen=True, eq=False)
class BodyDrawing:
    """Link to draw.

    Attributes:
        name: name of the link.
        origin: origin of its frame in the world, ``(3,)`` [m].
        parent_origin: start of the stick to it, ``(3,)`` [m]; None for no stick.
        prior, identified: its body before and after.
        from_data: fraction of the prior variance that the data removed, 0 to 1.
        std_mass: standard deviation of the identified mass [kg], NaN if unknown.
    """

    name: str
    origin: FloatArray
    parent_origin: FloatArray | None
    prior: Ellipsoid
    identified: Ellipsoid
    from_data: float
    std_mass: float = np.nan


@dataclass(frozen=True, eq=False)
class View:
    """Orthographic view: the rows of ``rotation (3, 3)`` point right, up, and towards the viewer."""

    rotation: FloatArray

    def flat(self, points: FloatArray) -> FloatArray:
        """Project world points ``(..., 3)`` onto the picture ``(..., 2)`` [m]."""
        return points @ self.rotation[:2].T

    def depth(self, point: FloatArray) -> float:
        """Depth of a point [m]; larger is nearer to the viewer."""
        return float(self.rotation[2] @ point)

    def sphere_map(self, body: Ellipsoid) -> FloatArray:
        """Matrix ``(3, 3)`` [m] that maps the unit sphere to the ellipsoid about its centre, in the view's axes."""
        return self.rotation @ (body.axes * body.semi_axes)

    def outline(self, body: Ellipsoid) -> FloatArray:
        """Outline ``(2, K)`` of the ellipsoid on the picture [m]: the unit circle under ``U S``, where ``U S V^T`` are
        the first two rows of its sphere map."""
        turn, stretch, _ = np.linalg.svd(self.sphere_map(body)[:2])
        return np.asarray(self.flat(body.centre)[:, None] + (turn * stretch) @ circle())

    def half_widths(self, body: Ellipsoid) -> FloatArray:
        """Half the extent of the ellipsoid on the picture, ``(2,)`` [m]."""
        return np.asarray(np.linalg.norm(self.sphere_map(body)[:2], axis=1))


def reach_of(bodies: Sequence[BodyDrawing]) -> float:
    """Largest reach of a body from its link's origin [m] that fits the picture: the size of the robot, or three times
    the median reach where the frames lie close together."""
    robot = float(np.linalg.norm(np.ptp(stick_ends(bodies), axis=0)))
    reaches = [body.prior.reach_from(body.origin) for body in bodies]
    finite = [reach for reach in reaches if np.isfinite(reach)]
    return max(robot, 3.0 * float(np.median(finite)) if finite else 0.0) or 1.0


def thickened(body: BodyDrawing, least: float) -> BodyDrawing:
    """Return the body with semi-axes of at least ``least`` [m], so that it is visible."""
    prior, identified = (
        replace(solid, semi_axes=np.maximum(np.abs(solid.semi_axes), least)) for solid in (body.prior, body.identified)
    )
    return replace(body, prior=prior, identified=identified)


def solids_within(bodies: Sequence[BodyDrawing], reach: float) -> list[Ellipsoid]:
    """Select the ellipsoids within ``reach`` [m] of their link's origin."""
    pairs = [(body.origin, solid) for body in bodies for solid in (body.prior, body.identified)]
    return [solid for origin, solid in pairs if solid.reach_from(origin) <= reach]


def stick_ends(bodies: Sequence[BodyDrawing]) -> FloatArray:
    """End points of the sticks ``(K, 3)`` [m]."""
    return np.array([end for body in bodies for end in (body.parent_origin, body.origin) if end is not None])


def view_of(points: FloatArray) -> View:
    """View from slightly above, across the main horizontal direction of ``points (K, 3)``, turned a little for depth.

    A humanoid that faces x is seen from the front, an arm that reaches along x from its right.
    """
    level = points[:, :2] - points[:, :2].mean(axis=0)
    variances, directions = np.linalg.eigh(level.T @ level)
    default, azimuth = np.radians(-45.0), np.radians(-60.0)
    if variances[1] > 1e-3 * np.sum((points - points.mean(axis=0)) ** 2):
        across = directions[:, 0] * np.where(directions[:, 0] @ (1.0, -1.0) < 0.0, -1.0, 1.0)
        offset = np.angle(np.exp(1j * (np.arctan2(across[1], across[0]) - default)))
        azimuth = default + offset - np.clip(offset, -np.radians(25.0), np.radians(25.0))
    elevation = np.radians(16.0)
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return View(np.array([right, np.cross(towards, right), towards]))


def bounds(rotation: FloatArray, points: FloatArray, solids: Sequence[Ellipsoid]) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest coordinates ``(k,)`` [m] of points ``(K, 3)`` and ellipsoids along the rows of a
    ``rotation (k, 3)``."""
    ends = [points @ rotation.T]
    for solid in solids:
        half = np.linalg.norm(rotation @ (solid.axes * solid.semi_axes), axis=1)
        ends.append(rotation @ solid.centre + np.array([-half, half]))
    return np.vstack(ends).min(axis=0), np.vstack(ends).max(axis=0)


def circle() -> FloatArray:
    """Points of the closed unit circle ``(2, K)``."""
    angle = np.linspace(0.0, 2.0 * np.pi, 97)
    return np.array([np.cos(angle), np.sin(angle)])


def floor_below(points: FloatArray, solids: Sequence[Ellipsoid]) -> tuple[FloatArray, float]:
    """Grid below points ``(K, 3)`` and ellipsoids: crossings ``(rows, columns, 3)``, distance of the lines [m]."""
    low, high = bounds(np.eye(3), points, solids)
    step = round_step((float(np.max(high - low)) or 1.0) / 10.0)
    x, y = (step * np.arange(np.floor(low[k] / step), np.ceil(high[k] / step) + 1.0) for k in range(2))
    return np.stack(np.broadcast_arrays(x[:, None], y[None, :], low[2]), axis=-1), step
