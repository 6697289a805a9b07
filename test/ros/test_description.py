"""The robot description: from the topic or the parameter, late, unreadable, changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String

from .observer import latched
from .stage import KINDS, WRIST, Stage, description, messages

ARM3 = description("arm3")
IMPOSSIBLE = ARM3.replace('ixx="0.011367"', 'ixx="0.5"')
MESSAGES = messages()
EACH = len(MESSAGES) // 2


def error(values: dict[str, str], status: Any) -> bool:
    return bool(status.level == DiagnosticStatus.ERROR)


def warning(values: dict[str, str], status: Any) -> bool:
    return bool(status.level == DiagnosticStatus.WARN)


def test_a_late_and_at_first_unreadable_description_on_the_topic(stage: Stage, tmp_path: Path) -> None:
    node = stage.node({**WRIST, "output_folder": str(tmp_path / "out")})
    observer = stage.observer
    assert observer.diagnostics(warning, "a warning").status[0].message == "no robot description yet"
    observer.publish(MESSAGES[:20], KINDS)
    observer.diagnostics(lambda values, _: values.get("dropped: no robot description yet") == "20", "dropped messages")
    talker = observer.node.create_publisher(String, "/robot_description", latched(1))
    for text, reason in (("no URDF", "its XML cannot be read"), (IMPOSSIBLE, "link 'link2' belongs to no body")):
        talker.publish(String(data=text))
        observer.diagnostics(
            lambda values, status, reason=reason: error(values, status) and reason in status.message, reason
        )
        assert node.running
    talker.publish(String(data=ARM3))
    observer.diagnostics(lambda values, status: not error(values, status), "no error")
    observer.publish(MESSAGES, KINDS)
    stage.fed({"joint_states": EACH, "/wrench": EACH})
    assert observer.trigger("/geomid/save")[0]
    array = observer.diagnostics(lambda *_: True, "diagnostics")
    assert len(array.status) == 5


def test_a_description_that_was_there_before(stage: Stage) -> None:
    """As a robot_state_publisher keeps it."""
    talker = stage.observer.node.create_publisher(String, "/robot_description", latched(1))
    talker.publish(String(data=ARM3))
    stage.node()
    stage.observer.diagnostics(lambda _, status: status.message == "no messages on joint_states", "a robot")


def test_a_changed_description_waits_for_a_reset(stage: Stage) -> None:
    node = stage.node({"solve_period": 0.2})
    observer = stage.observer
    talker = observer.node.create_publisher(String, "/robot_description", latched(1))
    talker.publish(String(data=ARM3))
    observer.diagnostics(lambda _, status: "no messages on" in status.message, "a robot")
    changed = ARM3.replace('<mass value="2.2"/>', '<mass value="4.4"/>').replace('name="link1"', 'name="trunk"')
    changed = changed.replace('link="link1"', 'link="trunk"')
    kinds = {"/joint_states": KINDS["/joint_states"]}
    half = len(MESSAGES) // 2

    def links() -> list[str]:
        array = observer.diagnostics(lambda *_: True, "diagnostics")
        return [status.name.removeprefix("geomid: ") for status in array.status[1:]]

    talker.publish(String(data=changed))
    array = observer.diagnostics(error, "an error")
    assert array.status[0].message == "the robot description has changed; it is used after ~/reset"
    observer.publish(MESSAGES[:half], kinds)
    stage.fed({"joint_states": half // 2})
    observer.wait_for(lambda: links() == ["link1", "link2", "link3"], "the old robot")
    talker.publish(String(data=ARM3))
    observer.diagnostics(lambda values, status: not error(values, status), "no error, as it is the old one again")
    talker.publish(String(data=IMPOSSIBLE))
    observer.diagnostics(error, "an error")
    success, reason = observer.trigger("/geomid/reset")
    assert not success
    assert "link 'link2' belongs to no body" in reason
    assert links() == ["link1", "link2", "link3"], "the old robot is kept"
    talker.publish(String(data=changed))
    observer.spin(0.5)
    assert observer.trigger("/geomid/reset")[0]
    observer.diagnostics(lambda values, status: not error(values, status) and values["rows"] == "0", "a new robot")
    observer.publish(MESSAGES[half:], kinds)
    stage.fed({"joint_states": half // 2})
    observer.wait_for(lambda: links() == ["trunk", "link2", "link3"], "the new robot")
    assert node.end() == 0
