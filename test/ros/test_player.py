"""``geomid play``."""

from __future__ import annotations

from pathlib import Path

import pytest
from files.recordings import BAGS, recorded, write_bag
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from geomid_ros.ros.player import _message_class

from .observer import latched
from .stage import Stage


def test_it_publishes_what_was_recorded_in_its_order(stage: Stage, tmp_path: Path) -> None:
    """Stamps as they were, nothing lost to who was there; a topic of a type that is not installed is left out."""
    items = [item for item in recorded(BAGS / "arm3")[:401] if item.topic != "/wrench"]
    bag = write_bag(tmp_path / "bag", items)
    for path in (bag / "metadata.yaml", bag / "bag.mcap"):
        path.write_bytes(path.read_bytes().replace(b"std_msgs/msg/String", b"vendor_m/msg/Secret"))
    heard = stage.observer.collect(JointState, "/joint_states")
    player = stage.play(bag, 8.0)
    stage.spin_while(player)
    assert "/robot_description is left out: its type vendor_m/msg/Secret is not installed here" in player.output
    assert f"Published all messages of {bag}" in player.output
    expected = [item.message for item in items if item.topic == "/joint_states"]
    assert len(heard) == len(expected) == 200
    for ours, theirs in zip(heard, expected, strict=True):
        assert ours.header.stamp.sec == theirs.header.stamp.sec
        assert ours.header.stamp.nanosec == theirs.header.stamp.nanosec
        assert list(ours.name) == list(theirs.name)
        assert list(ours.effort) == theirs.effort.tolist()


def test_the_description_is_kept_for_who_comes_late(stage: Stage) -> None:
    heard = stage.observer.collect(JointState, "/joint_states")
    stage.observer.collect(WrenchStamped, "/wrench")
    player = stage.play(BAGS / "arm3", 2.0)
    stage.observer.wait_for(lambda: len(heard) > 50, "joint states")
    descriptions = stage.observer.collect(String, "/robot_description", latched(1))
    stage.observer.wait_for(lambda: descriptions, "the description")
    assert descriptions[0].data == (BAGS / "arm3.urdf").read_text()
    assert player.running


def test_a_bag_cannot_have_just_anything_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To import a module is to run it, and a bag names any it likes as the package of a type."""
    (tmp_path / "tempting.py").write_text("raise SystemExit('this has been run')")
    (tmp_path / "tempting_package").mkdir()
    (tmp_path / "tempting_package" / "__init__.py").write_text("raise SystemExit('this has been run')")
    monkeypatch.syspath_prepend(tmp_path)
    for kind in ("tempting/msg/X", "tempting_package/msg/X", "tempting_package.more/msg/X", "/msg/", "", None):
        assert _message_class(kind) is None
    assert _message_class("sensor_msgs/msg/JointState") is JointState
