"""Reading ``trajectory.yaml``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from geomid_ros.errors import InputError
from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.files.disk import read_text
from geomid_ros.types import FloatArray

_WHAT = "trajectory"
_MOST_BYTES = 50_000_000
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
    text = read_text(path, _WHAT, _MOST_BYTES)
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
