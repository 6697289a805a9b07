"""Bags that cannot be read are refused with the file's name and what would help; the others are read as they are."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.bags.storage import RawMessage
from geomid_ros.signals.settings import MOST_WAITING

from .recordings import BAGS, altered, recorded, write_bag


def test_topics_and_counts() -> None:
    with Bag(BAGS / "arm3") as bag:
        assert bag.topics == {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/robot_description": "std_msgs/msg/String",
            "/wrench": "geometry_msgs/msg/WrenchStamped",
        }
        assert bag.count(["/joint_states", "/wrench"]) == 1600
        assert bag.start == 1_700_000_000_000_000_000
        assert sum(1 for _ in bag.raw_messages(["/wrench"])) == 800
        assert list(bag.messages([])) == []
        for name in ("joint_states", "/joint_states"):
            assert bag.find_topic(name, "sensor_msgs/msg/JointState", "--joint-topic") == "/joint_states"


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        ("joints", r"arm3.*/joints.*--joint-topic.*/joint_states \(sensor_msgs/msg/JointState\).*/wrench"),
        ("wrench", r"/wrench is of type .*Wrench.* not read; expected .*JointState. Convert it .*\(--joint-topic\)"),
    ],
)
def test_a_topic_that_cannot_be_read_is_answered_with_what_would_help(topic: str, said: str) -> None:
    with Bag(BAGS / "arm3") as bag, pytest.raises(InputError, match=said):
        bag.find_topic(topic, "sensor_msgs/msg/JointState", "--joint-topic")


def test_a_message_that_is_not_of_its_type_is_named(tmp_path: Path) -> None:
    strings = [item for item in recorded(BAGS / "arm3") if item.topic == "/robot_description"]
    bag = write_bag(tmp_path / "bag", strings, StoragePlugin.SQLITE3)
    for path in (bag / "metadata.yaml", bag / "bag.db3"):
        # Types of the same length, so that the database stays whole.
        path.write_bytes(path.read_bytes().replace(b"std_msgs/msg/String", b"std_msgs/msg/Header"))
    said = r"message on /robot_description at \d+ ns is not a valid std_msgs/msg/Header"
    with Bag(bag) as opened, pytest.raises(InputError, match=said):
        list(opened.messages([*opened.topics]))


def test_types_that_are_not_built_in_cost_only_their_topic(tmp_path: Path) -> None:
    """What a bag says of its own types is never looked at; other topics can be read."""
    bag = altered(BAGS / "arm3", tmp_path / "bag", lambda item: item)
    metadata = bag / "metadata.yaml"
    for path in (metadata, bag / "bag.mcap"):
        path.write_bytes(path.read_bytes().replace(b"std_msgs/msg/String", b"std_msgs/msg/Strink"))
    with Bag(bag) as opened:
        assert sum(1 for _ in opened.messages(["/wrench"])) == 800
        with pytest.raises(InputError, match="/robot_description"):
            list(opened.messages(["/robot_description"]))


def test_batches_are_no_longer_than_streams_wait_for_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """However small the messages are: of one topic no more come at once than are kept until those of another."""
    many = [RawMessage(topic, time, "std_msgs/msg/Empty", b"") for time in range(20_000) for topic in ("/a", "/b")]
    monkeypatch.setattr(Bag, "raw_messages", lambda *_: iter(many))
    with Bag(BAGS / "arm3") as bag:
        batches = list(bag.batches(["/a", "/b"]))
    assert [message for batch in batches for message in batch] == many
    assert max(map(len, batches)) < MOST_WAITING
