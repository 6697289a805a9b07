"""Motions by points, and the file that has them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.polynomial import Polynomial

from geomid_ros.errors import InputError
from geomid_ros.files.trajectories import read_trajectory

from .motions import Motion, bump, lively

JOINTS = ("shoulder", "elbow")


def test_a_motion_of_degree_five_is_met_everywhere(tmp_path: Path) -> None:
    """By two points: a quintic is determined by what they say of it."""
    random = np.random.default_rng(0)
    motion = Motion(JOINTS, tuple(Polynomial(random.normal(0.0, 1.0, 6)) for _ in JOINTS), 3.0)
    trajectory = read_trajectory(motion.write(tmp_path / "trajectory.yaml", 2))
    times = np.linspace(0.0, 3.0, 50)
    positions, velocities = np.moveaxis([trajectory.at(time) for time in times.tolist()], 1, 0)
    np.testing.assert_allclose(positions, motion.rows(times), atol=1e-8)
    np.testing.assert_allclose(velocities, motion.rows(times, 1), atol=1e-8)


def test_at_another_speed_the_path_is_the_same(tmp_path: Path) -> None:
    """q(s t), s q', s^2 q''."""
    motion = lively(JOINTS, 5.0, 0.3)
    trajectory = read_trajectory(motion.write(tmp_path / "trajectory.yaml", 100))
    slow = trajectory.at_speed(0.2)
    assert slow.duration == pytest.approx(25.0)
    np.testing.assert_allclose(slow.velocities, 0.2 * trajectory.velocities)
    for time in np.linspace(0.0, 5.0, 37).tolist():
        np.testing.assert_allclose(slow.at(5.0 * time)[0], trajectory.at(time)[0], atol=1e-9)
        np.testing.assert_allclose(slow.at(5.0 * time)[1], 0.2 * trajectory.at(time)[1], atol=1e-9)
    np.testing.assert_allclose(trajectory.speeds, np.abs(motion.rows(trajectory.times, 1)).max(axis=0), rtol=1e-8)


def drop(key: str) -> Callable[[dict[str, Any]], Any]:
    return lambda document: document.pop(key)


def in_point(key: str, value: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda document: document["points"][3].update({key: value})


WRONG: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no joints": (drop("joint_names"), "expected the lists joint_names and points"),
    "no points": (drop("points"), "expected the lists joint_names and points"),
    "one point": (lambda document: document.update(points=document["points"][:1]), "1 points, expected at least two"),
    "a joint twice": (lambda document: document.update(joint_names=["elbow", "elbow"]), "every joint once"),
    "too few numbers": (in_point("velocities", [0.0]), "point 3"),
    "text": (in_point("positions", ["here", "there"]), "point 3"),
    "not finite": (in_point("accelerations", [0.0, float("nan")]), "point 3 must have 2 finite"),
    "no time": (in_point("time_from_start", None), "point 3"),
    "time goes back": (in_point("time_from_start", {"sec": 0, "nanosec": 1}), "point 3 is at 1e-09 s, not after"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_that_is_no_trajectory_is_refused(case: str, tmp_path: Path) -> None:
    spoil, said = WRONG[case]
    document = bump(JOINTS, 4.0).document(9)
    spoil(document)
    path = tmp_path / "trajectory.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match=said) as caught:
        read_trajectory(path)
    assert str(path) in str(caught.value)


NO_YAML = {
    "joint_names: [a": "cannot be read",
    "a: &x [1]\njoint_names: *x\n": "has aliases, which are not allowed",
    "- 1": "not a trajectory",
    "!!python/name:os.system x": "cannot be read",
}


@pytest.mark.parametrize("text", NO_YAML)
def test_text_that_is_no_yaml_and_aliases_are_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "motion.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=NO_YAML[text]):
        read_trajectory(path)
