"""``geomid play``."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path

import pytest
from files.recordings import BAGS, Recorded, made, recorded, write_bag
from geometry_msgs.msg import Twist, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from geomid_ros.ros.player import _message_class

from .observer import latched
from .processes import parameter_file
from .stage import WRIST, Stage


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
    assert f"Published 200 messages of {bag}" in player.output
    expected = [item.message for item in items if item.topic == "/joint_states"]
    assert len(heard) == len(expected) == 200
    for ours, theirs in zip(heard, expected, strict=True):
        assert ours.header.stamp.sec == theirs.header.stamp.sec
        assert ours.header.stamp.nanosec == theirs.header.stamp.nanosec
        assert list(ours.name) == list(theirs.name)
        assert list(ours.effort) == theirs.effort.tolist()


def with_commands(folder: Path) -> tuple[Path, int]:
    """A second of the small arm with commands beside it, and the number of its joint messages."""
    items = [item for item in recorded(BAGS / "arm3")[:301] if item.kind != "std_msgs/msg/String"]
    states = [item for item in items if item.topic == "/joint_states"]
    twist = made("geometry_msgs/msg/Twist")
    items += [replace(item, topic="/joint_commands") for item in states]
    items += [replace(item, topic="/cell/joint_states") for item in states]
    items += [replace(item, topic="/my_joint_states") for item in states]
    items += [Recorded("/cmd_vel", "geometry_msgs/msg/Twist", item.time, twist) for item in states]
    return write_bag(folder, sorted(items, key=lambda item: item.time)), len(states)


def test_nothing_that_a_robot_would_follow_is_published_unless_named(stage: Stage, tmp_path: Path) -> None:
    """Only what geomid reads: by default, and with what is named or declared as a wrench sensor."""
    bag, count = with_commands(tmp_path / "bag")
    topics = ("/joint_states", "/cell/joint_states", "/my_joint_states", "/joint_commands")
    heard = {topic: stage.observer.collect(JointState, topic) for topic in topics}
    heard |= {"/cmd_vel": stage.observer.collect(Twist, "/cmd_vel")}
    heard |= {"/wrench": stage.observer.collect(WrenchStamped, "/wrench")}

    def played(*arguments: str | Path) -> tuple[set[str], str]:
        for messages in heard.values():
            messages.clear()
        player = stage.play(bag, 8.0, *arguments)
        stage.spin_while(player)
        assert {len(messages) for messages in heard.values() if messages} == {count}
        (line,) = [line for line in player.output.splitlines() if line.startswith("Not published")]
        assert set(line.partition("): ")[2].split(", ")) == {topic for topic in heard if not heard[topic]}
        return {topic for topic in heard if heard[topic]}, player.output

    read = {"/joint_states", "/cell/joint_states"}
    assert played()[0] == read
    config = parameter_file(tmp_path, WRIST)
    assert played("--config", config, "--topic", "/cmd_vel")[0] == {*read, "/wrench", "/cmd_vel"}
    refused = stage.play(bag, 8.0, "--topic", "cmd_velo")
    assert refused.status() == 2
    assert "Did you mean '/cmd_vel'?" in refused.output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_player_that_is_told_to_end(number: signal.Signals, stage: Stage) -> None:
    """While it waits for subscribers, or while it plays; the status says that not all was published."""
    player = stage.play(BAGS / "arm3", 0.1, fresh=number == signal.SIGINT)
    if number == signal.SIGINT:
        heard = stage.observer.collect(JointState, "/joint_states")
        stage.observer.wait_for(lambda: len(heard) > 10, "messages")
        descriptions = stage.observer.collect(String, "/robot_description", latched(1))
        stage.observer.wait_for(lambda: descriptions, "the description, which is kept for who comes late")
        assert descriptions[0].data == (BAGS / "arm3.urdf").read_text()
        stage.observer.spin(0.5)
        assert len(heard) < 400, "ten in a second, not all at once"
    else:
        topics = stage.observer.node.get_topic_names_and_types
        stage.observer.wait_for(lambda: "/joint_states" in dict(topics()), "a player")
    player.send(number)
    assert player.status() == 130
    assert "Interrupted." in player.output


def test_a_bag_cannot_have_just_anything_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To import a module is to run it, and a bag names any it likes as the package of a type."""
    (tmp_path / "tempting.py").write_text("raise SystemExit('this has been run')")
    (tmp_path / "tempting_package").mkdir()
    (tmp_path / "tempting_package" / "__init__.py").write_text("raise SystemExit('this has been run')")
    monkeypatch.syspath_prepend(tmp_path)
    for kind in ("tempting/msg/X", "tempting_package/msg/X", "tempting_package.more/msg/X", "/msg/", "", None):
        assert _message_class(kind) is None
    assert _message_class("sensor_msgs/msg/JointState") is JointState
