"""``geomid gap`` on measured robots: what it names, and the gap before and after on data that it did not fit."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.measured_data import CASES
from benchmarks.problem import measured
from benchmarks.report import Report
from geomid_ros.types import FloatArray

_DOUBTFUL = 4  # exit status of a result that is doubtful
_SHOWN = 6  # names of a row
_PAUSE = 2.0  # s between runs that were recorded by themselves
# The joint's axis is upright and the link small beside the friction.
_ONE_JOINT = """<robot name="one_joint"><link name="base"/><link name="hand"><inertial><origin xyz="0 0 0.03"/>
<mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint7" type="continuous"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/></joint></robot>
"""


@dataclass(frozen=True)
class _Recording:
    """A robot, the arguments of ``geomid gap`` for it, and what is known of its gap."""

    robot: str
    known: str
    arguments: tuple[str | Path, ...]


def run(report: Report) -> None:
    """The table of all robots."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for recording in _recordings(Path(folder)):
            report.progress(f"gap: {recording.robot}")
            begin = time.perf_counter()
            arguments = ["gap", *recording.arguments, "--json", "--out", Path(folder) / "gap"]
            found = json.loads(_geomid(*arguments))
            seconds = time.perf_counter() - begin
            report.result(f"gap {recording.robot}", found | {"seconds": seconds})
            rows.append([recording.robot, recording.known, *_cells(found), f"{seconds:.0f}"])
    headings = [
        "",
        "known",
        "verdict",
        "named confidently",
        "others",
        "worst gap before",
        "inertias only",
        "after",
        "s",
    ]
    caption = (
        "Gaps in units of the noise floor, on held-out data, of the worst channel. Seconds of the whole command, with "
        "reading, simulating again and drawing."
    )
    report.table("Gaps of measured robots", headings, rows, caption)


def _recordings(folder: Path) -> Iterator[_Recording]:
    ur10 = measured("ur10_unisa_rosbag2")
    yield _Recording(
        "UR10",
        "efforts are motor currents: friction, rotor inertia",
        (ur10 / "ur10_exciting_trajectory", "--urdf", ur10 / "ur10.urdf"),
    )
    rokae = measured("rokae_ar5_tilted")
    urdf = next(rokae.glob("*.urdf"))
    gravity = map(str, CASES["rokae"].options["config"]["gravity"])
    yield _Recording("ROKAE AR5", "mounted on its side", (rokae / "real", "--urdf", urdf, "--gravity", *gravity))
    airbot = measured("airbot_play")
    robot = ("--urdf", airbot / "airbot_play.urdf")
    _geomid("identify", airbot / "chirp", *robot, "--out", folder / "unloaded")
    yield _Recording(
        "AIRBOT, loaded",
        "a payload at link6, about 0.3 kg by plain methods",
        (airbot / "chirp_loaded", *robot, "--model", folder / "unloaded" / "estimate.json"),
    )
    lwr = measured("kuka_lwr4_hw")
    yield _Recording(
        "LWR4+",
        "friction",
        (lwr / "measurements_1", "--validate", lwr / "measurements_2", "--urdf", lwr / "kuka_lwr4.urdf"),
    )
    even, odd = _friction_sweep(folder)
    (folder / "one_joint.urdf").write_text(_ONE_JOINT)
    yield _Recording(
        "Gen3, joint 7",
        "Stribeck friction, one direction only",
        (even, "--validate", odd, "--urdf", folder / "one_joint.urdf"),
    )


def _friction_sweep(folder: Path) -> tuple[Path, Path]:
    """Every other run at constant speed in one bag, the rest in another."""
    with np.load(measured("kinova_j7_friction_sweep") / "kinova_j7_friction_sweep.npz") as archive:
        data = dict(archive)
    bags = folder / "even", folder / "odd"
    for first, bag in enumerate(bags):
        parts, begin = [], 0.0
        for index in range(first, len(data["run_names"]), 2):
            chosen = data["run_id"] == index
            times = data["t"][chosen]
            columns = [np.unwrap(data["q"][chosen], axis=0), data["qd"][chosen], data["tau"][chosen]]
            parts.append([begin + times - times[0], *columns])
            begin += times[-1] - times[0] + _PAUSE
        stamps, position, velocity, effort = (np.concatenate(column) for column in zip(*parts, strict=True))
        _write_joint_states(bag, stamps, np.concatenate([position, velocity, effort], axis=1))
    return bags


def _write_joint_states(bag: Path, stamps: FloatArray, values: FloatArray) -> None:
    """Position, velocity and effort ``(N, 3)`` of one joint at ``stamps (N,)`` [s]."""
    types = get_typestore(Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/JointState"
    state, header, stamp = (types.types[name] for name in (kind, "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    with Writer(bag, version=Writer.VERSION_LATEST) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=types)
        for nanoseconds, row in zip((1e9 * (1.0 + stamps)).astype(int).tolist(), values[:, :, None], strict=True):
            time_stamp = stamp(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
            message = state(
                header=header(stamp=time_stamp, frame_id=""),
                name=["joint7"],
                position=row[0],
                velocity=row[1],
                effort=row[2],
            )
            writer.write(connection, nanoseconds, types.serialize_cdr(message, kind))


def _geomid(*arguments: str | Path) -> str:
    command = [sys.executable, "-m", "geomid_ros", *map(str, arguments)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)  # noqa: S603 a command of ours
    if done.returncode not in (0, _DOUBTFUL):
        raise subprocess.CalledProcessError(done.returncode, command, done.stdout, done.stderr)
    return done.stdout


def _cells(found: dict[str, Any]) -> list[str]:
    names: dict[bool, list[str]] = {True: [], False: []}
    for finding in found["findings"]:
        main, quantity = next(iter(finding["parameters"].items()))
        name = f"{finding['effect']} {finding['joint']} ({main} {_value(quantity)})"
        names[finding["confidence"] == "confident"].append(name)
    worst = [max(v for v in found["gap"][kind].values() if v is not None) for kind in _KINDS]
    return [
        found["verdict"],
        *("; ".join(names[sure][:_SHOWN]) for sure in (True, False)),
        *(f"{w:.2f}" for w in worst),
    ]


def _value(quantity: dict[str, Any]) -> str:
    std = "" if quantity["std"] is None else f" ± {quantity['std']:.2g}"
    return f"{quantity['value']:.3g}{std} {quantity['unit']}"


_KINDS = ("before", "inertias_only", "after")


if __name__ == "__main__":
    run(Report())
