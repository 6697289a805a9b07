"""What is said to be feasible is, by finite differences and dense distances; and what is not is refused."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.excitation.search import random_feasible, random_motion
from geomid_ros.model.samples import samples_of
from geomid_ros.session.collision_scene import Surroundings
from geomid_ros.session.excitation import MotionRequest

from .arm import small_task, urdf

TASK = small_task(MotionRequest(duration=6.0, repeats=1, surroundings=Surroundings(avoid=("box:0.75,0,0.7,0.2,2,2",))))


def dense(motion: ExcitingMotion) -> np.ndarray:
    return motion.at(np.linspace(0.0, motion.form.duration, 6001))[0]


@pytest.mark.parametrize("seed", range(2))
def test_a_feasible_motion_holds_all_limits(seed: int) -> None:
    feasibility = TASK.feasibility
    motion = random_feasible(feasibility, TASK.form, np.random.default_rng(seed))
    position = dense(motion)
    low, high = feasibility.limits.position.T
    assert np.all((position >= low) & (position <= high))
    for order, limit in enumerate(feasibility.limits.derivatives, 1):
        assert np.all(np.abs(np.diff(position, order, axis=0)) * 1000.0**order <= limit * (1.0 + 1e-3))
    assert feasibility.collision is not None
    assert np.all(feasibility.collision.distances(position) >= feasibility.clearances - 1e-6)
    assert np.ptp(position) > 0.2


def test_the_lower_bounds_of_distances_hold_and_are_close() -> None:
    feasibility = TASK.feasibility
    motion = random_feasible(feasibility, TASK.form, np.random.default_rng(7))
    assert feasibility.collision is not None
    least = np.min(feasibility.collision.distances(dense(motion)), axis=0)
    bounds = feasibility.margins(motion).distance
    assert np.all(bounds <= least + 1e-9)
    assert np.all(bounds >= feasibility.clearances)


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
    assert not feasibility.holds(through)
    assert feasibility.holds(feasibility.made_feasible(through))


def test_efforts_count_with_their_uncertainty() -> None:
    """At a limit that the expected efforts hold and their spread does not, a motion is refused."""
    feasibility = TASK.feasibility
    motion = random_feasible(feasibility, TASK.form, np.random.default_rng(2))
    used = feasibility.margins(motion).effort
    states = motion.at(np.linspace(0.0, 6.0, 301))[:3]
    expected = np.max(np.abs(feasibility.knowledge.efforts(states)), axis=0) / feasibility.limits.effort
    assert np.all(used > expected)
    random = np.random.default_rng(3)
    posterior = feasibility.knowledge.posterior
    deviations = np.sqrt(np.diag(posterior.covariance))
    torques = [
        posterior.manifold.straight(posterior.point, deviations * random.standard_normal(len(deviations))).parameters
        for _ in range(200)
    ]
    rows = feasibility.knowledge.model.rows(samples_of(states)).coefficients
    largest = np.max(np.abs(rows @ np.array(torques).T), axis=0) / feasibility.limits.effort[:, None]
    assert np.mean(largest <= used[:, None]) > 0.9


def test_starts_that_cannot_be() -> None:
    own = TASK.feasibility
    for start, message in (((3.0, 0.0, 0.0), "joint 'j1' is 3, outside"), ((0.0, 1.5, 0.0), "overlap")):
        with pytest.raises(InputError, match=message):
            Feasibility(own.knowledge, own.limits, np.array(start), own.collision)
    with pytest.raises(InputError, match="effort limit of joint 'j2'"):
        small_task(MotionRequest(duration=6.0, start=(0.0, 1.5, 0.0)), urdf().replace('effort="60"', 'effort="8"'))


def test_surroundings_that_enclose_the_arm() -> None:
    with pytest.raises(InputError, match="no feasible start was found among"):
        small_task(MotionRequest(duration=6.0, surroundings=Surroundings(avoid=("box:0,0,0,5,5,5",))))
