"""Signals: the node and the player end with the status they should, with results saved and nothing to clean up."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from files.recordings import BAGS
from geometry_msgs.msg import InertiaStamped

from .observer import latched
from .stage import WRIST, Stage, description


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_busy_node_saves_its_last_estimate(number: signal.Signals, stage: Stage, tmp_path: Path) -> None:
    """In the middle of everything, and however often it is told."""
    out = tmp_path / "out"
    parameters = {**WRIST, "robot_description": description("arm3"), "solve_period": 0.05, "output_folder": str(out)}
    node = stage.node(parameters)
    player = stage.play(BAGS / "arm3", 2.0)
    inertias = stage.observer.collect(InertiaStamped, "/geomid/inertias", latched())
    stage.observer.wait_for(lambda: len(inertias) > 10, "estimates")
    for _ in range(3):
        node.send(number)
    assert node.status() == 0, node.output
    document = json.loads((out / "estimate.json").read_text())
    assert document["rows"]["accepted"] > 0
    assert (out / "identified.urdf").read_text().startswith("<?xml")
    assert {path.name for path in out.iterdir()} == {"estimate.json", "identified.urdf"}
    player.send(number)
    assert player.status() == 1
    assert "Aborted!" in player.output


def test_idle_nodes(stage: Stage, tmp_path: Path) -> None:
    """Without a robot, without data, or without a folder there is nothing to save."""
    out = tmp_path / "out"
    waiting = stage.node({"output_folder": str(out)}, "-r", "__ns:=/a", name="a/geomid")
    silent = stage.node(
        {"output_folder": str(out), "robot_description": description("arm3")}, "-r", "__ns:=/b", name="b/geomid"
    )
    assert waiting.end(signal.SIGTERM) == 0
    assert silent.end(signal.SIGINT) == 0
    assert not out.exists()


def test_a_node_told_to_end_while_it_starts(stage: Stage) -> None:
    """Whatever it was doing: no traceback, and no core dump."""
    node = stage.node(ready=False)
    stage.observer.wait_for(lambda: node.running, "a process")
    stage.observer.spin(0.6)
    node.send(signal.SIGTERM)
    assert node.status() in (0, -signal.SIGTERM)
