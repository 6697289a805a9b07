"""The relay: trajectories go on to the controller with efforts, or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from excitation.motions import lively
from files.recordings import BAGS
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

import geomid_ros
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.ros.controller import message_of

from .observer import MATCHING, latched
from .stage import Stage

JOINTS = ("joint1", "joint2", "joint3")
OUT = "/left/joint_trajectory_controller/joint_trajectory"


@pytest.fixture(scope="module")
def identified() -> geomid_ros.Identification:
    return geomid_ros.identify(BAGS / "arm3", BAGS / "arm3.urdf", candidates=[])


@pytest.fixture
def model(identified: geomid_ros.Identification, tmp_path: Path) -> Path:
    return identified.save(tmp_path / "model", report=False)[0]


def motion(joints: tuple[str, ...] = JOINTS, duration: float = 4.0) -> Trajectory:
    times = np.linspace(0.0, duration, 40)
    return Trajectory(joints, times, *(lively(joints, duration, 0.4).rows(times, order) for order in range(3)))


def test_trajectories_go_on_with_efforts_or_not_at_all(stage: Stage, model: Path) -> None:
    """One of another robot, one that is too fast and one that no controller would hear are said, and the next one goes
    on, to the controller of the same namespace; a model that has changed counts from then on."""
    observer = stage.observer
    parameters = {"model": str(model), "heaviest_payload": 2}
    relay = stage.node(parameters, "-r", "__ns:=/left", module="geomid_ros.ros.feedforward", ready=False)
    sent = observer.node.create_publisher(JointTrajectory, "/left/geomid_feedforward/joint_trajectory", 10)
    observer.wait_for(lambda: sent.get_subscription_count() > 0, "the relay")
    for refused in (motion(("a", "b", "c")), motion(duration=0.05), motion()):
        sent.publish(message_of(refused))
    observer.wait_for(lambda: f"nothing subscribes to {OUT}" in relay.output, "a refusal")
    assert "sent on with efforts" not in relay.output
    heard = observer.collect(JointTrajectory, OUT)
    observer.spin(MATCHING)
    request = SetParameters.Request(parameters=[RosParameter("tolerance", value=0.1).to_parameter_msg()])
    (answer,) = observer.call(SetParameters, "/left/geomid_feedforward/set_parameters", request).results
    assert "read-only" in answer.reason
    message = message_of(motion())
    message.header.frame_id = "kept"
    sent.publish(message)
    observer.wait_for(lambda: len(heard) == 1, "a trajectory with efforts")
    expected = geomid_ros.feedforward(motion(), model).trajectory
    assert heard[0].header.frame_id == "kept"
    np.testing.assert_allclose([point.effort for point in heard[0].points], expected.efforts, atol=1e-6)
    assert "unknown joint 'a'" in relay.output
    assert "more than its limit" in relay.output
    document = json.loads(model.read_text())
    for effect in document["effects"]:
        effect["value"] *= 2.0 if effect["name"] == "viscous_friction" else 1.0
    model.write_text(json.dumps(document))
    sent.publish(message)
    observer.wait_for(lambda: len(heard) == 2, "a trajectory with other efforts")
    assert not np.allclose(heard[1].points[10].effort, heard[0].points[10].effort)
    document["verdict"]["result"] = "doubtful"
    model.write_text(json.dumps(document))
    sent.publish(message)
    observer.wait_for(lambda: "verdict is 'doubtful'" in relay.output, "a refusal")
    sent.publish(JointTrajectory(joint_names=list(JOINTS)))  # which tells a controller to stop
    observer.wait_for(lambda: len(heard) == 3, "an order to stop")


def test_the_last_usable_estimate_of_the_node_gives_the_efforts(stage: Stage, model: Path) -> None:
    """Before the first one nothing goes on; a doubtful one, and what is no estimate, leave the one before."""
    observer, saved = stage.observer, json.loads(model.read_text())
    saved["robot_description"] = model.with_name("identified.urdf").read_text()
    doubtful = saved | {"verdict": {"result": "doubtful", "reasons": ["something is wrong"]}}
    relay = stage.node({"heaviest_payload": 2.0}, module="geomid_ros.ros.feedforward", ready=False)
    sent = observer.node.create_publisher(JointTrajectory, "/geomid_feedforward/joint_trajectory", 10)
    estimates = observer.node.create_publisher(String, "/geomid/estimate", latched(1))
    heard = observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    observer.wait_for(lambda: sent.get_subscription_count() and estimates.get_subscription_count(), "the relay")
    observer.spin(MATCHING)

    def answered(text: str) -> bool:
        """Whether the relay says so of an estimate, or of a trajectory that is sent until it does."""
        sent.publish(message_of(motion()))
        observer.spin(0.2)
        return text in relay.output

    observer.wait_for(lambda: answered("not sent on: no estimate on /geomid/estimate yet"), "a refusal")
    estimates.publish(String(data=json.dumps(doubtful)))
    observer.wait_for(lambda: answered("/geomid/estimate: this model's verdict is 'doubtful'"), "another refusal")
    assert not heard
    assert "adapts to a payload" not in relay.output
    estimates.publish(String(data=json.dumps(saved)))
    observer.wait_for(lambda: "adapts to a payload" in relay.output, "the adaptation, before any trajectory")
    observer.wait_for(lambda: answered("efforts are those of /geomid/estimate") and heard, "a trajectory with efforts")
    expected = geomid_ros.feedforward(motion(), model).trajectory
    np.testing.assert_allclose([point.effort for point in heard[-1].points], expected.efforts, atol=1e-6)
    for text in (json.dumps(doubtful), "[]"):
        estimates.publish(String(data=text))
    observer.wait_for(
        lambda: answered("something is wrong; to move") and "last usable estimate stays" in relay.output, "it"
    )
    count = len(heard)
    observer.wait_for(lambda: answered("") and len(heard) > count + 1, "trajectories as before")
    np.testing.assert_allclose([point.effort for point in heard[-1].points], expected.efforts, atol=1e-6)
    assert relay.output.count("last usable estimate stays") == 1


def test_a_robot_that_cannot_adapt_has_its_trajectories_filled(stage: Stage, model: Path) -> None:
    """The estimate that comes has no such link: the relay says so, and lives on."""
    observer, saved = stage.observer, json.loads(model.read_text())
    saved["robot_description"] = model.with_name("identified.urdf").read_text()
    parameters = {"heaviest_payload": 2.0, "link": "elsewhere"}
    relay = stage.node(parameters, module="geomid_ros.ros.feedforward", ready=False)
    sent = observer.node.create_publisher(JointTrajectory, "/geomid_feedforward/joint_trajectory", 10)
    estimates = observer.node.create_publisher(String, "/geomid/estimate", latched(1))
    heard = observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    observer.wait_for(lambda: sent.get_subscription_count() and estimates.get_subscription_count(), "the relay")
    observer.spin(MATCHING)
    estimates.publish(String(data=json.dumps(saved)))
    observer.wait_for(lambda: "the adaptation cannot use the last estimate" in relay.output, "what is wrong")
    assert "'elsewhere'" in relay.output
    sent.publish(message_of(motion()))
    observer.wait_for(lambda: heard, "a trajectory with efforts")
