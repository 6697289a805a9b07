"""The search: exact slopes, and better motions than random ones."""

from __future__ import annotations

import numpy as np

from geomid_ros.excitation.criteria import weight_of
from geomid_ros.excitation.motion import Motion
from geomid_ros.excitation.search import Search, expected_error, random_feasible, random_motion
from geomid_ros.session.excitation import Wish
from geomid_ros.session.surroundings import Surroundings
from geomid_ros.types import FloatArray

from .arm import small_task

TASK = small_task(Wish(duration=6.0, repeats=1, surroundings=Surroundings(avoid=("box:0.75,0,0.7,0.2,2,2",))))


def weight(seed: int, aim: str = "prediction") -> FloatArray:
    random = np.random.default_rng(seed)
    return weight_of(aim, TASK.knowledge, [random_motion(TASK.feasibility, TASK.form, random) for _ in range(4)])


def search(aim: str = "prediction") -> Search:
    return Search(TASK.feasibility, TASK.form, expected_error(TASK.feasibility, weight(0, aim), TASK.form))


def error(motion: Motion, of: FloatArray) -> float:
    after = TASK.knowledge.after(TASK.knowledge.information(motion))
    return float(np.sum(of * after.posterior.covariance))


def test_slopes_are_those_of_the_cost() -> None:
    own, random = search(), np.random.default_rng(3)
    motion = random_motion(TASK.feasibility, TASK.form, random).scaled(1.05)  # beyond limits, which cost
    value, slope = own._value_and_slope(motion)
    assert np.isclose(value, own.cost(motion), rtol=1e-9)
    for _ in range(3):
        way = np.abs(motion.coefficients) * random.standard_normal(slope.shape)
        step = 1e-6
        ahead, behind = (
            own.cost(Motion(TASK.form, motion.start, motion.coefficients + s * way)) for s in (step, -step)
        )
        assert np.isclose((ahead - behind) / (2.0 * step), np.sum(slope * way), rtol=2e-2, atol=1e-2)


def test_a_designed_motion_is_feasible_and_better_than_random_ones() -> None:
    """On motions that the search has not seen."""
    random = np.random.default_rng(5)
    designed = search().run(random)
    assert TASK.feasibility.holds(designed)
    assert np.all(TASK.feasibility.largest_scale(designed) >= 1.0 - 1e-9)
    others = [error(random_feasible(TASK.feasibility, TASK.form, random), weight(6)) for _ in range(8)]
    assert error(designed, weight(6)) < min(others)


def test_a_motion_for_one_link_tells_more_of_it() -> None:
    own, generic = search("link:fore").run(np.random.default_rng(7)), search().run(np.random.default_rng(7))
    assert error(own, weight(0, "link:fore")) < error(generic, weight(0, "link:fore"))
    assert error(generic, weight(6)) < error(own, weight(6))
