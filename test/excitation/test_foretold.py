"""What is foretold of a design holds for motions that the robot can make."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.learning import weight_of
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.excitation.search import random_feasible, random_motion
from geomid_ros.session.collision_scene import Surroundings
from geomid_ros.session.excitation import MotionRequest, design

from .arm import small_task

WALLS = ("plane:1,0,0,-0.08", "plane:-1,0,0,-0.08", "plane:0,1,0,-0.08", "plane:0,-1,0,-0.08")


@pytest.mark.parametrize("clearance", [0.02, 0.3])
def test_pairs_that_begin_closer_than_the_clearance_are_said_to_keep_half(clearance: float) -> None:
    """The walls begin 0.05 m from the arm."""
    wish = MotionRequest(duration=3.0, repeats=1, surroundings=Surroundings(avoid=WALLS, clearance=clearance))
    found = design(small_task(wish), wish, lambda *_: None)
    assert ("half of their distance at the start" in found.closest) is (clearance > 0.05)


def test_in_a_tight_place_the_error_on_feasible_motions_is_foretold() -> None:
    """The arm stands upright in a shaft, 0.16 m wide, in which random motions within its limits collide."""
    wish = MotionRequest(duration=6.0, repeats=1, surroundings=Surroundings(avoid=WALLS))
    task = small_task(wish)
    found = design(task, wish, lambda *_: None)
    random = np.random.default_rng(8)
    after = task.knowledge.after(task.knowledge.information(found.motion)).posterior.covariance

    def error(make: Callable[[Feasibility, MotionForm, np.random.Generator], ExcitingMotion]) -> float:
        motions = [make(task.feasibility, task.form, random) for _ in range(12)]
        return float(np.sqrt(np.sum(weight_of("prediction", task.knowledge, motions) * after)))

    foretold = found.learning.designed.error
    assert foretold == pytest.approx(error(random_feasible), rel=0.2)
    assert error(random_motion) > 5.0 * foretold
