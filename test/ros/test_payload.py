"""The node weighs what its robot has taken up, as ``geomid payload`` does, and notices it by itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands.running import done
from diagnostic_msgs.msg import DiagnosticArray
from files.recordings import BAGS, QUICK, Recorded, recorded
from geometry_msgs.msg import InertiaStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from geomid_ros.simulation import SimulationOptions, simulate
from geomid_ros.simulation.options import Hidden

from .observer import latched
from .spoiling import later
from .stage import NO_CHOICE, Stage, description, staged

MASS = 0.8  # [kg] of the payload
KINDS = {"/joint_states": JointState}
HOUR, MINUTE = 3_600_000_000_000, 60_000_000_000  # [ns]


@pytest.fixture(scope="session")
def bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two motions of the same small arm, the second with the payload."""
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("payload")
    for name, motion, *hide in (("empty", 1), ("loaded", 2, Hidden("payload", "tool", MASS))):
        options = {"motion_seed": motion, "duration": 20.0, "longest_step": QUICK, "hide": tuple(hide)}
        simulate(folder / name, SimulationOptions(robot="arm3", seed=5, **options))
    return folder / "empty", folder / "loaded"


def joint_states(bag: Path) -> list[Recorded]:
    return [item for item in recorded(bag) if item.topic == "/joint_states"]


def feed(stage: Stage, items: list[Recorded], count: int) -> None:
    stage.observer.publish(items, KINDS)
    stage.fed({"joint_states": count})


def test_a_payload_is_weighed_live(bags: tuple[Path, Path], tmp_path: Path) -> None:
    empty, loaded = map(joint_states, bags)
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


def test_a_payload_is_picked_up_and_put_down(bags: tuple[Path, Path], tmp_path: Path) -> None:
    """The node notices it by itself."""
    bare, loaded = map(joint_states, bags)
    with staged(tmp_path) as stage:
        node = stage.node({"robot_description": description("arm3"), **NO_CHOICE})
        carried = stage.observer.collect(InertiaStamped, "/geomid/payload/inertia", latched())
        said = stage.observer.collect(DiagnosticArray, "/diagnostics", 10)
        count = 0
        for turn, part in enumerate((bare, bare, loaded, bare)):
            count += len(part)
            feed(stage, [later(item, turn * MINUTE) for item in part], count)
            if part is loaded:
                stage.observer.wait_for(lambda: carried, "a payload")
                stage.observer.wait_for(lambda: _sentences(said), "a sentence on it")
        stage.observer.wait_for(lambda: carried[-1].inertia.m == 0.0, "that it was put down")
        assert node.end() == 0
    *bodies, _ = carried
    assert {message.header.frame_id for message in carried} == {"link3"}
    assert bodies[-1].inertia.m == pytest.approx(MASS, rel=0.05)
    assert "kg (95 %), at 'link3' since" in _sentences(said)[-1]


def _sentences(said: list[DiagnosticArray]) -> list[str]:
    return [status.message for array in said for status in array.status if status.name == "geomid: payload"]
