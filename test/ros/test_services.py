"""start, stop, reset and save."""

from __future__ import annotations

import json
import signal
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus

from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages

ARM3 = {**WRIST, **NO_CHOICE, "robot_description": description("arm3"), "solve_period": 0.5}
MESSAGES = messages()
HALF = len(MESSAGES) // 2
EACH = HALF // 2  # messages of either topic in half of the bag
NOTHING = (False, "no usable rows: nothing was measured, or the robot never moved")


def stopped(values: dict[str, str]) -> int:
    """Messages that were dropped while the node was stopped."""
    return sum(int(values.get(f"{topic} dropped: stopped", "0")) for topic in ("joint_states", "/wrench"))


def test_stopped_messages_are_counted_and_cost_nothing(stage: Stage) -> None:
    """Without a folder results are saved where the node was started. A reset forgets, whatever is being solved for."""
    stage.node({**ARM3, "active": False})
    observer, folder = stage.observer, stage.folder / "process0"
    observer.publish(MESSAGES[:HALF], KINDS)
    array = observer.diagnostics(lambda values, _: stopped(values) == HALF, "dropped messages")
    assert (array.status[0].level, array.status[0].message) == (DiagnosticStatus.OK, "stopped")
    assert observer.trigger("/geomid/save") == NOTHING
    assert observer.trigger("/geomid/start") == (True, "identifying")
    observer.publish(MESSAGES[HALF:], KINDS)
    stage.fed({"joint_states": 2 * EACH, "/wrench": 2 * EACH})
    assert observer.trigger("/geomid/stop")[0]
    observer.publish(MESSAGES[:10], KINDS)
    array = observer.diagnostics(lambda values, _: stopped(values) == HALF + 10, "more dropped messages")
    values = {pair.key: pair.value for pair in array.status[0].values}
    assert values["joint_states accepted"] == str(EACH)
    success, message = observer.trigger("/geomid/save")
    assert success, "what was identified before is kept"
    assert {path.name for path in folder.iterdir()} == {"estimate.json", "identified.urdf", "posterior.npz"}
    assert all(str(path) in message for path in folder.iterdir())
    before = json.loads((folder / "estimate.json").read_text())["rows"]["accepted"]
    assert before == int(values["rows"]) > 0
    assert observer.trigger("/geomid/reset") == (True, "all rows discarded")
    assert observer.trigger("/geomid/save") == NOTHING
    for _ in range(2):
        array = observer.diagnostics(lambda values, _: values["rows"] == "0", "no rows")
        assert [status.name for status in array.status] == ["geomid: stream"]
    assert observer.trigger("/geomid/start")[0]
    observer.publish(MESSAGES[HALF : HALF + HALF // 2], KINDS)
    stage.fed({"joint_states": 2 * EACH + EACH // 2 + 5, "/wrench": 2 * EACH + EACH // 2 + 5})
    assert observer.trigger("/geomid/save")[0]
    assert 0 < json.loads((folder / "estimate.json").read_text())["rows"]["accepted"] < 0.7 * before


def test_services_without_a_robot_say_what_is_missing(stage: Stage, tmp_path: Path) -> None:
    """Nor is anything saved in the end, with a robot of which nothing was heard either."""
    out = {"output_folder": str(tmp_path / "out")}
    node = stage.node(out)
    silent = stage.node({**ARM3, **out, "gap.memory": 0.0}, "-r", "__ns:=/b", name="b/geomid")
    no_memory = (False, "no messages in memory: the parameter gap.memory is 0")
    assert stage.observer.trigger("/b/geomid/find_gap") == no_memory
    for service in ("reset", "save", "find_gap", "payload/empty"):
        assert stage.observer.trigger(f"/geomid/{service}") == (False, "no robot description yet")
    assert stage.observer.trigger("/geomid/stop")[0]
    assert stage.observer.trigger("/geomid/start")[0]
    assert (node.end(signal.SIGTERM), silent.end(signal.SIGINT)) == (0, 0)
    assert not (tmp_path / "out").exists()
