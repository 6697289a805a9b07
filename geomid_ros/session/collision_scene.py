"""What a robot must not touch: itself, and what a user says is around it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.shapes.shapes import link_shapes, obstacles
from geomid_ros.model.collision import CollisionModel, Pair
from geomid_ros.model.robot import Robot
from geomid_ros.session.options import Surroundings, texts
from geomid_ros.types import FloatArray

NOT_LOOKED = "collisions are not looked for (--no-collision): watch the robot"
_NEIGHBOURS = 2  # joints between links whose hulls may overlap all the time


def collision_model(around: Surroundings, robot: Robot, source: Path) -> CollisionModel | None:
    """The shapes of a robot, whose URDF is of the file ``source``, and the obstacles; None if nobody looks.

    Raises InputError: the URDF has no shapes, or one cannot be read.
    """
    if not around.collision:
        if around.avoid:
            raise InputError("--avoid and --no-collision exclude each other")
        return None
    avoided = [obstacle for text in texts(around.avoid) for obstacle in obstacles(text)]
    return CollisionModel(robot, link_shapes(robot.urdf, source, around.package_path or {}), avoided)


def without_touching(collision: CollisionModel, start: FloatArray) -> tuple[Pair, ...]:
    """Leave out pairs of links that overlap where a motion begins ``(J,)`` and are only two joints apart: their hulls
    are too rough. Returns them."""
    touching = collision.distances(start[None])[0] <= 0.0
    touching &= np.count_nonzero(collision.reach, axis=1) <= _NEIGHBOURS
    touching &= np.array([not pair.is_obstacle for pair in collision.pairs], dtype=bool)
    pairs = tuple(collision.pairs[place] for place in np.flatnonzero(touching))
    collision.without(np.flatnonzero(touching))
    return tuple(dict.fromkeys(pairs))


def not_watched(pairs: Sequence[Pair]) -> str:
    """Which pairs are left out, in a sentence; empty for none."""
    named = "; ".join(map(str, pairs))
    return f"not watched, as their convex hulls overlap at the start already: {named}" if named else ""
