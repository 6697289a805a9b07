"""The node weighs what its robot has taken up, and notices it by itself."""

from __future__ import annotations

import json

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from files.recordings import Recorded
from geometry_msgs.msg import InertiaStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from geomid_ros.geometry import pseudo_inertia

from .in_motion import InMotion, noisy
from .observer import latched
from .spoiling import later
from .stage import NO_CHOICE, Stage, description

MASS, NOISE = 0.8, 0.05  # [kg] of the payload, [N m]
PAYLOAD = pseudo_inertia.parameters_of(np.array([MASS, 0.02, -0.01, 0.1, 2e-3, 0.0, 2e-3, 0.0, 0.0, 1e-3]))
KINDS = {"/joint_states": JointState}
SECONDS, MINUTE = 15, 60_000_000_000  # of a motion; [ns]
RATE = 50.0  # [Hz]: every message takes a millisecond of the processor


def motion(seed: int, *, loaded: bool = False) -> list[Recorded]:
    """Joint messages of the small arm in a motion of its own."""
    arm = InMotion(description("arm3"), duration=SECONDS, rate=RATE, seed=seed, swing=0.8, error=0.0)
    if loaded:
        arm.reference.set_inertias({**arm.truth, "link3": arm.truth["link3"] + PAYLOAD})
    return arm.joint_states(noisy(arm.efforts(friction=False), NOISE, seed))


def test_a_payload_is_noticed_weighed_and_missed(stage: Stage) -> None:
    """It is weighed when that is asked for; the node notices by itself that it is taken up and put down."""
    bare, loaded = motion(1), motion(2, loaded=True)
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
