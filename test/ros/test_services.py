"""start, stop, reset and save."""

from __future__ import annotations

import json
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus

from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages

ARM3 = {**WRIST, **NO_CHOICE, "robot_description": description("arm3"), "solve_period": 0.5}
MESSAGES = messages()
HALF = len(MESSAGES) // 2
EACH = HALF // 2  # messages of either topic in half of the bag


def stopped(values: dict[str, str]) -> int:
    """Messages that were dropped while the node was stopped."""
    return sum(int(values.get(f"{topic} dropped: stopped", "0")) for topic in ("joint_states", "/wrench"))


def test_stopped_messages_are_counted_and_cost_nothing(stage: Stage, tmp_path: Path) -> None:
    stage.node({**ARM3, "active": False, "output_folder": str(tmp_path / "out")})
    observer = stage.observer
    observer.publish(MESSAGES[:HALF], KINDS)
    array = observer.diagnostics(lambda values, _: stopped(values) == HALF, "dropped messages")
    assert (array.status[0].level, array.status[0].message) == (DiagnosticStatus.OK, "stopped")
    assert observer.trigger("/geomid/save") == (False, "no usable rows: nothing was measured, or the robot never moved")
    assert observer.trigger("/geomid/start") == (True, "identifying")
    observer.publish(MESSAGES[HALF:], KINDS)
    stage.fed({"joint_states": 2 * EACH, "/wrench": 2 * EACH})
    assert observer.trigger("/geomid/stop")[0]
    observer.publish(MESSAGES[:10], KINDS)
    array = observer.diagnostics(lambda values, _: stopped(values) == HALF + 10, "more dropped messages")
    values = {pair.key: pair.value for pair in array.status[0].values}
    assert values["joint_states accepted"] == str(EACH)
    assert observer.trigger("/geomid/save")[0], "what was identified before is kept"
    rows = json.loads((tmp_path / "out/estimate.json").read_text())["rows"]["accepted"]
    assert rows == int(values["rows"]) > 0


def test_reset_forgets(stage: Stage) -> None:
    """Whenever it comes: an estimate that is being solved for is forgotten too. Without a folder it is saved where the
    node was started."""
    stage.node(ARM3)
    observer = stage.observer
    observer.publish(MESSAGES[:HALF], KINDS)
    stage.fed({"joint_states": EACH, "/wrench": EACH})
    success, message = observer.trigger("/geomid/save")
    assert success, message
    written = {path.name: path for path in stage.folder.glob("process0/*")}
    assert written.keys() == {"estimate.json", "identified.urdf", "posterior.npz"}
    assert all(str(path) in message for path in written.values())
    before = json.loads(written["estimate.json"].read_text())["rows"]["accepted"]
    assert observer.trigger("/geomid/reset") == (True, "all rows discarded")
    success, reason = observer.trigger("/geomid/save")
    assert not success
    assert "no usable rows" in reason
    for _ in range(2):
        array = observer.diagnostics(lambda values, _: values["rows"] == "0", "no rows")
        assert [status.name for status in array.status] == ["geomid: stream"]
    observer.publish(MESSAGES[HALF : HALF + HALF // 2], KINDS)
    stage.fed({"joint_states": EACH + EACH // 2, "/wrench": EACH + EACH // 2})
    assert observer.trigger("/geomid/save")[0]
    after = json.loads(written["estimate.json"].read_text())["rows"]["accepted"]
    assert 0 < after < 0.7 * before


def test_services_without_a_robot_say_what_is_missing(stage: Stage) -> None:
    node = stage.node()
    for service in ("reset", "save"):
        assert stage.observer.trigger(f"/geomid/{service}") == (False, "no robot description yet")
    assert stage.observer.trigger("/geomid/stop")[0]
    assert stage.observer.trigger("/geomid/start")[0]
    assert node.end() == 0
