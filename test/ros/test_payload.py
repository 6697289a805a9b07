"""The node weighs what its robot has taken up, as ``geomid payload`` does from two recordings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands.running import done
from files.recordings import BAGS, QUICK, Recorded, recorded
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from geomid_ros.simulation import SimulationOptions, simulate
from geomid_ros.simulation.options import Hidden

from .observer import latched
from .spoiling import later
from .stage import Stage, description, staged

MASS = 0.8  # [kg] of the payload
KINDS = {"/joint_states": JointState}
HOUR = 3_600_000_000_000  # [ns]


def simulated(bag: Path, motion: int, *hide: Hidden) -> list[Recorded]:
    """Joint messages of the same small arm."""
    simulate(
        bag, SimulationOptions(robot="arm3", seed=5, motion_seed=motion, duration=20.0, longest_step=QUICK, hide=hide)
    )
    return [item for item in recorded(bag) if item.topic == "/joint_states"]


def feed(stage: Stage, items: list[Recorded], count: int) -> None:
    stage.observer.publish(items, KINDS)
    stage.fed({"joint_states": count})


def test_a_payload_is_weighed_live(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    empty = simulated(tmp_path / "empty", 1)
    loaded = simulated(tmp_path / "loaded", 2, Hidden("payload", "tool", MASS))
    bags = [tmp_path / "empty", tmp_path / "loaded"]
    offline = json.loads(done("payload", *bags, "--urdf", BAGS / "arm3.urdf", "--json"))
    config = tmp_path / "payload.yaml"
    config.write_text("geomid: {ros__parameters: {payload: {gain: 0.2, frame: tool}}}", encoding="utf-8")
    unsure = json.loads(done("payload", *bags, "--urdf", BAGS / "arm3.urdf", "--config", config, "--json"))
    assert (unsure["gain"], unsure["frame"], offline["gain"]) == (0.2, "tool", 0.03)
    with staged(tmp_path) as stage:
        node = stage.node({"robot_description": description("arm3")})
        ask = stage.observer.trigger
        assert ask("/geomid/payload/empty") == (False, "no data yet")
        feed(stage, empty, len(empty))
        success, answer = ask("/geomid/payload/loaded")
        assert (success, answer.startswith("no motion without the payload yet")) == (False, True)
        success, answer = ask("/geomid/payload/empty")
        assert success
        assert "20 s without the payload" in answer
        assert ask("/geomid/payload/loaded") == (False, "no data since the motion without the payload")
        feed(stage, [later(item, HOUR) for item in loaded], len(empty) + len(loaded))
        weighed = stage.observer.collect(String, "/geomid/payload", latched())
        success, answer = ask("/geomid/payload/loaded")
        assert success, answer
        stage.observer.wait_for(lambda: weighed, "a payload")
        assert ask("/geomid/reset")[0]
        assert not ask("/geomid/payload/loaded")[0]
        assert node.end() == 0
    live = json.loads(weighed[-1].data)
    assert live.keys() == offline.keys()
    assert live["frame"] == offline["frame"]
    for found in (live, offline):
        assert found["interval"][0] < MASS < found["interval"][1]
        assert found["quantities"]["mass"] == pytest.approx(MASS, rel=0.05)
