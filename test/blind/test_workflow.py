"""A small fixed part of the bench: hidden effects are found by the command, from the bags alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from commands.running import done
from files.recordings import QUICK

from geomid_ros.simulation.description import WRIST_FRAME, robot_description
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import simulate

pytestmark = pytest.mark.usefixtures("found_only")

ARM3 = SimulationOptions(
    robot="arm3", duration=12.0, inertia_error=0.15, motion_period=5.0, motion_harmonics=7, longest_step=QUICK
)
SEVERAL = (Hidden("spring", "joint3"), Hidden("viscous_friction", "joint1"), Hidden("effort_delay", "", 0.006))


def recorded(options: SimulationOptions, folder: Path, *more: str) -> Path:
    """A robot's description, and recordings of it: ``one`` and ``more`` to find in, an ``other`` to judge on."""
    pytest.importorskip("mujoco")
    for index, name in enumerate(("one", "other", *more)):
        simulate(folder / name, replace(options, motion_seed=100 + index))
    (folder / "robot.urdf").write_text(robot_description(options.robot))
    return folder


def found(folder: Path, out: Path, *more: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The workflow's gap.json, and what is true."""
    line = [folder / "one", "--validate", folder / "other", "--urdf", folder / "robot.urdf", *more]
    document = json.loads(done("gap", *line, "--out", out, "--json"))
    return document, json.loads((folder / "other.truth.json").read_text())["effects"]


def test_several_at_once_are_named(tmp_path: Path) -> None:
    """Exactly what is true is named confidently, with its size."""
    document, truth = found(recorded(replace(ARM3, seed=13, hide=SEVERAL), tmp_path), tmp_path / "out")
    confident = [entry for entry in document["findings"] if entry["confidence"] == "confident"]
    assert {(entry["effect"], entry["joint"]) for entry in confident} == {
        (entry["effect"], entry["joint"]) for entry in truth
    }
    for entry in truth:
        main = next(iter(entry["parameters"]))
        (named,) = (one for one in confident if one["effect"] == entry["effect"])
        assert named["parameters"][main]["value"] == pytest.approx(entry["parameters"][main], rel=0.1)


def test_beside_unsure_inertias_a_payload_is_told_as_one_or_as_a_heavier_link(tmp_path: Path) -> None:
    """Which of the two it is only its size says: no link is so wrong. What is sure is true."""
    options = replace(ARM3, seed=14, wrench_frame=WRIST_FRAME, hide=(Hidden("payload", "tool", 1.5),))
    loaded, wrist = recorded(options, tmp_path, "two"), ("--wrench", f"/wrench:{WRIST_FRAME}:mounted")
    document, truth = found(loaded, tmp_path / "out", loaded / "two", *wrist)
    sure = [entry for entry in document["findings"] if entry["confidence"] == "confident"]
    heavier = [link["mass"] for link in document["links"] if link["link"] == WRIST_FRAME]
    masses = [*heavier, *(entry["parameters"]["mass"] for entry in sure)]
    assert {(entry["effect"], entry["link"]) for entry in sure} <= {("payload", WRIST_FRAME)}
    (mass,) = masses
    assert abs(mass["value"] - truth[0]["parameters"]["mass"]) < 3.0 * mass["std"]
