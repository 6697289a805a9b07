"""What is said to be feasible is, by finite differences and dense distances; and what is not is refused."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.excitation.search import random_feasible, random_motion
from geomid_ros.model.collision import CollisionModel, ConvexShape, HalfSpace
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import samples_of
from geomid_ros.session.options import MotionOptions

from .arm import small_task, urdf

TASK = small_task(MotionOptions(duration=6.0, repeats=1, avoid=("box:0.75,0,0.7,0.2,2,2",)))


def dense(motion: ExcitingMotion) -> np.ndarray:
    return motion.at(np.linspace(0.0, motion.form.duration, 6001))[0]


def test_the_lower_bounds_of_distances_hold_and_are_close() -> None:
    feasibility = TASK.feasibility
    motion = random_feasible(feasibility, TASK.form, np.random.default_rng(7))
    assert feasibility.collision is not None
    least = np.min(feasibility.collision.distances(dense(motion)), axis=0)
    bounds = feasibility.margins(motion).distance
    assert np.all(bounds <= least + 1e-9)
    assert np.all(bounds >= feasibility.clearances)


def test_limbs_that_may_be_legs_are_not_to_stand() -> None:
    limbs = urdf().replace('<parent link="turret"/>', '<parent link="base"/>')
    notes = small_task(text=limbs).notes
    assert "2 limbs begin at 'base', which must not move" in notes[0]
    assert not any("limbs" in note for note in TASK.notes)


def test_what_breaks_a_limit_is_not_held() -> None:
    feasibility = TASK.feasibility
    motion = random_motion(feasibility, TASK.form, np.random.default_rng(1))
    assert np.allclose(feasibility.largest_scale(motion), 1.0)
    assert np.allclose(feasibility.largest_scale(motion.scaled(2.0)), 0.5)
    # Through the box.
    reach = np.zeros((TASK.form.size, 3))
    reach[0, 1] = 1.0
    towards = ExcitingMotion(TASK.form, feasibility.start, reach)
    through = towards.scaled(1.5 / np.max(np.abs(towards.at(np.linspace(0.0, 6.0, 500))[0])))
    assert not feasibility.keeps_limits(through)
    assert feasibility.keeps_limits(feasibility.shrunk_to_feasible(through))


def test_efforts_count_with_their_uncertainty() -> None:
    """At a limit that the expected efforts hold and their spread does not, a motion is refused."""
    feasibility = TASK.feasibility
    motion = random_feasible(feasibility, TASK.form, np.random.default_rng(2))
    used = feasibility.margins(motion).effort
    states = motion.at(np.linspace(0.0, 6.0, 301))[:3]
    expected = np.max(np.abs(feasibility.belief.efforts(states)), axis=0) / feasibility.limits.effort
    assert np.all(used > expected)
    random = np.random.default_rng(3)
    posterior = feasibility.belief.posterior
    deviations = np.sqrt(np.diag(posterior.covariance))
    torques = [
        posterior.manifold.straight(posterior.point, deviations * random.standard_normal(len(deviations))).parameters
        for _ in range(200)
    ]
    rows = feasibility.belief.model.rows(samples_of(states)).coefficients
    largest = np.max(np.abs(rows @ np.array(torques).T), axis=0) / feasibility.limits.effort[:, None]
    assert np.mean(largest <= used[:, None]) > 0.9


def test_starts_that_cannot_be() -> None:
    own = TASK.feasibility
    for start, message in (((3.0, 0.0, 0.0), "joint 'j1' is 3, outside"), ((0.0, 1.5, 0.0), "overlap")):
        with pytest.raises(InputError, match=message):
            Feasibility(own.belief, own.limits, np.array(start), own.collision)
    with pytest.raises(InputError, match=r"gravity .* requires .* limit of joint 'j2'"):
        small_task(MotionOptions(duration=6.0, start=(0.0, 1.5, 0.0)), urdf().replace('effort="60"', 'effort="8"'))
    with pytest.raises(InputError, match="no feasible start was found among"):
        small_task(MotionOptions(duration=6.0, avoid=("box:0,0,0,5,5,5",)))


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


def test_derivatives_of_distances() -> None:
    collision = boxes(ConvexShape("beside", 0.2 * CORNERS @ np.diag([1, 2, 3]) + np.array([0.6, 0.2, 0.9])))
    position, step = np.array([0.4, 0.5, 0.3]), 1e-5
    values, slopes = collision.gradients(position, np.array([0]))
    assert np.allclose(values, collision.distances(position[None])[0], atol=1e-5)
    numeric = [
        (collision.distances((position + e)[None]) - collision.distances((position - e)[None]))[0, 0] / (2.0 * step)
        for e in step * np.eye(3)
    ]
    assert np.allclose(slopes[0], numeric, atol=1e-3)


def test_no_distance_changes_faster_than_its_bound() -> None:
    """And neighbours are no pair."""
    collision = small_task().feasibility.collision
    assert collision is not None
    assert [(pair.first, pair.second) for pair in collision.pairs] == [
        ("base", "upper"),
        ("base", "fore"),
        ("turret", "fore"),
    ]
    random = np.random.default_rng(2)
    position = random.uniform(-2.0, 2.0, (300, 3))
    moved = position + random.uniform(-0.05, 0.05, position.shape)
    change = np.abs(collision.distances(moved) - collision.distances(position))
    apart = np.minimum(collision.distances(moved), collision.distances(position)) > 0.0
    bound = np.abs(moved - position) @ (collision.reach @ np.abs(collision.robot.coupling)).T
    assert np.all(change[apart] <= bound[apart] + 1e-6)
    assert np.max(change[apart] / bound[apart]) > 0.3  # it is not just large
