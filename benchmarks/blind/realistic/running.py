"""One realistic case from its seed to its outcome: recorded, then asked of ``geomid gap`` in both situations."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from benchmarks.blind.case import robot_file
from benchmarks.blind.realistic.case import RealisticCase, draw
from benchmarks.blind.realistic.sizing import sized
from benchmarks.blind.running import command
from geomid_ros.errors import GeomidError
from geomid_ros.simulation.description import read_description, robot_description
from geomid_ros.simulation.recording import simulate

SITUATIONS = ("model", "urdf")
"""What ``gap`` starts from: a model identified before the change, or the URDF alone."""

_ATTEMPTS = 6


def outcome(seed: int, out: Path) -> dict[str, Any]:
    """The finished case as a document, read from ``out`` when it is there already.

    ``out/bags`` holds the recordings of every case and ``out/outcomes`` what became of it; delete the latter to run
    another version of the workflow on the same recordings. A case that cannot be recorded has an ``error`` and is not
    kept; a situation in which the workflow fails has one in place of a result, and is tried again.
    """
    try:
        case = draw(seed)
        recorded = _recorded(case, out / "bags" / str(seed))
    except GeomidError as error:
        return {"seed": seed, "error": str(error)}
    file = out / "outcomes" / f"{seed}.json"
    known = json.loads(file.read_text()) if file.is_file() else {}
    if known.get("recorded") == recorded and not any("error" in known[situation] for situation in SITUATIONS):
        return dict(known)
    document = {"seed": seed, "recorded": recorded, **_run(out / "bags" / str(seed))}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(document, indent=1) + "\n")
    return document


def _run(folder: Path) -> dict[str, Any]:
    robot, known = ["--urdf", str(folder / "robot.urdf")], folder / "known"
    shutil.rmtree(known, ignore_errors=True)
    _, trouble = command(["identify", str(folder / "was"), *robot, "--out", str(known)])
    start = {"model": [*robot, "--model", str(known / "estimate.json")], "urdf": robot}
    failed = {"model": trouble, "urdf": ""}
    return {
        situation: {"error": failed[situation]} if failed[situation] else _gap(folder, situation, start[situation])
        for situation in SITUATIONS
    }


def _gap(folder: Path, situation: str, start: list[str]) -> dict[str, Any]:
    begin = time.perf_counter()
    arguments = ["gap", str(folder / "now"), *start, "--out", str(folder / f"gap_{situation}"), "--json"]
    printed, trouble = command(arguments)
    found = {"error": trouble} if trouble else {"gap": json.loads(printed)}
    return {"seconds": time.perf_counter() - begin, **found}


def _recorded(case: RealisticCase, folder: Path) -> dict[str, Any]:
    """The case as it was recorded, with how far the change shows and what is true of the changed robot."""
    stamp = folder / "case.json"
    if stamp.is_file() and (known := json.loads(stamp.read_text()))["drawn"] == _as_json(case.document()):
        return dict(known)
    drawn = case.document()
    for attempt in range(_ATTEMPTS):
        shutil.rmtree(folder, ignore_errors=True)
        try:  # motions that the drives cannot follow are tried again, slower
            case, shown = sized(case)
            _simulate(case, folder)
            break
        except GeomidError:
            if attempt + 1 == _ATTEMPTS:
                raise
            case = case.slower()
    truth = _truth(folder)
    document = _as_json({"drawn": drawn, "case": case.document(), "shown": asdict(shown), "truth": truth})
    stamp.write_text(json.dumps(document, indent=1) + "\n")
    return document


def _truth(folder: Path) -> dict[str, Any]:
    """The changed robot's, with each link's joint and how far its mass is from the URDF's, as a share."""
    truth = json.loads((folder / "now.truth.json").read_text())
    urdf = read_description((folder / "robot.urdf").read_text())
    nominal = {body.name: body.mass for body in urdf.inertias}
    for link in truth["links"]:
        link["joint"] = urdf.moved_by(link["name"])
        link["mass_error"] = link["mass"] / nominal[link["name"]] - 1.0
    return dict(truth)


def _simulate(case: RealisticCase, folder: Path) -> None:
    """The recordings ``was`` and ``now``."""
    robot = robot_file(case.was.robot)
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(robot_description(robot), encoding="utf-8")
    simulate(folder / "was", replace(case.was, robot=robot))
    simulate(folder / "now", replace(case.now, robot=robot))


def _as_json(document: dict[str, Any]) -> dict[str, Any]:
    return dict(json.loads(json.dumps(document)))
