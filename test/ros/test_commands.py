"""Set-points in place of torque sensors: the node identifies the robot from ``joint_commands``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from files.recordings import BAGS, Recorded
from sensor_msgs.msg import JointState

from .stage import NO_CHOICE, Stage, description, messages

KP, KD = 200.0, 5.0
PERIOD = 0.01  # [s] of the recording
STATES = [item for item in messages() if item.topic == "/joint_states"]


def with_commands(state: Recorded) -> list[Recorded]:
    """The set-point whose error makes a controller send the effort of a joint state, and the state without it."""
    message = state.message
    target = message.position + (message.effort + KD * message.velocity) / KP
    nothing = np.zeros(0)
    command = state.changed(position=target, velocity=nothing, effort=nothing)
    return [replace(command, topic="/joint_commands"), state.changed(effort=nothing)]


def test_friction_and_rotor_inertia_are_identified_from_commands(stage: Stage, tmp_path: Path) -> None:
    """Joint states have no efforts; the recording's truth is found. The controller of these commands acts on the state
    of their own instant, half a period before the average of the time for which they hold."""
    items = [item for state in STATES for item in with_commands(state)]
    gains, out = {"command": {"gains": [f"{KP}:{KD}"]}}, tmp_path / "out"
    stage.node({**NO_CHOICE, **gains, "robot_description": description("arm3"), "output_folder": str(out)})
    stage.observer.publish(items, {"/joint_states": JointState, "/joint_commands": JointState})
    stage.fed({"joint_states": len(STATES), "joint_commands": len(STATES)})
    success, message = stage.observer.trigger("/geomid/save")
    assert success, message
    effects = json.loads((out / "estimate.json").read_text())["effects"]
    identified = {(effect["name"], effect["joint"]): effect for effect in effects}
    truth = json.loads((BAGS / "arm3.truth.json").read_text())["effects"]
    for planted in truth:
        if planted["effect"] in ("coulomb_friction", "rotor_inertia"):
            (value,) = planted["parameters"].values()
            found = identified[planted["effect"], planted["joint"]]
            assert found["value"] == pytest.approx(value, rel=0.05, abs=2.0 * found["std"])
    assert identified["command_delay", ""]["value"] == pytest.approx(-0.5 * PERIOD, abs=0.2 * PERIOD)
