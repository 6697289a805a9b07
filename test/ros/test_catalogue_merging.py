"""Left and right arm in messages of their own, from publishers of their own, on one topic."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import rclpy
from files.recordings import TYPES, Recorded
from sensor_msgs.msg import JointState

from .direct import Direct
from .observer import MATCHING, plenty
from .rig import AFTER, BEFORE, rigged


def part(item: Recorded, places: slice) -> Recorded:
    """A joint message with some of its joints."""
    numbers = {key: getattr(item.message, key)[places] for key in ("position", "velocity", "effort")}
    return item.changed(name=item.message.name[places], **numbers)


def test_16_two_arms_are_put_together(tmp_path: Path) -> None:
    """As if one had sent all joints: the twin is fed whole messages."""
    with rigged(tmp_path, merge_joint_states=True) as rig:
        node = rclpy.create_node("right_arm", context=rig.stage.observer.node.context)
        right = node.create_publisher(JointState, "/joint_states", plenty())
        rig.stage.observer.wait_for(right.get_subscription_count, "the node")
        rig.stage.observer.spin(MATCHING)
        for item in BEFORE + AFTER:
            if item.topic == "/joint_states":
                rig.send([part(item, slice(0, 2))])
                other = part(item, slice(2, None))
                right.publish(bytes(TYPES.serialize_cdr(other.message, other.kind)))
                rig.sent["/joint_states"] += 1
            else:
                rig.send([item])
        rig.twin.feed(BEFORE + AFTER)
        values = rig.settled()
        assert values["joint_states accepted"] == values["joint_states received"]
        assert "publishers" not in rig.stream(rig.arrays[-1]).message
        rig.assert_same_as_twin()
        node.destroy_node()


def test_88_a_slow_gripper_does_not_slow_down_the_arm() -> None:
    """The last joint comes twice per second: the others' rows are those at the arm's rate, and it is told."""
    sent = []
    for place, item in enumerate(item for item in BEFORE + AFTER):
        if item.topic == "/joint_states":
            sent += [part(item, slice(0, -1))] + ([part(item, slice(-1, None))] if place % 100 < 2 else [])
        else:
            sent.append(item)
    with closing(Direct(merge_joint_states=True)) as direct:
        direct.send(sent)
        direct.twin.feed(sent)
        values = direct.settled()
        assert values["joint_states accepted"] == values["joint_states received"]
        direct.says(0, None, "messages per second of")
        direct.assert_same_as_twin()
        assert len(direct.twin.session.pipeline.unmeasured) == 1
