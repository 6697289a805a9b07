"""The search: exact slopes, and better motions than random ones."""

from __future__ import annotations

import numpy as np
import pytest
from files.recordings import BAGS

from geomid_ros.excitation.belief import aim_weight
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.excitation.search import Search, expected_error, random_feasible, random_motion
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.excitation import DesignTask, design_task
from geomid_ros.session.options import MotionOptions
from geomid_ros.types import FloatArray

from .arm import small_task

TASK = small_task(MotionOptions(duration=6.0, repeats=1, avoid=("box:0.75,0,0.7,0.2,2,2",)))


def weight(seed: int, aim: str = "prediction", task: DesignTask = TASK) -> FloatArray:
    random = np.random.default_rng(seed)
    return aim_weight(aim, task.belief, [random_motion(task.feasibility, task.form, random) for _ in range(4)])


def search(aim: str = "prediction", task: DesignTask = TASK) -> Search:
    return Search(task.feasibility, task.form, expected_error(task.feasibility, weight(0, aim, task), task.form))


def error(motion: ExcitingMotion, of: FloatArray) -> float:
    after = TASK.belief.updated(TASK.belief.information(motion))
    return float(np.sum(of * after.posterior.covariance))


def with_a_sensor() -> DesignTask:
    sensor = WrenchSensor("/wrench", "wrist_ft", "mounted")
    path = BAGS / "arm3.urdf"
    chosen = Configuration({}, "test").with_sensors([sensor])
    return design_task(path.read_text(), path, chosen, MotionOptions(duration=6.0, repeats=1))


@pytest.mark.parametrize("task", [TASK, with_a_sensor()], ids=["efforts", "efforts and wrenches"])
def test_slopes_are_those_of_the_cost(task: DesignTask) -> None:
    own, random = search(task=task), np.random.default_rng(3)
    motion = random_motion(task.feasibility, task.form, random).scaled(1.05)  # beyond limits, which cost
    value, slope = own._value_and_slope(motion)
    assert np.isclose(value, own.cost(motion), rtol=1e-9)
    for _ in range(3):
        way = np.abs(motion.coefficients) * random.standard_normal(slope.shape)
        step = 1e-6
        ahead, behind = (
            own.cost(ExcitingMotion(task.form, motion.start, motion.coefficients + s * way)) for s in (step, -step)
        )
        assert np.isclose((ahead - behind) / (2.0 * step), np.sum(slope * way), rtol=2e-2, atol=1e-2)


def test_a_designed_motion_is_feasible_and_better_than_random_ones() -> None:
    """On motions that the search has not seen."""
    random = np.random.default_rng(5)
    designed = search().run(random)
    assert TASK.feasibility.keeps_limits(designed)
    assert np.all(TASK.feasibility.largest_scale(designed) >= 1.0 - 1e-9)
    others = [error(random_feasible(TASK.feasibility, TASK.form, random), weight(6)) for _ in range(8)]
    assert error(designed, weight(6)) < min(others)


def test_a_motion_for_one_link_tells_more_of_it() -> None:
    own, generic = search("link:fore").run(np.random.default_rng(7)), search().run(np.random.default_rng(7))
    assert error(own, weight(0, "link:fore")) < error(generic, weight(0, "link:fore"))
    assert error(generic, weight(6)) < error(own, weight(6))
