"""The node as a managed one: what each state subscribes to, keeps and saves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from geometry_msgs.msg import InertiaStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from std_msgs.msg import String

from .observer import MATCHING, latched
from .processes import Process
from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages

ARM3 = description("arm3")
FEW = 300  # messages, of both topics
MESSAGES = messages()
MANAGED: dict[str, Any] = {**WRIST, **NO_CHOICE, "lifecycle": "managed"}


def changed(stage: Stage, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return bool(stage.observer.call(ChangeState, "/geomid/change_state", request).success)


def state(stage: Stage) -> str:
    return str(stage.observer.call(GetState, "/geomid/get_state", GetState.Request()).current_state.label)


def describe(stage: Stage, urdf: str) -> None:
    """Publish a description, as robot_state_publisher does."""
    stage.observer.node.create_publisher(String, "/robot_description", latched(1)).publish(String(data=urdf))
    stage.observer.spin(MATCHING)


def values_of(array: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in array.status[0].values}


def test_transitions(stage: Stage, tmp_path: Path) -> None:
    """A description that cannot be used keeps the node unconfigured; messages count while it is active."""
    observer, out = stage.observer, tmp_path / "out"
    kept = {"checkpoint": {"folder": str(tmp_path / "kept")}, "output_folder": str(out)}
    process = stage.node({**MANAGED, **kept})
    assert state(stage) == "unconfigured"
    observer.diagnostics(lambda _, status: "unconfigured" in status.message, "what it waits for")
    assert observer.trigger("/geomid/save") == (False, "the lifecycle state is unconfigured")
    describe(stage, ARM3.replace('link="wrist_ft"', 'link="nowhere"'))
    assert not changed(stage, Transition.TRANSITION_CONFIGURE)
    assert state(stage) == "unconfigured"
    (line,) = [line for line in process.output.splitlines() if "[ERROR]" in line]
    assert "nowhere" in line
    describe(stage, ARM3)
    assert changed(stage, Transition.TRANSITION_CONFIGURE)
    observer.publish(MESSAGES[:10], KINDS, heard=False)
    assert observer.trigger("/geomid/start") == (False, "the lifecycle state is not active")
    assert changed(stage, Transition.TRANSITION_ACTIVATE)
    observer.publish(MESSAGES[:FEW], KINDS)
    rows = values_of(stage.fed({"joint_states": FEW // 2, "/wrench": FEW // 2}))["rows"]
    assert changed(stage, Transition.TRANSITION_DEACTIVATE)
    observer.publish(MESSAGES[:10], KINDS, heard=False)
    array = observer.diagnostics(lambda _, status: status.message == "stopped", "the state")
    assert int(values_of(array)["rows"]) >= int(rows), "what it knows is kept"
    assert changed(stage, Transition.TRANSITION_ACTIVATE)
    observer.publish(MESSAGES[FEW : 2 * FEW], KINDS)
    values = values_of(stage.fed({"joint_states": FEW, "/wrench": FEW}))
    assert not [key for key in values if "lost" in key or "dropped" in key]
    assert observer.trigger("/geomid/save")[0]
    assert changed(stage, Transition.TRANSITION_DEACTIVATE)
    assert changed(stage, Transition.TRANSITION_CLEANUP)
    assert observer.trigger("/geomid/save") == (False, "the lifecycle state is unconfigured")
    restored_and_shut_down(stage, process, out)


def restored_and_shut_down(stage: Stage, process: Process, out: Path) -> None:
    """The rows are in the checkpoint; their estimate is published in the state active; the end writes the last."""
    before = json.loads((out / "estimate.json").read_text())["rows"]["accepted"]
    (out / "estimate.json").unlink()
    assert changed(stage, Transition.TRANSITION_CONFIGURE)
    stage.observer.diagnostics(lambda values, _: int(values.get("rows", "0")) >= before, "the rows of the checkpoint")
    inertias = stage.observer.collect(InertiaStamped, "/geomid/inertias", latched())
    stage.observer.diagnostics(lambda values, _: int(values["solves"]) > 0, "an estimate")
    stage.observer.spin(MATCHING)
    earlier = len(inertias)
    assert changed(stage, Transition.TRANSITION_ACTIVATE)
    stage.observer.wait_for(lambda: len(inertias) > earlier, "what was identified")
    assert changed(stage, Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert state(stage) == "finalized"
    assert json.loads((out / "estimate.json").read_text())["rows"]["accepted"] >= before
    finalized = "the lifecycle state is finalized"
    stage.observer.diagnostics(lambda _, status: status.message == finalized, "the state")
    assert stage.observer.trigger("/geomid/save") == (False, finalized)
    assert process.end() == 0


def test_autostart(stage: Stage) -> None:
    """It works without a manager, and a description that cannot be used leaves it to one."""
    process = stage.node({**MANAGED, "lifecycle": "autostart", "robot_description": ARM3})
    assert state(stage) == "active"
    assert not changed(stage, Transition.TRANSITION_CONFIGURE), "the state has no such transition"
    assert "[WARN]" in process.output
    assert "configure is not possible in state active" in process.output
    array = stage.observer.diagnostics(lambda _, status: "no messages" in status.message, "that it listens")
    assert not [key for key in values_of(array) if "failed" in key]
    assert "rcl" not in process.output
    assert state(stage) == "active"
    process = stage.node(
        {**MANAGED, "lifecycle": "autostart", "robot_description": "<robot"}, "-r", "__ns:=/bad", name="bad/geomid"
    )
    request = GetState.Request()
    assert stage.observer.call(GetState, "/bad/geomid/get_state", request).current_state.label == "unconfigured"
    assert "parameter robot_description" in process.output
