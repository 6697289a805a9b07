"""Trajectories in the forms that planners and recorders have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from excitation.motions import bump
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.trajectories import read_trajectory, save_trajectory, trajectory_in_bag

JOINTS = ("shoulder", "elbow")
FIELDS = ("times", "positions", "velocities", "accelerations", "efforts")


def with_efforts(points: int = 9) -> Trajectory:
    motion = bump(JOINTS, 4.0)
    times = np.linspace(0.0, 4.0, points)
    position, velocity, acceleration = (motion.rows(times, derivative) for derivative in range(3))
    return Trajectory(JOINTS, times, position, velocity, acceleration, 3.0 * acceleration)


AROUND: dict[str, Callable[[dict[str, Any]], Any]] = {
    "as it is": lambda own: own,
    "RobotTrajectory": lambda own: {"joint_trajectory": own, "multi_dof_joint_trajectory": {"points": []}},
    "DisplayTrajectory": lambda own: {"model_id": "arm", "trajectory": [{"joint_trajectory": own}]},
}


@pytest.mark.parametrize("form", AROUND)
def test_what_topic_echo_prints_is_read(form: str, tmp_path: Path) -> None:
    """Of a planner's message, too: one document, which a line of dashes ends."""
    document = bump(JOINTS, 4.0).document(9)
    path = tmp_path / "echo.yaml"
    path.write_text(yaml.safe_dump(AROUND[form](document)) + "---\n", encoding="utf-8")
    np.testing.assert_allclose(read_trajectory(path).positions, [each["positions"] for each in document["points"]])


def test_a_bag_comes_back_as_it_was_written(tmp_path: Path) -> None:
    given = with_efforts()
    save_trajectory(tmp_path / "bag", given)
    found = trajectory_in_bag(tmp_path / "bag", None)
    with Bag(tmp_path / "bag") as bag:
        ((_, _, message),) = bag.messages([*bag.topics])
    np.testing.assert_allclose([point.effort for point in message.points], given.efforts)
    for name in FIELDS[:-1]:
        np.testing.assert_allclose(getattr(found, name), getattr(given, name), atol=1e-9)


@pytest.mark.parametrize(("efforts", "accelerations"), [(True, True), (False, True), (False, False)])
def test_a_file_says_what_a_trajectory_has(efforts: bool, accelerations: bool, tmp_path: Path) -> None:
    none, given = np.zeros((9, 0)), with_efforts()
    given = given if efforts else replace(given, efforts=none)
    given = given if accelerations else replace(given, accelerations=none)
    for suffix in ("yaml", "csv"):
        save_trajectory(tmp_path / f"trajectory.{suffix}", given)
    (first, *_) = yaml.safe_load((tmp_path / "trajectory.yaml").read_text())["points"]
    assert ("effort" in first, "accelerations" in first) == (efforts, accelerations)
    header, *lines = (tmp_path / "trajectory.csv").read_text().splitlines()
    assert header.endswith("elbow effort" if efforts else "elbow acceleration" if accelerations else "elbow velocity")
    assert len(lines) == 9
    assert len(lines[3].split(",")) == 1 + 2 * (2 + efforts + accelerations)
    found = read_trajectory(tmp_path / "trajectory.yaml")
    np.testing.assert_allclose(found.accelerations, given.accelerations)


def written(folder: Path, topics: dict[str, int]) -> Path:
    """A bag with so many trajectories on each topic, each of one point more than the last one; the first has none."""
    types = get_typestore(Stores.ROS2_JAZZY)
    kind = "trajectory_msgs/msg/JointTrajectory"
    duration, point = (types.types[name] for name in ("builtin_interfaces/msg/Duration", f"{kind}Point"))
    header = types.types["std_msgs/msg/Header"](
        stamp=types.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=""
    )
    with Writer(folder, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, count in topics.items():
            connection = writer.add_connection(topic, kind, typestore=types)
            for number in range(count):
                still, time = np.zeros(1), [duration(sec=second, nanosec=0) for second in range(number)]
                points = [point(still, still, still, np.zeros(0), each) for each in time]
                message = types.types[kind](header=header, joint_names=["a"], points=points)
                writer.write(connection, number, types.serialize_cdr(message, kind))
    return folder


BAGS_REFUSED = {
    "no points": ({"/plan": 1}, None, "no message on /plan has points"),
    "no messages": ({"/states": 0}, None, "no message on /states has points"),
    "two topics": ({"/plan": 4, "/other": 4}, None, "found /plan, /other; --topic names one"),
    "no such topic": ({"/plan": 4}, "/path", "has no topic /path; --topic names another"),
}


@pytest.mark.parametrize("case", BAGS_REFUSED)
def test_a_bag_without_a_trajectory_is_refused(case: str, tmp_path: Path) -> None:
    topics, topic, said = BAGS_REFUSED[case]
    with pytest.raises(InputError, match=said):
        trajectory_in_bag(written(tmp_path / "bag", topics), topic)


def test_a_folder_that_is_no_bag_is_left_as_it_is(tmp_path: Path) -> None:
    """A bag is replaced; results, and names of other kinds of files, are not."""
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "estimate.json").write_text("{}")
    with pytest.raises(InputError, match="results: already exists and is not a bag"):
        save_trajectory(tmp_path / "results", with_efforts())
    assert (tmp_path / "results" / "estimate.json").exists()
    for name in ("x.YML", "x.mcap", ".."):
        with pytest.raises(InputError, match=r"expected a name that ends in \.yaml or \.csv"):
            save_trajectory(tmp_path / name, with_efforts())
    for _ in range(2):
        save_trajectory(tmp_path / "bag", with_efforts())


STILL: dict[str, Any] = {"velocities": [], "accelerations": []}
WRONG: dict[str, tuple[dict[str, Any], Any, str]] = {
    "no points": ({"points": None}, {}, "expected the lists joint_names and points"),
    "one point": ({"points": []}, {}, "0 points, expected at least two"),
    "a joint twice": ({"joint_names": ["elbow", "elbow"]}, {}, "every joint once"),
    "too few numbers": ({}, {"velocities": [0.0]}, "point 5"),
    "text": ({}, {"positions": "12"}, "point 5 is incomplete; expected lists of numbers"),
    "not finite": ({}, {"accelerations": [0.0, float("nan")]}, "point 5 must have 2 finite"),
    "no time": ({}, {"time_from_start": None}, "point 5"),
    "time goes back": ({}, {"time_from_start": {"sec": 0, "nanosec": 1}}, "point 5 is at 1e-09 s, not after"),
    "no velocities": ({}, STILL, "point 5 has no velocities: from position to position the speed"),
    "cut by topic echo": ({}, "...", "point 5 is incomplete.*--full-length"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_that_is_no_trajectory_is_refused(case: str, tmp_path: Path) -> None:
    changes, in_point, said = WRONG[case]
    document, path = bump(JOINTS, 4.0).document(9), tmp_path / "plan.yaml"
    points = document["points"]
    points[5] = in_point if isinstance(in_point, str) else points[5] | in_point
    path.write_text(yaml.safe_dump(document | changes))
    with pytest.raises(InputError, match=f"{path}: .*{said}"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [("joint_names: [a", "cannot be read"), ("a: &x [1]\nb: *x\n", "has aliases"), ("- 1", "not a trajectory")],
)
def test_text_that_is_no_yaml_and_aliases_are_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "motion.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_trajectory(tmp_path / "motion.yaml")
