"""Trajectories on disk: ``trajectory.yaml``, ``trajectory.csv`` and a rosbag for a joint trajectory controller.

``trajectory.yaml`` has the fields of ``trajectory_msgs/JointTrajectory``: ``joint_names`` and ``points`` of
``positions``, ``velocities``, ``accelerations``, ``effort`` and ``time_from_start`` {``sec``, ``nanosec``}.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from geomid_ros.errors import GeomidError, InputError, refusing
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.disk import read_text, write_text

TOPIC = "/joint_trajectory_controller/joint_trajectory"
_TYPES = get_typestore(Stores.ROS2_JAZZY)
_KIND = "trajectory_msgs/msg/JointTrajectory"


def save_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write YAML or CSV depending on the suffix of ``path``; without a suffix, a rosbag in this folder.

    Raises GeomidError naming the file or folder. An existing folder must be a bag.
    """
    writers = {".yaml": write_yaml, ".yml": write_yaml, ".csv": write_csv, "": write_bag}
    if path.suffix not in writers or path.name in ("", ".."):
        raise InputError(f"{path}: expected a name that ends in .yaml or .csv, or a folder for a rosbag")
    writers[path.suffix](path, trajectory)


def write_yaml(path: Path, trajectory: Trajectory) -> None:
    """Write ``trajectory.yaml``. Raises GeomidError naming the file."""
    lines = [f"joint_names: {json.dumps(trajectory.joints, ensure_ascii=False)}", "points:"]
    for numbers, seconds, nanoseconds in points_of(trajectory):
        fields = [f"{name}: [{', '.join(map(repr, values))}]" for name, values in numbers.items() if values]
        fields.append(f"time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}")
        lines += [f"{'  ' if place else '- '}{text}" for place, text in enumerate(fields)]
    write_text(path, "\n".join(lines) + "\n")


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """Write one line per point: time, positions, velocities, accelerations and efforts. Raises GeomidError."""
    points = [numbers for numbers, _, _ in points_of(trajectory)]
    kinds = [_ONE_OF[kind] for kind, values in points[0].items() if values]
    lines = [",".join(["time", *(f"{name} {kind}" for kind in kinds for name in trajectory.joints)])]
    for time, numbers in zip(trajectory.times.tolist(), points, strict=True):
        lines.append(",".join(map(repr, [time, *chain(*numbers.values())])))
    write_text(path, "\n".join(lines) + "\n")


def write_bag(folder: Path, trajectory: Trajectory) -> None:
    """Write a rosbag with one ``trajectory_msgs/JointTrajectory``; an existing bag is replaced.

    Raises GeomidError naming the folder.
    """
    types = _TYPES.types
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            **{name: np.array(values) for name, values in numbers.items()},
            time_from_start=types["builtin_interfaces/msg/Duration"](sec=seconds, nanosec=nanoseconds),
        )
        for numbers, seconds, nanoseconds in points_of(trajectory)
    ]
    time = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
    _write(folder, types[_KIND](header=header, joint_names=list(trajectory.joints), points=points))


def _write(folder: Path, message: Any) -> None:
    existing = [*folder.iterdir()] if folder.is_dir() else []
    if folder.exists() and not all(file.name == "metadata.yaml" or file.suffix == ".mcap" for file in existing):
        raise InputError(f"{folder}: already exists and is not a bag; give another folder")
    with refusing(f"{folder}: the bag cannot be written", OSError, kind=GeomidError):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
            bag = Path(temporary) / folder.name
            with Writer(bag, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP) as writer:
                connection = writer.add_connection(TOPIC, _KIND, typestore=_TYPES)
                writer.write(connection, 0, _TYPES.serialize_cdr(message, _KIND))
            shutil.rmtree(folder, ignore_errors=True)
            bag.rename(folder)


_ONE_OF = {"positions": "position", "velocities": "velocity", "accelerations": "acceleration", "effort": "effort"}


def points_of(trajectory: Trajectory) -> Iterator[tuple[dict[str, list[float]], int, int]]:
    """Yield the numbers of each point by the message's field, empty where the trajectory has none, and the time from
    the start in seconds and nanoseconds."""
    arrays = trajectory.positions, trajectory.velocities, trajectory.accelerations, trajectory.efforts
    for time, *numbers in zip(trajectory.times.tolist(), *(array.tolist() for array in arrays), strict=True):
        yield dict(zip(_ONE_OF, numbers, strict=True)), *divmod(round(1e9 * time), 10**9)


_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, if libyaml is installed


def read_trajectory(path: Path) -> Trajectory:
    """Read ``trajectory.yaml``, or the output of ``ros2 topic echo`` for a ``trajectory_msgs/JointTrajectory`` or for a
    MoveIt message that contains one.

    It has ``joint_names`` and ``points``, each with ``positions``, ``velocities``, ``accelerations`` (at all points or
    at none) and ``time_from_start`` with ``sec`` and ``nanosec``.

    Raises:
        InputError: it names the file, and the point that cannot be used.
    """
    document = _document(path)
    rows = [_row(point, f"{path}: point {index}") for index, point in enumerate(document["points"])]
    return _trajectory(str(path), tuple(map(str, document["joint_names"])), rows)


def trajectory_in_bag(path: Path, topic: str | None) -> Trajectory:
    """Return the last ``trajectory_msgs/JointTrajectory`` with points in a rosbag.

    Args:
        path: path of the bag.
        topic: topic of the messages; None for the only one of this type.

    Raises:
        InputError: it names the bag, and the part of the trajectory that cannot be used.
    """
    with Bag(path) as bag:
        topics = [name for name, kind in bag.topics.items() if kind == _KIND]
        if topic is None and len(topics) != 1:
            listing = ", ".join(topics) or "none"
            raise InputError(f"{path}: expected one topic of type {_KIND}, found {listing}; --topic names one")
        chosen = topics[0] if topic is None else bag.find_topic(topic, _KIND, "--topic")
        messages = [message for _, _, message in bag.messages([chosen]) if len(message.points)]
    if not messages:
        raise InputError(f"{path}: no message on {chosen} has points")
    return trajectory_of(messages[-1], f"{path}: {chosen}")


def trajectory_of(message: Any, source: str) -> Trajectory:
    """Convert a ``trajectory_msgs/JointTrajectory``. Raises InputError naming the ``source``."""
    times = [float(point.time_from_start.sec) + 1e-9 * float(point.time_from_start.nanosec) for point in message.points]
    motions = ([list(getattr(point, name)) for name in _MOTION] for point in message.points)
    return _trajectory(source, tuple(message.joint_names), list(zip(times, motions, strict=True)))


_MOTION = ("positions", "velocities", "accelerations")
_Row: TypeAlias = tuple[float, list[list[float]]]
"""Time [s]; positions, velocities and accelerations, each of which may be empty."""


def _trajectory(source: str, joints: tuple[str, ...], rows: Sequence[_Row]) -> Trajectory:
    """Checked trajectory of these points. Raises InputError naming the source."""
    if not joints or len(set(joints)) != len(joints):
        raise InputError(f"{source}: joint_names must name every joint once, and at least one")
    if len(rows) < 2:
        raise InputError(f"{source}: {len(rows)} points, expected at least two")
    accelerated = bool(rows[0][1][2])
    widths = [len(joints), len(joints), len(joints) if accelerated else 0]
    for index, (time, numbers) in enumerate(rows):
        if not numbers[1]:
            raise InputError(
                f"{source}: point {index} has no velocities: from position to position the speed would jump. Have the "
                "planner add times and velocities (in MoveIt: AddTimeOptimalParameterization)"
            )
        if [*map(len, numbers)] != widths or not np.all(np.isfinite([time, *chain(*numbers)])):
            optional = ", accelerations" if accelerated else ""
            raise InputError(
                f"{source}: point {index} must have {len(joints)} finite positions, velocities{optional}, one for each "
                "joint, and accelerations at every point or at none"
            )
    times = np.array([time for time, _ in rows])
    late = np.flatnonzero(np.diff(times, prepend=-1e-9) <= 0.0)
    if len(late):
        raise InputError(f"{source}: point {late[0]} is at {times[late[0]]:g} s, not after the previous one")
    motion = [np.array([numbers[kind] for _, numbers in rows], dtype=np.float64) for kind in range(len(_MOTION))]
    return Trajectory(joints, times, *motion)


def _document(path: Path) -> Mapping[str, Any]:
    text = read_text(path, "trajectory")
    with refusing(f"{path}: the trajectory cannot be read", yaml.YAMLError, ValueError, RecursionError):
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, _Loader)):
            raise InputError(f"{path}: the trajectory has aliases, which are not allowed")
        document: Any = next(iter(yaml.load_all(text, _Loader)), None)
    for name in _AROUND:
        inner = document.get(name) if isinstance(document, dict) else None
        document = inner[0] if isinstance(inner, list) and len(inner) == 1 else inner or document
    lists = isinstance(document, dict) and all(isinstance(document.get(key), list) for key in ("joint_names", "points"))
    if not lists:
        raise InputError(
            f"{path}: not a trajectory: expected the lists joint_names and points, as 'geomid excite' writes"
        )
    return dict(document)


_AROUND = ("trajectory", "joint_trajectory")
"""Fields of moveit_msgs/DisplayTrajectory and of RobotTrajectory; the first contains the second."""


def _row(point: Any, where: str) -> _Row:
    try:
        time = point["time_from_start"]
        seconds = float(time["sec"]) + 1e-9 * float(time["nanosec"])
        lists = [point.get(name) or () for name in _MOTION]
        if any(isinstance(values, str) for values in lists):
            raise TypeError("a text in place of a list")  # noqa: TRY301
        return seconds, [[float(number) for number in values] for values in lists]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        expected = f"lists of numbers ({', '.join(_MOTION)}), and time_from_start: {{sec, nanosec}}"
        raise InputError(
            f"{where} is incomplete; expected {expected}. 'ros2 topic echo' needs --full-length"
        ) from error
