"""The relay: trajectories go on to the controller with efforts, or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from excitation.motions import lively
from files.recordings import BAGS
from geometry_msgs.msg import InertiaStamped
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

import geomid_ros
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.ros.controller import message_of
from geomid_ros.ros.outputs import inertia_message

from .observer import MATCHING, latched
from .processes import Process
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


def published(model: Path) -> dict[str, Any]:
    """A saved model as the node publishes it."""
    return {**json.loads(model.read_text()), "robot_description": model.with_name("identified.urdf").read_text()}


def relaying(stage: Stage, **parameters: Any) -> tuple[Process, Publisher, Publisher, list[Any]]:
    """A relay that waits for estimates; who publishes trajectories and estimates; what the controller hears."""
    relay, observer = stage.node(parameters, module="geomid_ros.ros.feedforward", ready=False), stage.observer
    sent = observer.node.create_publisher(JointTrajectory, "/geomid_feedforward/joint_trajectory", 10)
    estimates = observer.node.create_publisher(String, "/geomid/estimate", latched(1))
    heard = observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    observer.wait_for(lambda: sent.get_subscription_count() and estimates.get_subscription_count(), "the relay")
    observer.spin(MATCHING)
    return relay, sent, estimates, heard


def test_what_the_node_says_is_carried_is_part_of_the_efforts_until_it_is_put_down(stage: Stage, model: Path) -> None:
    """Compared with pinocchio; a message without finite numbers says nothing."""
    relay, sent, estimates, heard = relaying(stage)
    loads = stage.observer.node.create_publisher(InertiaStamped, "/geomid/payload/inertia", latched(1))
    stage.observer.wait_for(lambda: loads.get_subscription_count() > 0, "the relay")
    body = pin.Inertia(1.5, np.array([0.01, -0.02, 0.1]), np.diag([0.004, 0.005, 0.003]))
    estimates.publish(String(data=json.dumps(published(model))))
    carried = inertia_message("link3", body.toDynamicParameters(), 1)
    efforts = []
    for mass in (0.0, 1.5, np.nan, 1.5, 0.0):
        carried.inertia.m = mass
        loads.publish(carried)
        stage.observer.spin(MATCHING)
        sent.publish(message_of(motion()))
        stage.observer.wait_for(lambda: len(heard) > len(efforts), "a trajectory")
        at = {f"{p.time_from_start.sec}.{p.time_from_start.nanosec:09d}": p for p in heard[-1].points}
        efforts.append(at)
    loaded = pin.buildModelFromUrdf(str(BAGS / "arm3.urdf"))
    for index in range(1, loaded.njoints):
        loaded.inertias[index] = pin.Inertia.Zero()
    loaded.inertias[loaded.njoints - 1] = body
    data = loaded.createData()
    common = sorted(set.intersection(*map(set, efforts)))
    assert len(common) >= 40
    for place in common:
        empty, full, unknown, again, last = (at[place] for at in efforts)
        added = pin.rnea(loaded, data, *map(np.array, (full.positions, full.velocities, full.accelerations)))
        for with_load in (full, again):
            # The gain of each joint's drive, which is near 1, belongs to the model.
            np.testing.assert_allclose(np.array(with_load.effort) - empty.effort, added, rtol=0.01, atol=1e-6)
        for without in (unknown, last):
            np.testing.assert_allclose(without.effort, empty.effort, atol=1e-9)
    carried.inertia.m, carried.header.frame_id = 1.5, "elsewhere"
    loads.publish(carried)
    stage.observer.spin(MATCHING)
    sent.publish(message_of(motion()))
    stage.observer.wait_for(lambda: "no link 'elsewhere', which carries a payload" in relay.output, "a refusal")
