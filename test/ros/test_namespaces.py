"""Two robots on one network."""

from __future__ import annotations

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped
from std_msgs.msg import String

from .observer import latched
from .stage import KINDS, NO_CHOICE, Stage, description, messages

MESSAGES = messages()[:800]


def test_two_nodes_side_by_side(stage: Stage) -> None:
    """Each in its namespace, with its robot and its data; names of diagnostics tell them apart."""
    observer = stage.observer
    stage.node(
        {**NO_CHOICE, "solve_period": 0.1}, "-r", "__ns:=/left", "-r", "joint_states:=joints", name="left/geomid"
    )
    stage.node({**NO_CHOICE, "solve_period": 0.1}, "-r", "__ns:=/right", "-r", "__node:=finder", name="right/finder")
    for side in ("left", "right"):
        text = description("arm3").replace("link3", f"{side}_link3")
        observer.node.create_publisher(String, f"/{side}/robot_description", latched(1)).publish(String(data=text))
    heard = {
        "left": observer.collect(InertiaStamped, "/left/geomid/inertias", latched()),
        "right": observer.collect(InertiaStamped, "/right/finder/inertias", latched()),
    }
    arrays = observer.collect(DiagnosticArray, "/diagnostics")
    observer.diagnostics(lambda _, status: "no messages on" in status.message, "left", "left/geomid")
    observer.diagnostics(lambda _, status: "no messages on" in status.message, "right", "right/finder")
    joints = {"/joint_states": KINDS["/joint_states"]}
    observer.publish(MESSAGES, joints, "/right")
    stage.fed({"joint_states": 400}, "right/finder")
    observer.wait_for(lambda: len(heard["right"]) >= 3, "the right robot's inertias")
    assert heard["left"] == []
    renamed = [replace(item, topic="/joints") for item in MESSAGES if item.topic in joints]
    observer.publish(renamed, {"/joints": KINDS["/joint_states"]}, "/left")
    stage.fed({"joint_states": 400}, "left/geomid")
    observer.wait_for(lambda: len(heard["left"]) >= 3, "the left robot's inertias")
    for side, messages_of_side in heard.items():
        names = {message.header.frame_id for message in messages_of_side}
        assert names == {"link1", "link2", f"{side}_link3"}
    stage.observer.spin(1.5)
    names = {status.name for array in arrays for status in array.status}
    assert names >= {f"{node}: {part}" for node in ("left/geomid", "right/finder") for part in ("stream", "link1")}
    assert names >= {"left/geomid: left_link3", "right/finder: right_link3"}
