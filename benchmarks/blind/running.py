"""One case from its seed to its outcome: recorded by the generator, found by a process that sees the bags only."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from benchmarks.blind import drake_robot
from benchmarks.blind.case import Case, draw, robot_file
from geomid_ros.errors import GeomidError
from geomid_ros.simulation.description import read_description, robot_description
from geomid_ros.simulation.effect_sizes import chosen_effects
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.recording import simulate

_ROOT = Path(__file__).parents[2]
_PATIENCE = 1800.0  # s
_ATTEMPTS = 6
_ANSWERED = (0, 3, 4)  # exit statuses: usable, not converged, doubtful


def outcome(kind: str, seed: int, out: Path) -> dict[str, Any]:
    """The finished case as a document, read from ``out`` when it is there already.

    ``out/bags`` holds the recordings of every case and ``out/outcomes`` what became of it; delete the latter to run
    another version of the workflow on the same recordings. A case that cannot be recorded here is ``skipped``, and one
    on which the workflow fails has an ``error``; neither is kept.
    """
    case = draw(kind, seed)
    if reason := _missing(case):
        return {"case": case.document(), "skipped": reason}
    file = out / "outcomes" / f"{case.name}.json"
    wanted = _document(case)
    if file.is_file() and (known := json.loads(file.read_text()))["case"] == wanted:
        return dict(known)
    document = {"case": wanted, **_run(case, out / "bags" / case.name)}
    if "gap" in document:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(document, indent=1) + "\n")
    return document


def _document(case: Case) -> dict[str, Any]:
    """A case with the effects that the generator draws for it, as JSON returns it."""
    options = replace(case.held_out, robot=robot_file(case.held_out.robot))
    effects = chosen_effects(options, read_description(robot_description(options.robot)))
    document = case.document() | {"effects": [asdict(effect) for effect in effects]}
    return dict(json.loads(json.dumps(document)))


def _missing(case: Case) -> str:
    if case.simulator == "drake" and not drake_robot.available():
        return "needs Drake: pip install -r requirements-bench.txt"
    try:
        robot_file(case.held_out.robot)
    except GeomidError as error:
        return str(error)
    return ""


def _run(case: Case, folder: Path) -> dict[str, Any]:
    try:
        truth = _recorded(case, folder)
    except GeomidError as error:
        return {"error": f"cannot be recorded: {error}"}
    robot = ["--urdf", str(folder / "robot.urdf")]
    if case.held_out.wrench_frame:
        robot += ["--wrench", f"/wrench:{case.held_out.wrench_frame}:mounted"]
    if case.unloaded:
        known = folder / "unloaded"
        bags = [str(folder / name) for name in _names("unloaded", case.unloaded)]
        if trouble := command(["identify", *bags, *robot, "--effects", "none", "--out", str(known)])[1]:
            return {"error": trouble}
        robot += ["--model", str(known / "estimate.json")]
    bags = [str(folder / name) for name in _names("training", case.training)]
    begin, spent = time.perf_counter(), _spent()
    arguments = ["gap", *bags, "--validate", str(folder / "held_out"), *robot, "--out", str(folder / "gap"), "--json"]
    printed, trouble = command(arguments)
    found = {"error": trouble} if trouble else {"gap": json.loads(printed)}
    return {"truth": truth, "seconds": time.perf_counter() - begin, "processor_seconds": _spent() - spent, **found}


def _names(part: str, recordings: Sequence[SimulationOptions]) -> list[str]:
    return [f"{part}_{index}" for index in range(len(recordings))]


def _spent() -> float:
    """Processor time of all processes started from here [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def command(arguments: list[str]) -> tuple[str, str]:
    """What a command of ``geomid`` prints, and why it failed, empty if it did not."""
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(  # noqa: S603 it is a command of ours
            [sys.executable, "-m", "geomid_ros", *arguments],
            capture_output=True,
            text=True,
            timeout=_PATIENCE,
            env=environment,
            cwd=_ROOT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", f"not finished after {_PATIENCE:g} s"
    if done.returncode in _ANSWERED:
        return done.stdout, ""
    return done.stdout, done.stderr.strip()[-2000:] or "it failed without a word"


def _recorded(case: Case, folder: Path) -> dict[str, Any]:
    """The truth about a case, whose bags are in ``folder`` afterwards."""
    stamp = folder / "case.json"
    wanted = json.dumps(_document(case), indent=1)
    if not (stamp.is_file() and stamp.read_text() == wanted):
        shutil.rmtree(folder, ignore_errors=True)
        _record(case, folder)
        stamp.write_text(wanted)
    truth: dict[str, Any] = json.loads((folder / "held_out.truth.json").read_text())
    return truth


def _record(case: Case, folder: Path) -> None:
    """Motions that the drives cannot follow are tried again, slower."""
    for attempt in range(_ATTEMPTS):
        folder.mkdir(parents=True)
        try:
            _simulate(case, folder)
        except GeomidError:
            shutil.rmtree(folder)
            case = case.slower()
            if attempt + 1 == _ATTEMPTS:
                raise
        else:
            return


def _simulate(case: Case, folder: Path) -> None:
    robot = robot_file(case.held_out.robot)
    (folder / "robot.urdf").write_text(robot_description(robot), encoding="utf-8")
    names = [*_names("training", case.training), *_names("unloaded", case.unloaded), "held_out"]
    recordings = [*case.training, *case.unloaded, case.held_out]
    builder = drake_robot.DrakeRobot if case.simulator == "drake" else Plant
    for name, options in zip(names, recordings, strict=True):
        simulate(folder / name, replace(options, robot=robot), builder=builder)
