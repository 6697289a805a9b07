"""The bags in `bags/` are what their recipe makes."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from geomid_ros.types import FloatArray

from .reading import Recorded, recorded

BAGS = Path(__file__).parents[2] / "bags"
NAMES = ("arm7", "arm3")
OTHER_MACHINE = 1e-6  # rad, rad/s, N, N m: other versions of the libraries round otherwise


@pytest.fixture(scope="module")
def again(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recipe, followed once more."""
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("again")
    runpy.run_path(str(BAGS / "make_bags.py"))["make_bags"](folder)
    return folder


def joint_values(bag: Recorded) -> FloatArray:
    states = bag.messages["/joint_states"]
    return np.array([[state.position, state.velocity, state.effort] for state in states])


def wrench_values(bag: Recorded) -> FloatArray:
    wrenches = [message.wrench for message in bag.messages["/wrench"]]
    return np.array([[getattr(part, axis) for part in (w.force, w.torque) for axis in "xyz"] for w in wrenches])


@pytest.mark.parametrize("name", NAMES)
def test_recipe_gives_the_same_bag(again: Path, name: str) -> None:
    shipped, made = recorded(BAGS / name), recorded(again / name)
    assert shipped.messages["/joint_states"][0].name == made.messages["/joint_states"][0].name
    np.testing.assert_allclose(joint_values(shipped), joint_values(made), rtol=0.0, atol=OTHER_MACHINE)
    np.testing.assert_allclose(wrench_values(shipped), wrench_values(made), rtol=0.0, atol=OTHER_MACHINE)
