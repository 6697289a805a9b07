"""A feasible motion holds its limits by another route: finite differences of its file at 1 kHz, MuJoCo's distances and
efforts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.excite.independent import Limits, Simulated
from benchmarks.excite.robots import Description
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.excitation.search import random_feasible
from geomid_ros.files.trajectories import write_yaml

from .arm import small_task, urdf

TASK = small_task()


def limits() -> Limits:
    own, collision = TASK.feasibility.limits, TASK.feasibility.collision
    assert collision is not None
    pairs = zip(collision.pairs, TASK.feasibility.clearances.tolist(), strict=True)
    clearances = {frozenset((pair.first, pair.second)): asked for pair, asked in pairs}
    return Limits(own.position, own.velocity, own.acceleration, own.jerk, own.effort, clearances)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    motion = random_feasible(TASK.feasibility, TASK.form, np.random.default_rng(11))
    times = np.linspace(0.0, motion.form.duration, 601)
    path = tmp_path_factory.mktemp("motion") / "trajectory.yaml"
    write_yaml(path, Trajectory(TASK.feasibility.names, times, *motion.at(times)[:3]))
    return path


def violations(path: Path, own: Limits) -> dict[str, int]:
    description = Description(urdf(), Path("small.urdf"), Path(), ())
    return Simulated(description, TASK.feasibility.names).violations(path, own)


def test_nothing_is_violated(path: Path) -> None:
    assert set(violations(path, limits()).values()) == {0}


def test_the_other_route_would_notice(path: Path) -> None:
    own = limits()
    halves = {kind: 0.5 * getattr(own, kind) for kind in ("velocity", "effort")}
    wide = dict.fromkeys(own.clearances, 1.0)
    found = violations(path, replace(own, clearances=wide, acceleration=own.acceleration / 20.0, **halves))
    assert all(found[kind] > 0 for kind in ("velocity", "acceleration", "clearance"))
    assert found["position"] == found["contact"] == 0
