"""Distances between a robot's links, and from links to obstacles, by coal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ConvexShape:
    """A convex body: the hull of ``vertices (V, 3)`` [m] in a link's frame, or in the base frame."""

    name: str
    vertices: FloatArray


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """All points x with ``normal . x <= offset`` in the base frame are solid; ``normal (3,)`` has length 1."""

    name: str
    normal: FloatArray
    offset: float


Obstacle: TypeAlias = ConvexShape | HalfSpace


@dataclass(frozen=True)
class Pair:
    """Names of two bodies that may collide; ``is_obstacle``: the second is an obstacle, not a link."""

    first: str
    second: str
    is_obstacle: bool = False

    def __str__(self) -> str:
        return f"{self.first} and {self.second}"


class CollisionModel:
    """Distances of all pairs of shapes that may collide; pairs on one rigid body or on neighbours are left out.

    Shapes of one link, and of links that are fixed to each other, belong to one rigid body.
    """

    def __init__(
        self, robot: Robot, shapes: Mapping[str, Sequence[ConvexShape]], obstacles: Sequence[Obstacle] = ()
    ) -> None:
        """Build the model; ``shapes`` by the link in whose frame they are expressed."""
        self.robot = robot
        self.shapes, self.obstacles = shapes, obstacles
        self._model = robot.pinocchio_model
        self._data = self._model.createData()
        self._geometry = pin.GeometryModel()
        self._owners: list[tuple[str, int, float]] = []  # name, joint, radius about the joint's origin
        for link, link_shapes in shapes.items():
            frame = self._model.frames[self._model.getFrameId(link, pin.BODY)]
            for shape in link_shapes:
                placed = shape.vertices @ frame.placement.rotation.T + frame.placement.translation
                self._add(link, frame.parentJoint, _hull(placed), float(np.max(np.linalg.norm(placed, axis=1))))
        self._links = len(self._owners)
        for obstacle in obstacles:
            self._add(obstacle.name, 0, _obstacle(obstacle))
        self._indices = [pair for pair in combinations(range(len(self._owners)), 2) if self._may_touch(*pair)]
        self._set_pairs()

    def _add(self, name: str, joint: int, shape: coal.CollisionGeometry, radius: float = 0.0) -> None:
        placed = pin.GeometryObject(f"{len(self._owners)} {name}", joint, pin.SE3.Identity(), shape)
        self._geometry.addGeometryObject(placed)
        self._owners.append((name, joint, radius))

    def _may_touch(self, first: int, second: int) -> bool:
        one, other = self._owners[first][1], self._owners[second][1]
        if second >= self._links:
            return first < self._links and one != 0
        parents = self._model.parents
        return one != other and parents[one] != other and parents[other] != one

    def _set_pairs(self) -> None:
        self._geometry.removeAllCollisionPairs()
        for first, second in self._indices:
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))
        self._geometry_data = self._geometry.createData()
        self.pairs = tuple(
            Pair(self._owners[i][0], self._owners[j][0], is_obstacle=j >= self._links) for i, j in self._indices
        )
        """Pairs of shapes, in the order of all arrays."""
        self.reach = np.array([self._reach(i, j) for i, j in self._indices]).reshape(-1, self._model.nv)
        """Upper bound of the relative speed of a pair's points per unit of each of pinocchio's velocities ``(pairs,
        nv)`` [m/rad]."""

    def _reach(self, first: int, second: int) -> FloatArray:
        """Bound the relative speed of two shapes ``(nv,)``: for each joint between them, the longest lever from the
        joint to the shape that it moves, over the joints between them and the travel of those that slide."""
        model, bounds = self._model, np.zeros(self._model.nv)
        for shape, other in ((first, second), (second, first)):
            shared = model.supports[self._owners[other][1]]
            lever = self._owners[shape][2]
            for joint in reversed(model.supports[self._owners[shape][1]]):
                if joint in shared:
                    break
                own = model.joints[joint]
                slides = "JointModelP" in own.shortname()
                bounds[own.idx_v] = 1.0 if slides else lever
                ends = model.lowerPositionLimit[own.idx_q], model.upperPositionLimit[own.idx_q]
                travel = float(np.max(np.abs(ends))) if slides else 0.0
                lever += float(np.linalg.norm(model.jointPlacements[joint].translation)) + travel
        return bounds

    def without(self, pairs: IntArray) -> None:
        """Drop ``pairs``, by index."""
        remaining = np.setdiff1d(np.arange(len(self._indices)), pairs)
        self._indices = [self._indices[index] for index in remaining.tolist()]
        self._set_pairs()

    def distances(self, position: FloatArray) -> FloatArray:
        """Compute distances ``(N, pairs)`` [m] at positions ``(N, joints)``; negative where shapes overlap."""
        table = np.empty((len(position), len(self.pairs)))
        for row, q in zip(table, self.robot.pinocchio_positions(position), strict=True):
            pin.computeDistances(self._model, self._data, self._geometry, self._geometry_data, q)
            row[:] = [result.min_distance for result in self._geometry_data.distanceResults]
        return table

    def gradients(self, position: FloatArray, pairs: IntArray) -> tuple[FloatArray, FloatArray]:
        """Compute distances of ``pairs (n,)`` at one ``position (joints,)``, and their gradients ``(n, joints)``."""
        (q,) = self.robot.pinocchio_positions(position[None])
        pin.computeJointJacobians(self._model, self._data, q)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data)
        values, slopes = np.empty(len(pairs)), np.empty((len(pairs), len(position)))
        for row, pair in enumerate(pairs.tolist()):
            nearest = pin.computeDistance(self._geometry, self._geometry_data, pair)
            values[row] = nearest.min_distance
            ends = nearest.getNearestPoint1(), nearest.getNearestPoint2()
            jacobians = [self._point_jacobian(shape, end) for shape, end in zip(self._indices[pair], ends, strict=True)]
            slopes[row] = (nearest.normal @ (jacobians[1] - jacobians[0])) @ self.robot.coupling
        return values, slopes

    def _point_jacobian(self, shape: int, point: FloatArray) -> FloatArray:
        """Compute the Jacobian ``(3, nv)`` of a point of a shape, in the world frame."""
        joint = self._owners[shape][1]
        if joint == 0:
            return np.zeros((3, self._model.nv))
        jacobian = pin.getJointJacobian(self._model, self._data, joint, pin.WORLD)
        return np.asarray(jacobian[:3] - pin.skew(point) @ jacobian[3:])


def _hull(vertices: FloatArray) -> coal.Convex:
    hull = ConvexHull(vertices)
    indices = np.full(len(vertices), -1)
    indices[hull.vertices] = np.arange(len(hull.vertices))
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend([vertices[index] for index in hull.vertices])
    centre = np.mean(vertices[hull.vertices], axis=0)
    for simplex in hull.simplices:
        a, b, c = vertices[simplex]
        outward = np.dot(np.cross(b - a, c - a), a - centre) > 0.0
        triangles.append(coal.Triangle(*(int(indices[index]) for index in (simplex if outward else simplex[::-1]))))
    return coal.Convex(points, triangles)


def _obstacle(obstacle: Obstacle) -> coal.CollisionGeometry:
    if isinstance(obstacle, HalfSpace):
        return coal.Halfspace(obstacle.normal, obstacle.offset)
    return _hull(obstacle.vertices)
