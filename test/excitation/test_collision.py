"""Distances: of bodies whose distance is known, their derivatives, and the bound on how fast they change."""

from __future__ import annotations

import numpy as np

from geomid_ros.model.collision import CollisionModel, ConvexShape, HalfSpace
from geomid_ros.model.robot import Robot

from .arm import small_task, urdf

CORNERS = np.array(np.meshgrid(*3 * [(-0.5, 0.5)])).reshape(3, -1).T


def boxes(obstacle: ConvexShape | HalfSpace) -> CollisionModel:
    """A box of 0.1 m at the end of the arm, and an obstacle."""
    shape = ConvexShape("fore", 0.1 * CORNERS + np.array([0.0, 0.0, 0.4]))
    return CollisionModel(Robot(urdf()), {"fore": [shape]}, [obstacle])


def test_the_distance_of_boxes_and_of_a_plane() -> None:
    # The arm stands upright: the centre of the box is at 0.1 + 0.35 + 0.45 + 0.4 m.
    beside = ConvexShape("beside", 0.2 * CORNERS + np.array([0.5, 0.0, 1.3]))
    upright = np.zeros((1, 3))
    assert np.allclose(boxes(beside).distances(upright), 0.5 - 0.1 - 0.05, atol=1e-6)
    assert np.allclose(boxes(HalfSpace("floor", np.array([0.0, 0.0, 1.0]), 1.0)).distances(upright), 0.25, atol=1e-6)


def test_neighbours_are_no_pair_and_others_are() -> None:
    collision = small_task().feasibility.collision
    assert collision is not None
    assert {(pair.first, pair.second) for pair in collision.pairs} == {
        ("base", "upper"),
        ("base", "fore"),
        ("turret", "fore"),
    }


def test_derivatives_of_distances() -> None:
    collision = boxes(ConvexShape("beside", 0.2 * CORNERS @ np.diag([1, 2, 3]) + np.array([0.6, 0.2, 0.9])))
    position, step = np.array([0.4, 0.5, 0.3]), 1e-5
    values, slopes = collision.gradients(position, np.array([0]))
    assert values == np.asarray(collision.distances(position[None])[0]).item() or np.allclose(
        values, collision.distances(position[None])[0], atol=1e-5
    )
    numeric = [
        (collision.distances((position + e)[None]) - collision.distances((position - e)[None]))[0, 0] / (2.0 * step)
        for e in step * np.eye(3)
    ]
    assert np.allclose(slopes[0], numeric, atol=1e-3)


def test_no_distance_changes_faster_than_its_bound() -> None:
    collision = small_task().feasibility.collision
    assert collision is not None
    random = np.random.default_rng(2)
    position = random.uniform(-2.0, 2.0, (300, 3))
    moved = position + random.uniform(-0.05, 0.05, position.shape)
    change = np.abs(collision.distances(moved) - collision.distances(position))
    apart = np.minimum(collision.distances(moved), collision.distances(position)) > 0.0
    bound = np.abs(moved - position) @ (collision.reach @ collision.coupling_sizes).T
    assert np.all(change[apart] <= bound[apart] + 1e-6)
    assert np.max(change[apart] / bound[apart]) > 0.3  # it is not just large
