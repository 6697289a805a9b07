"""Signals: the node ends with the status it should, with results saved and nothing to clean up."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands.running import done, link, read
from files.recordings import BAGS
from geometry_msgs.msg import InertiaStamped
from std_msgs.msg import String

from geomid_ros.commands import live

from .observer import latched
from .processes import SOON
from .rig import rigged
from .stage import NO_CHOICE, WRIST, Stage, description
from .test_catalogue_graph import MALFORMED

ENDS_AT_ONCE = """
import time
from std_msgs.msg import String
from geomid_ros.ros.startup import running_node
with running_node("short") as node:
    publisher = node.create_publisher(String, "/long", 100)
    while not publisher.get_subscription_count():
        time.sleep(0.02)
    for _ in range(20):
        publisher.publish(String(data=" " * 1_000_000))
"""


def test_the_last_messages_of_a_node_that_ends_are_received(stage: Stage) -> None:
    """A robot's last command is to rest."""
    heard = stage.observer.collect(String, "/long")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(stage.domain)}
    with subprocess.Popen([sys.executable, "-c", ENDS_AT_ONCE], env=environment) as process:
        stage.observer.wait_for(lambda: process.poll() is not None, "the end of a process")
    stage.observer.wait_for(lambda: len(heard) == 20, "all messages", patience=20.0)


def test_a_busy_node_saves_its_last_estimate(stage: Stage, tmp_path: Path) -> None:
    """In the middle of everything, and however often it is told."""
    parameters = {**WRIST, **NO_CHOICE, "robot_description": description("arm3"), "solve_period": 0.1}
    out = tmp_path / "out"
    node = stage.node({**parameters, "output_folder": str(out)})
    inertias = stage.observer.collect(InertiaStamped, "/geomid/inertias", latched())
    stage.play(BAGS / "arm3", 2.0, "--topic", "/wrench")
    stage.observer.wait_for(lambda: len(inertias) > 2, "estimates")
    node.send(signal.SIGINT)
    node.send(signal.SIGTERM)
    assert node.seconds_to_end(signal.SIGINT) <= SOON, node.output
    assert node.status() == 0, node.output
    assert json.loads((out / "estimate.json").read_text())["rows"]["accepted"] > 0
    assert (out / "identified.urdf").read_text().startswith("<?xml")
    assert {path.name for path in out.iterdir()} == {"estimate.json", "identified.urdf", "posterior.npz"}


def test_a_node_told_to_end_while_it_starts(stage: Stage) -> None:
    """Whatever it was doing: no traceback, and no core dump."""
    node = stage.node(ready=False, fresh=True)
    stage.observer.wait_for(lambda: node.running, "a process")
    stage.observer.spin(0.6)
    assert node.seconds_to_end(signal.SIGTERM) <= SOON
    assert node.status() in (0, -signal.SIGTERM)


@pytest.mark.usefixtures("found_only")
def test_the_demonstration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the small arm, whose recording is shorter; node and player are processes of their own."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")  # it chooses another one for its processes
    monkeypatch.setenv("PYTHONPATH", str(BAGS.parent))
    monkeypatch.setattr(live, "shared_file", lambda name: BAGS.parent / name.replace("arm7", "arm3"))
    out = tmp_path / "out"
    printed = done("demo", "--rate", "4", "--out", out)
    written = {"estimate.json", "identified.urdf", "posterior.npz", "identification.png"}
    assert {path.name for path in out.iterdir()} == written
    assert all(str(out / name) in printed for name in written)
    truth = {link["name"]: link for link in json.loads((BAGS / "arm3.truth.json").read_text())["links"]}
    assert link(read(out), "wrist_ft")["mass"] == pytest.approx(truth["tool"]["mass"], rel=0.01)
    assert "offline gives the same masses within" in printed


def test_it_finds_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As its twin, which reads messages with rosbags, also where some of the bytes are no messages."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    with rigged(tmp_path, "ros.bare", fresh=True) as rig:
        before, after = rig.begin()
        rig.feed(before)
        begin = len(rig.arrays)
        for data in MALFORMED.values():
            for topic, publisher in rig.publishers.items():
                publisher.publish(data)
                rig.sent[topic] += 1
        rig.feed(after)
        values = rig.settled(begin)
        for topic, kind in (
            ("joint_states", "sensor_msgs/msg/JointState"),
            ("/wrench", "geometry_msgs/msg/WrenchStamped"),
        ):
            refused = [key for key in values if key.startswith(f"{topic} rejected: not a valid {kind}")]
            assert sum(int(values[key]) for key in refused) == len(MALFORMED)
        rig.assert_same_as_twin()
