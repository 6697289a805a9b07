"""``geomid feedforward``: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from excitation.motions import Motion, lively
from files.recordings import BAGS

from .running import done, refused

URDF = BAGS / "arm3.urdf"
JOINTS = ("joint1", "joint2", "joint3")


@pytest.fixture
def model(torques: Path) -> Path:
    return torques / "estimate.json"


def sent(folder: Path, motion: Motion | None = None, joints: tuple[str, ...] = JOINTS) -> Path:
    return (motion or lively(joints, 4.0, 0.4)).write(folder / "trajectory.yaml", 30)


def test_a_trajectory_comes_back_with_efforts(model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.yaml"
    printed = done("feedforward", sent(tmp_path), "--model", model, "--out", out)
    points = yaml.safe_load(out.read_text())["points"]
    assert all(len(point["effort"]) == len(JOINTS) for point in points)
    assert f"{len(points)} points (30 were given)" in printed
    largest = np.max(np.abs([point["effort"] for point in points]), axis=0)
    for joint, effort in zip(JOINTS, largest, strict=True):
        (row,) = [line for line in printed.splitlines() if joint in line]
        assert float(row.split()[2]) == pytest.approx(effort, rel=1e-3)


def test_a_model_with_a_sensor_at_the_wrist_needs_no_further_word(wrist: Path, tmp_path: Path) -> None:
    """The bodies that the sensor divides are in the model."""
    command = ("feedforward", sent(tmp_path), "--model", wrist / "estimate.json", "--out", tmp_path / "out.yaml")
    sensor = {"wrenches": ["wrench"], "wrench.wrench.frame": "wrist_ft"}
    (tmp_path / "sensor.yaml").write_text(json.dumps({"/**": {"ros__parameters": sensor}}))
    assert done(*command) == done(*command, "--config", tmp_path / "sensor.yaml")


def test_a_doubtful_model_moves_a_robot_only_by_force(model: Path, tmp_path: Path) -> None:
    document = json.loads(model.read_text())
    document["verdict"] = {"result": "doubtful", "reasons": ["joint2 seems to be reversed"]}
    doubtful = tmp_path / "estimate.json"
    doubtful.write_text(json.dumps(document))
    arguments = ("feedforward", sent(tmp_path), "--model", doubtful, "--urdf", URDF, "--out", tmp_path / "out.yaml")
    message = refused(*arguments)
    assert "joint2 seems to be reversed" in message
    assert "set force" in message
    assert not (tmp_path / "out.yaml").exists()
    assert "Note: " in done(*arguments, "--force")


def test_what_is_no_trajectory_of_this_robot_is_refused(model: Path, tmp_path: Path) -> None:
    other = sent(tmp_path, joints=("joint1", "joint2", "elbow"))
    assert f"{other}: unknown joint 'elbow'" in refused("feedforward", other, "--model", model)
    fast = sent(tmp_path, lively(JOINTS, 0.05, 0.4))
    assert "more than its limit of" in refused("feedforward", fast, "--model", model)
    assert "no robot is given" in refused("feedforward", sent(tmp_path))
