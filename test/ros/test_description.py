"""The robot description: from the topic or the parameter, late, unreadable, changed."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rclpy.publisher import Publisher
from std_msgs.msg import String

from .observer import latched
from .stage import KINDS, NO_CHOICE, Stage, description, messages, staged

ARM3 = description("arm3")
IMPOSSIBLE = ARM3.replace('<mass value="1.7"/>', '<mass value="-1.7"/>')
MESSAGES, JOINTS = messages(), {"/joint_states": KINDS["/joint_states"]}


def error(_: dict[str, str], status: Any) -> bool:
    return bool(status.level == DiagnosticStatus.ERROR)


class Described:
    """A node, and who publishes the description of its robot."""

    def __init__(self, stage: Stage) -> None:
        self.stage, self.observer = stage, stage.observer
        self.node = stage.node({**NO_CHOICE, "solve_period": 0.5})
        self.inertias = self.observer.collect(InertiaStamped, "/geomid/inertias", latched())

    def say(self, text: str) -> None:
        self._talker.publish(String(data=text))

    @cached_property
    def _talker(self) -> Publisher:
        return self.observer.node.create_publisher(String, "/robot_description", latched(1))

    @property
    def links(self) -> set[str]:
        return {message.header.frame_id for message in self.inertias if message.inertia.m}


@pytest.fixture(scope="module")
def described(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Described]:
    with staged(tmp_path_factory.mktemp("described")) as stage:
        yield Described(stage)


def test_a_late_and_at_first_unreadable_description(described: Described) -> None:
    observer = described.observer
    observer.publish(MESSAGES[:20], JOINTS)
    dropped = {"joint_states dropped: no robot description yet": "10"}
    array = observer.diagnostics(lambda values, _: dropped.items() <= values.items(), "dropped messages")
    told = "no robot description yet on /robot_description"
    assert (array.status[0].level, array.status[0].message) == (DiagnosticStatus.WARN, told)
    for text, reason in (("no URDF", "its XML cannot be read"), (IMPOSSIBLE, "link 'link2' has a mass of -1.7 kg")):
        described.say(text)
        array = observer.diagnostics(lambda _, status, reason=reason: reason in status.message, reason)
        assert array.status[0].level == DiagnosticStatus.ERROR
        assert "topic robot_description: " in array.status[0].message
        assert described.node.running
    described.say(ARM3)
    observer.diagnostics(lambda values, status: not error(values, status), "no error")
    observer.publish(MESSAGES[:800], JOINTS)
    array = observer.diagnostics(lambda values, _: int(values["rows"]) > 0, "rows")
    assert array.status[0].level != DiagnosticStatus.ERROR
    assert "no robot description" not in array.status[0].message, "what was dropped before does not count any more"


def test_a_changed_description_waits_for_a_reset(described: Described) -> None:
    observer, node = described.observer, described.node
    described.say(ARM3)
    observer.diagnostics(lambda _, status: "no messages on" in status.message, "a robot")
    changed = ARM3.replace('link="link1"', 'link="trunk"').replace('name="link1"', 'name="trunk"')
    described.say(changed)
    array = observer.diagnostics(error, "an error")
    assert array.status[0].message.startswith("the robot description has changed; it is used after ~/reset")
    described.inertias.clear()
    observer.publish(MESSAGES[800:], JOINTS)
    observer.wait_for(lambda: described.links == {"link1", "link2", "link3"}, "the old robot's links")
    described.say(ARM3)
    observer.diagnostics(lambda values, status: not error(values, status), "no error: it is the old one again")
    assert node.output.count("the robot description has changed") == 1
    described.say(IMPOSSIBLE)
    array = observer.diagnostics(error, "an error")
    assert "link 'link2' has a mass of -1.7 kg" in array.status[0].message
    success, reason = observer.trigger("/geomid/reset")
    assert not success
    assert "link 'link2' has a mass of -1.7 kg" in reason
    assert node.running
    described.say(changed)
    observer.spin(0.5)
    assert observer.trigger("/geomid/reset")[0]
    described.inertias.clear()
    observer.publish(MESSAGES[:800], JOINTS)
    late = observer.collect(InertiaStamped, "/geomid/inertias", latched())
    observer.wait_for(lambda: described.links == {"trunk", "link2", "link3"}, "the new robot's links")
    observer.wait_for(lambda: "trunk" in {message.header.frame_id for message in late}, "links for who comes late")
    assert {message.header.frame_id: message.inertia.m for message in late}["link1"] == 0.0, "it is gone"
    assert node.end() == 0
    assert list(described.stage.folder.glob("process0/*")) == [], "without a folder nothing is written unasked"
