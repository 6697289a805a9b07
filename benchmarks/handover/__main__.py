"""Held-out errors of every file that is written, loaded by the program that reads it, on every measured robot.

    python -m benchmarks.handover [SET ...] [--out after.json] [--before before.json]

For each recording of ../shared/data and each format: the URDF as it was given, the identified inertias alone without
any friction, the written file alone, and the estimate with all its effects; sums over the channels of the RMS on data
that were not fitted [N m, N]. For go2_air the recorded commands are replayed as well [mrad].
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import geomid_ros
from benchmarks.handover import closed_loop
from benchmarks.handover.readers import READERS, Predict, installed
from benchmarks.measured_data import CASES, DATA, Case
from geomid_ros.api.identify import Identification
from geomid_ros.exports.descriptions import described
from geomid_ros.exports.model import read_model
from geomid_ros.exports.payload import each_link
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import with_inertials
from geomid_ros.files.models.written_model import written_model
from geomid_ros.model.effects import AtJoint
from geomid_ros.model.effects.friction import CoulombFriction
from geomid_ros.model.samples import Samples
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_GAINS = 20.0, 1.5  # of the controller of go2_air [N m/rad, N m s/rad]
_FITTED = 0.7  # of the time
_COLUMNS = "URDF given", "inertias only", "file", "with sidecar", "estimate"


def figures(name: str) -> dict[str, Any]:
    """Totals by reader and column, and the closed loop where it can be simulated."""
    case = CASES[name]
    found = geomid_ros.identify(
        [DATA / bag for bag in case.train],
        case.description,
        validate=[DATA / bag for bag in case.validate],
        **case.options,
    )
    test = Samples.concatenate(list(found.held_out))
    with tempfile.TemporaryDirectory() as folder:
        found.save(folder)
        rows = _floating(found, test) if found.session.robot.floating_base else _by_reader(found, test, Path(folder))
        loop = _loops(case, found, Path(folder)) if name == "go2_air" else {}
    return {"rows": rows, "closed loop [mrad]": loop, "verdict": found.verdict.word}


def _by_reader(found: Identification, test: Samples, folder: Path) -> dict[str, dict[str, float]]:
    session = found.session
    joints, gravity = list(session.robot.joint_names), np.asarray(session.robot.gravity)
    given, inertias = session.urdf, without_dynamics(_with_estimated(found))
    rows = {}
    for tool, readers in READERS.items():
        model = read_model(folder / "estimate.json", tool)
        text = described(model, tool, each_link(model), {}).text
        if tool == "urdf":
            text = (folder / "identified.urdf").read_text()
        for reader, load in readers:
            if not installed(reader):
                continue
            files = {"URDF given": given, "inertias only": inertias, "file": text}
            # MuJoCo reads both; what the URDF says of friction it reads as its own.
            totals = {column: _total(load, each, joints, gravity, test) for column, each in files.items()}
            totals["with sidecar"] = _total(load, text, joints, gravity, test, offsets_beside(found, tool, joints))
            totals["estimate"] = float(np.nansum(list(found.rms.values())))
            rows[f"{tool} by {reader}"] = totals
    return rows


def _total(
    load: Any, text: str, joints: list[str], gravity: FloatArray, test: Samples, offsets: FloatArray | float = 0.0
) -> float:
    try:
        predict: Predict = load(text, joints, gravity)
    except (RuntimeError, ValueError) as error:  # a program that does not take the file
        print(f"  not read: {str(error).splitlines()[0][:150]}", file=sys.stderr)
        return float("nan")
    left = predict(test, directions(test)) + offsets - test.effort
    return float(np.nansum(np.sqrt(np.nanmean(left**2, axis=0))))


def directions(samples: Samples) -> FloatArray:
    """The sign of the joints' velocities ``(N, joints)``, filtered as their efforts were."""
    count = samples.effort.shape[1]
    return samples.efforts_of((CoulombFriction(), AtJoint(joint), 1.0) for joint in range(count))


def offsets_beside(found: Identification, tool: str, joints: list[str]) -> FloatArray:
    """Offsets ``(joints,)`` of the efforts, as they stand beside the file."""
    effects = written_model(found.session.model, found.estimate, tool, found.session.loaded.effects).effects
    known = {own.joint: own.parameters["offset"].value for own in effects if own.effect == "effort_offset"}
    return np.array([known.get(name, 0.0) for name in joints])


def _with_estimated(found: Identification) -> str:
    """The URDF as it was given with the estimate's own inertias."""
    merged = [name for link in found.links for name in link.merged]
    inertias = {link.name: link.parameters for link in found.links}
    return with_inertials(found.session.urdf, inertias, merged)


def without_dynamics(urdf: str) -> str:
    """A URDF without friction."""
    return re.sub(r"<dynamics\b[^>]*/>", "", urdf)


def _floating(found: Identification, test: Samples) -> dict[str, dict[str, float]]:
    """Of a base that floats: the wrenches, by the package's own rows of the file's inertias."""
    files = {"URDF given": found.session.urdf, "inertias only": without_dynamics(found.urdf()), "file": found.urdf()}
    totals = {column: _wrenches(found, text, test) for column, text in files.items()}
    totals["estimate"] = float(np.nansum(list(found.rms.values())))
    return {"urdf": totals}


def _wrenches(found: Identification, urdf: str, test: Samples) -> float:
    session = Session(urdf, found.session.configuration, "written file")
    return float(np.nansum(session.rms([test], session.model.nominal_parameters)))


def _loops(case: Case, found: Identification, folder: Path) -> dict[str, float]:
    """RMS [mrad] under the recorded commands, on the last part, of the MJCF as it is written."""
    joints = list(found.session.robot.joint_names)
    recording = _commanded(DATA / case.train[0], joints)
    model = read_model(folder / "estimate.json", "mujoco")
    text = described(model, "mujoco", each_link(model), {}).text
    delay = closed_loop.best_delay(text, joints, recording.part(0.0, _FITTED))
    error = closed_loop.error(text, joints, recording.part(_FITTED, 1.0), delay)
    return {"file": 1e3 * error, "delay [ms]": 1e3 * delay}


def _commanded(bag: Path, joints: list[str]) -> closed_loop.Commanded:
    topics = ("/joint_states", "/joint_commands")
    times: dict[str, list[float]] = {topic: [] for topic in topics}
    values: dict[str, list[FloatArray]] = {topic: [] for topic in topics}
    with Bag(bag) as opened:
        for topic, _, message in opened.messages(topics):
            order = [list(message.name).index(name) for name in joints]
            times[topic].append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
            values[topic].append(np.array(message.position)[order])
    measured, commanded = (np.array(values[topic]) for topic in topics)
    at, there = (np.array(times[topic]) for topic in topics)
    commands = np.stack([np.interp(at, there, column) for column in commanded.T], axis=1)
    return closed_loop.Commanded(at - at[0], measured, commands, *_GAINS)


def main() -> None:
    """Print a table of all sets."""
    if not DATA.is_dir():
        sys.exit(f"the measured recordings are not there: {DATA}")
    parser = argparse.ArgumentParser(prog="python -m benchmarks.handover", description=__doc__)
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"of {', '.join(CASES)}; all unless given")
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    parser.add_argument("--before", type=Path, help="figures of an earlier run to print beside")
    arguments = parser.parse_args()
    before = json.loads(arguments.before.read_text()) if arguments.before else {}
    kept = {name: figures(name) for name in arguments.sets or CASES}
    _show(kept, before)
    if arguments.out:
        arguments.out.write_text(json.dumps(kept, indent=2))


def _show(kept: dict[str, Any], before: dict[str, Any]) -> None:
    table = Table(title="Held-out totals [N m, N]", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("set", "file", *_COLUMNS, "file, before", ""):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, own in kept.items():
        for reader, totals in own["rows"].items():
            old = before.get(name, {}).get("rows", {}).get(reader, {})
            worse = totals["file"] > 1.001 * totals["inertias only"]
            cells = (_cell(totals.get(column)) for column in _COLUMNS)
            table.add_row(name, reader, *cells, _cell(old.get("file")), "WORSE than inertias only" if worse else "")
    console = Console(width=180)
    console.print(table)
    for name, own in kept.items():
        if own["closed loop [mrad]"]:
            console.print(f"{name}, recorded commands: {own['closed loop [mrad]']}")


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


if __name__ == "__main__":
    main()
