"""A motion of joints by points in time, as ``trajectory.yaml`` has it and trajectory_msgs/JointTrajectory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from geomid_ros.errors import InputError
from geomid_ros.files.disk import read_text
from geomid_ros.types import FloatArray, frozen

_WHAT = "trajectory"
_MOST_BYTES = 50_000_000
_NUMBERS = ("positions", "velocities", "accelerations")
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, where there is libyaml


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Positions, velocities and accelerations of ``joints`` at N instants; quintic polynomials lead from one to the
    next. Arrays are read-only.

    Attributes:
        joints: Names, in the order of the columns.
        times: ``(N,)`` [s] after the start, increasing.
        positions: ``(N, joints)`` [rad, m].
        velocities: ``(N, joints)`` [rad/s, m/s].
        accelerations: ``(N, joints)`` [rad/s^2, m/s^2].
    """

    joints: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    def __post_init__(self) -> None:
        for name in ("times", *_NUMBERS):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def duration(self) -> float:
        """Time of the last point [s]."""
        return float(self.times[-1])

    @property
    def speeds(self) -> FloatArray:
        """Each joint's largest speed at a point ``(joints,)`` [rad/s, m/s]."""
        return np.asarray(np.max(np.abs(self.velocities), axis=0))

    def at_speed(self, factor: float) -> Trajectory:
        """The same path, ``factor`` times as fast."""
        return replace(
            self,
            times=self.times / factor,
            velocities=self.velocities * factor,
            accelerations=self.accelerations * factor**2,
        )

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities ``(joints,)`` at a ``time`` [s]; before the first point and after the last one those
        of this point."""
        time = min(max(time, float(self.times[0])), self.duration)
        after = min(max(int(np.searchsorted(self.times, time)), 1), len(self.times) - 1)
        pair = slice(after - 1, after + 1)
        span, passed = float(np.diff(self.times[pair])[0]), time - float(self.times[after - 1])
        coefficients = _quintic(span, self.positions[pair], self.velocities[pair], self.accelerations[pair])
        powers = np.arange(6)
        slopes = powers[1:] * passed ** powers[:-1]
        return passed**powers @ coefficients, slopes @ coefficients[1:]


def _quintic(span: float, positions: FloatArray, velocities: FloatArray, accelerations: FloatArray) -> FloatArray:
    """Coefficients ``(6, joints)``, by power of the time [s], of the polynomials between two points ``(2, joints)``."""
    (p, end), (v, last_v), (a, last_a) = positions, velocities, accelerations
    rest = (end - p) / span - v - a * span / 2.0  # what the powers above two must add
    speed = last_v - v - a * span
    bend = (last_a - a) * span
    return np.array(
        [
            p,
            v,
            a / 2.0,
            (10.0 * rest - 4.0 * speed + bend / 2.0) / span**2,
            (-15.0 * rest + 7.0 * speed - bend) / span**3,
            (6.0 * rest - 3.0 * speed + bend / 2.0) / span**4,
        ]
    )


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
        raise InputError(f"{path}: {len(points)} points, expected two at least")
    rows = list(_rows(path, points, len(joints)))
    times = np.array([time for time, _ in rows])
    late = np.flatnonzero(np.diff(times, prepend=-1e-9) <= 0.0)
    if len(late):
        raise InputError(f"{path}: point {late[0]} is at {times[late[0]]:g} s, not after the one before it")
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
        raise InputError(f"{path}: no {_WHAT}: expected the lists joint_names and points, as 'geomid excite' writes")
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
            raise InputError(f"{path}: point {index} has not what a point has: {expected}") from error
        if numbers.shape != (3, joints) or not np.all(np.isfinite([seconds, *numbers.ravel()])):
            raise InputError(f"{path}: point {index} must have {joints} finite {', '.join(_NUMBERS)}, one by joint")
        yield seconds, numbers
