"""Trajectories on disk: ``trajectory.yaml``, ``trajectory.csv`` and a rosbag for a joint trajectory controller; and
``joint_limits.yaml`` as MoveIt and ros2_control write it.

``trajectory.yaml`` has the fields of ``trajectory_msgs/JointTrajectory``: ``joint_names`` and ``points`` of
``positions``, ``velocities``, ``accelerations`` and ``time_from_start`` {``sec``, ``nanosec``}.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from geomid_ros.errors import GeomidError, InputError, unknown_name
from geomid_ros.excitation.limits import JointLimits
from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.files.disk import read_text, write_text
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.types import FloatArray

TOPIC = "/joint_trajectory_controller/joint_trajectory"
_TYPES = get_typestore(Stores.ROS2_JAZZY)
_KIND = "trajectory_msgs/msg/JointTrajectory"


def write_yaml(path: Path, trajectory: Trajectory) -> None:
    """Write ``trajectory.yaml``. Raises GeomidError naming the file."""
    lines = [f"joint_names: [{', '.join(map(_quoted, trajectory.joints))}]", "points:"]
    for row, (seconds, nanoseconds) in enumerate(_stamps(trajectory)):
        position, velocity, acceleration = (_numbers(own[row]) for own in _states(trajectory))
        lines += [
            f"- positions: [{position}]",
            f"  velocities: [{velocity}]",
            f"  accelerations: [{acceleration}]",
            f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}",
        ]
    write_text(path, "\n".join(lines) + "\n")


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """Write one line per point: time, then positions, velocities and accelerations. Raises GeomidError."""
    kinds = ("position", "velocity", "acceleration")
    lines = [",".join(["time", *(f"{name} {kind}" for kind in kinds for name in trajectory.joints)])]
    for row, time in enumerate(trajectory.times.tolist()):
        lines.append(f"{time!r},{_numbers(np.concatenate([own[row] for own in _states(trajectory)]), ',')}")
    write_text(path, "\n".join(lines) + "\n")


def write_bag(folder: Path, trajectory: Trajectory) -> None:
    """Write a rosbag with one ``trajectory_msgs/JointTrajectory``; a bag that is there is replaced.

    Raises GeomidError naming the folder.
    """
    types = _TYPES.types
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.array(trajectory.positions[row]),
            velocities=np.array(trajectory.velocities[row]),
            accelerations=np.array(trajectory.accelerations[row]),
            effort=np.zeros(0),
            time_from_start=types["builtin_interfaces/msg/Duration"](sec=seconds, nanosec=nanoseconds),
        )
        for row, (seconds, nanoseconds) in enumerate(_stamps(trajectory))
    ]
    time = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
    _write(folder, types[_KIND](header=header, joint_names=list(trajectory.joints), points=points))


def _write(folder: Path, message: Any) -> None:
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
            made = Path(temporary) / folder.name
            with Writer(made, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP) as writer:
                connection = writer.add_connection(TOPIC, _KIND, typestore=_TYPES)
                writer.write(connection, 0, _TYPES.serialize_cdr(message, _KIND))
            shutil.rmtree(folder, ignore_errors=True)
            made.rename(folder)
    except OSError as error:
        raise GeomidError(f"{folder}: the bag cannot be written ({error})") from error


def _states(trajectory: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    return trajectory.positions, trajectory.velocities, trajectory.accelerations


def _stamps(trajectory: Trajectory) -> list[tuple[int, int]]:
    """Seconds and nanoseconds from the start, of each point."""
    return [divmod(round(1e9 * time), 10**9) for time in trajectory.times.tolist()]


def _numbers(values: FloatArray, separator: str = ", ") -> str:
    return separator.join(map(repr, values.tolist()))


def _quoted(name: str) -> str:
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


_WHAT = "trajectory"
_NUMBERS = ("positions", "velocities", "accelerations")
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, where there is libyaml


def read_trajectory(path: Path) -> Trajectory:
    """Read ``trajectory.yaml``.

    It has ``joint_names`` and ``points``, each of ``positions``, ``velocities``, ``accelerations`` and
    ``time_from_start`` with ``sec`` and ``nanosec``.

    Raises:
        InputError: naming the file, and the point that cannot be used.
    """
    document = _document(path)
    joints = tuple(map(str, document["joint_names"]))
    points = document["points"]
    if not joints or len(set(joints)) != len(joints):
        raise InputError(f"{path}: joint_names must name every joint once, and at least one")
    if len(points) < 2:
        raise InputError(f"{path}: {len(points)} points, expected at least two")
    rows = list(_rows(path, points, len(joints)))
    times = np.array([time for time, _ in rows])
    late = np.flatnonzero(np.diff(times, prepend=-1e-9) <= 0.0)
    if len(late):
        raise InputError(f"{path}: point {late[0]} is at {times[late[0]]:g} s, not after the previous one")
    positions, velocities, accelerations = np.moveaxis(np.array([numbers for _, numbers in rows]), 1, 0)
    return Trajectory(joints, times, positions, velocities, accelerations)


def _document(path: Path) -> Mapping[str, Any]:
    text = read_text(path, _WHAT)
    try:
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, _Loader)):
            raise InputError(f"{path}: the {_WHAT} has aliases, which are not allowed")
        document = yaml.load(text, _Loader)  # noqa: S506 it is a safe loader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: the {_WHAT} cannot be read ({' '.join(str(error).split())})") from error
    lists = isinstance(document, dict) and all(isinstance(document.get(key), list) for key in ("joint_names", "points"))
    if not lists:
        raise InputError(f"{path}: not a {_WHAT}: expected the lists joint_names and points, as 'geomid excite' writes")
    return dict(document)


def _rows(path: Path, points: list[Any], joints: int) -> Iterator[tuple[float, FloatArray]]:
    """The time of each point, and its numbers ``(3, joints)``."""
    for index, point in enumerate(points):
        try:
            time = point["time_from_start"]
            seconds = float(time["sec"]) + 1e-9 * float(time["nanosec"])
            numbers = np.array([point[name] for name in _NUMBERS], dtype=np.float64)
        except (KeyError, TypeError, ValueError) as error:
            expected = f"{', '.join(_NUMBERS)} of {joints} numbers, and time_from_start: {{sec, nanosec}}"
            raise InputError(f"{path}: point {index} is incomplete; expected {expected}") from error
        if numbers.shape != (3, joints) or not np.all(np.isfinite([seconds, *numbers.ravel()])):
            raise InputError(
                f"{path}: point {index} must have {joints} finite {', '.join(_NUMBERS)}, one for each joint"
            )
        yield seconds, numbers


_KINDS = ("velocity", "acceleration", "jerk", "effort")


def read_joint_limits(path: Path, joints: Collection[str]) -> dict[str, JointLimits]:
    """The limits of a robot's ``joints`` in a file, by name; other joints may be in it.

    Raises InputError naming the file and the key.
    """
    document = read_yaml(path, "file of joint limits")
    entries = document.get("joint_limits") if isinstance(document, dict) else None
    if not isinstance(entries, dict):
        raise InputError(f"{path}: has no 'joint_limits' by joint, as MoveIt's joint_limits.yaml has")
    if not set(entries) & set(joints):
        named = [str(name) for name in entries]
        raise InputError(f"{path}: {unknown_name('joint', named[0] if named else '', joints)}")
    return {name: _limits(entries[name], f"{path}: joint '{name}'") for name in joints if name in entries}


def _limits(entry: Any, where: str) -> JointLimits:
    if not isinstance(entry, dict):
        raise InputError(f"{where} is no mapping of limits")
    found = {kind: _number(entry, f"max_{kind}", f"has_{kind}_limits", where) for kind in _KINDS}
    for kind, value in found.items():
        if value is not None and not value > 0.0:
            raise InputError(f"{where}: max_{kind} is {value:g}, expected a number greater than zero")
    ends = {end: _number(entry, f"{key}_position", "has_position_limits", where) for end, key in _ENDS.items()}
    return JointLimits(**ends, **found)


_ENDS = {"lower": "min", "upper": "max"}


def _number(entry: Mapping[str, Any], key: str, switch: str, where: str) -> float | None:
    """The number of a limit; None where it is absent or switched off."""
    if entry.get(switch) is False or entry.get(key) is None:
        if entry.get(switch) is True:
            raise InputError(f"{where}: {switch} is true and {key} is absent; give it a number")
        return None
    value = entry[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key} is {value!r}, expected a finite number")
    return float(value)
