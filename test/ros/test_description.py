"""The robot description: from the topic or the parameter, late, unreadable, changed."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from std_msgs.msg import String

from .observer import latched
from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages

ARM3 = description("arm3")
IMPOSSIBLE = ARM3.replace('<mass value="1.7"/>', '<mass value="-1.7"/>')
MESSAGES = messages()


def error(_: dict[str, str], status: Any) -> bool:
    return bool(status.level == DiagnosticStatus.ERROR)


def test_a_late_and_at_first_unreadable_description(stage: Stage) -> None:
    node = stage.node({**WRIST, **NO_CHOICE})
    observer = stage.observer
    observer.publish(MESSAGES[:20], KINDS)
    dropped = {f"{topic} dropped: no robot description yet": "10" for topic in ("joint_states", "/wrench")}
    array = observer.diagnostics(lambda values, _: dropped.items() <= values.items(), "dropped messages")
    told = "no robot description yet on /robot_description"
    assert (array.status[0].level, array.status[0].message) == (DiagnosticStatus.WARN, told)
    talker = observer.node.create_publisher(String, "/robot_description", latched(1))
    for text, reason in (("no URDF", "its XML cannot be read"), (IMPOSSIBLE, "link 'link2' has a mass of -1.7 kg")):
        talker.publish(String(data=text))
        array = observer.diagnostics(lambda _, status, reason=reason: reason in status.message, reason)
        assert array.status[0].level == DiagnosticStatus.ERROR
        assert "topic robot_description: " in array.status[0].message
        assert node.running
    talker.publish(String(data=ARM3))
    observer.diagnostics(lambda values, status: not error(values, status), "no error")
    observer.publish(MESSAGES[:800], KINDS)
    array = stage.fed({"joint_states": 410, "/wrench": 410})
    status = array.status[0]
    assert status.level != DiagnosticStatus.ERROR
    assert "no robot description" not in status.message, "what was dropped before does not count any more"
    assert observer.trigger("/geomid/save")[0]


def test_a_description_that_was_there_before(stage: Stage) -> None:
    """As a robot_state_publisher keeps it."""
    talker = stage.observer.node.create_publisher(String, "/robot_description", latched(1))
    talker.publish(String(data=ARM3))
    stage.node()
    stage.observer.diagnostics(lambda _, status: status.message == "no messages on /joint_states", "a robot")


def test_a_changed_description_waits_for_a_reset(stage: Stage) -> None:
    node = stage.node({**NO_CHOICE, "solve_period": 0.5})
    observer = stage.observer
    joints = {"/joint_states": KINDS["/joint_states"]}
    inertias = observer.collect(InertiaStamped, "/geomid/inertias", latched())
    talker = observer.node.create_publisher(String, "/robot_description", latched(1))
    talker.publish(String(data=ARM3))
    observer.diagnostics(lambda _, status: "no messages on" in status.message, "a robot")
    changed = ARM3.replace('link="link1"', 'link="trunk"').replace('name="link1"', 'name="trunk"')

    def links() -> set[str]:
        return {message.header.frame_id for message in inertias if message.inertia.m}

    talker.publish(String(data=changed))
    array = observer.diagnostics(error, "an error")
    assert array.status[0].message.startswith("the robot description has changed; it is used after ~/reset")
    observer.publish(MESSAGES[:800], joints)
    observer.wait_for(lambda: links() == {"link1", "link2", "link3"}, "the old robot's links")
    talker.publish(String(data=ARM3))
    observer.diagnostics(lambda values, status: not error(values, status), "no error: it is the old one again")
    assert node.output.count("the robot description has changed") == 1
    talker.publish(String(data=IMPOSSIBLE))
    array = observer.diagnostics(error, "an error")
    assert "link 'link2' has a mass of -1.7 kg" in array.status[0].message
    success, reason = observer.trigger("/geomid/reset")
    assert not success
    assert "link 'link2' has a mass of -1.7 kg" in reason
    assert node.running
    talker.publish(String(data=changed))
    observer.spin(0.5)
    assert observer.trigger("/geomid/reset")[0]
    inertias.clear()
    observer.publish(MESSAGES[800:], joints)
    late = observer.collect(InertiaStamped, "/geomid/inertias", latched())
    observer.wait_for(lambda: links() == {"trunk", "link2", "link3"}, "the new robot's links")
    observer.wait_for(lambda: "trunk" in {message.header.frame_id for message in late}, "links for who comes late")
    assert {message.header.frame_id: message.inertia.m for message in late}["link1"] == 0.0, "it is gone"
    assert node.end() == 0
    assert list(stage.folder.glob("process0/*")) == [], "without a folder nothing is written unasked"
