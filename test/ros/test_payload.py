"""The node weighs what its robot has taken up, and notices it by itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from files.recordings import QUICK, Recorded, recorded
from geometry_msgs.msg import InertiaStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import simulate

from .observer import latched
from .spoiling import later
from .stage import NO_CHOICE, description, staged

MASS = 0.8  # [kg] of the payload
KINDS = {"/joint_states": JointState}
SECONDS, MINUTE = 15, 60_000_000_000  # of a motion; [ns]
RATE = 50.0  # [Hz]: every message takes a millisecond of the processor


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two motions of the same small arm, the second with the payload."""
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("payload")
    for name, motion, *hide in (("empty", 1), ("loaded", 2, Hidden("payload", "tool", MASS))):
        options = {"motion_seed": motion, "duration": SECONDS, "rate": RATE, "longest_step": QUICK, "hide": tuple(hide)}
        simulate(folder / name, SimulationOptions(robot="arm3", seed=5, **options))
    return folder / "empty", folder / "loaded"


def joint_states(bag: Path) -> list[Recorded]:
    return [item for item in recorded(bag) if item.topic == "/joint_states"]


def test_a_payload_is_noticed_weighed_and_missed(bags: tuple[Path, Path], tmp_path: Path) -> None:
    """It is weighed when that is asked for; the node notices by itself that it is taken up and put down."""
    bare, loaded = map(joint_states, bags)
    with staged(tmp_path) as stage:
        node = stage.node({"robot_description": description("arm3"), **NO_CHOICE})
        ask, collect = stage.observer.trigger, stage.observer.collect
        carried = collect(InertiaStamped, "/geomid/payload/inertia", latched())
        weighed = collect(String, "/geomid/payload", latched())
        said = collect(DiagnosticArray, "/diagnostics", 10)

        def feed(turn: int, part: list[Recorded]) -> None:
            stage.observer.publish([later(item, turn * MINUTE) for item in part], KINDS)
            stage.fed({"joint_states": turn * len(bare) + len(part)})

        assert ask("/geomid/payload/empty") == (False, "no data yet")
        for turn in range(2):
            feed(turn, bare)
        success, answer = ask("/geomid/payload/loaded")
        assert (success, answer.startswith("no motion without the payload yet")) == (False, True)
        success, answer = ask("/geomid/payload/empty")
        assert (success, " s without the payload" in answer) == (True, True), answer
        assert ask("/geomid/payload/loaded") == (False, "no data since the motion without the payload")
        feed(2, loaded)
        stage.observer.wait_for(lambda: carried and _sentences(said), "a payload, and a sentence on it")
        success, answer = ask("/geomid/payload/loaded")
        assert success, answer
        stage.observer.wait_for(lambda: weighed, "its mass")
        feed(3, bare)
        stage.observer.wait_for(lambda: carried[-1].inertia.m == 0.0, "that it was put down")
        assert ask("/geomid/reset")[0]
        assert not ask("/geomid/payload/loaded")[0]
        assert node.end() == 0
    live = json.loads(weighed[-1].data)
    assert live["frame"] == "link3"
    assert live["interval"][0] < MASS < live["interval"][1]
    assert live["quantities"]["mass"] == pytest.approx(MASS, rel=0.05)
    *bodies, _ = carried
    assert {message.header.frame_id for message in carried} == {"link3"}
    assert bodies[-1].inertia.m == pytest.approx(MASS, rel=0.05)
    assert "kg (95 %), at 'link3' since" in _sentences(said)[-1]


def _sentences(said: list[DiagnosticArray]) -> list[str]:
    return [status.message for array in said for status in array.status if status.name == "geomid: payload"]
