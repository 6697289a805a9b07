"""Adaptation in the relay: joint states are answered by corrections, until something goes wrong."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from files.recordings import BAGS
from geometry_msgs.msg import InertiaStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.models.estimate_file import link_entry
from geomid_ros.model.robot import Robot
from geomid_ros.ros.controller import message_of
from geomid_ros.ros.outputs import ros_time
from geomid_ros.types import FloatArray

from .observer import latched
from .stage import Stage, staged

URDF = BAGS / "arm3.urdf"
JOINTS = ["joint1", "joint2", "joint3"]
POSITION = np.array([0.3, 0.5, -0.4])
LOAD = pin.Inertia(0.8, np.array([0.0, 0.0, 0.1]), 1e-3 * np.eye(3))
STEP = 10_000_000  # [ns]
AGAIN = 50  # looks, a second or less


def efforts_at_rest(loaded: bool) -> FloatArray:
    """Of the arm with or without the load on its last link."""
    model = pin.buildModelFromUrdf(str(URDF))
    if loaded:
        model.appendBodyToJoint(model.njoints - 1, LOAD, pin.SE3.Identity())
    places = [model.joints[model.getJointId(joint)].idx_q for joint in JOINTS]
    q = np.zeros(model.nq)
    q[places] = POSITION
    return np.array(pin.computeGeneralizedGravity(model, model.createData(), q))[places]


class Lockstep:
    """Sends the time and joint states, each after the answer to the one before: no test depends on the machine."""

    def __init__(self, stage: Stage) -> None:
        self._observer = stage.observer
        node = self._observer.node
        self._clock = node.create_publisher(Clock, "/clock", 10)
        self._states = node.create_publisher(JointState, "joint_states", 10)
        self.corrections = self._observer.collect(JointState, "/geomid_feedforward/correction")
        self.inertias = self._observer.collect(InertiaStamped, "/geomid_feedforward/inertia")
        self._observer.wait_for(lambda: self._states.get_subscription_count() > 0, "the relay")
        self._observer.wait_for(lambda: node.count_publishers("/geomid_feedforward/correction") > 0, "its corrections")
        self._observer.wait_for(lambda: self._clock.get_subscription_count() > 0, "the relay's clock")
        self._time = 10**9

    def run(self, steps: int, loaded: bool = True) -> FloatArray:
        """Efforts ``(joints,)`` that are added at the end."""
        for _ in range(steps):
            self.tick()
            self.send(self.state(loaded))
        return np.array(self.corrections[-1].effort)

    def settle(self, expected: FloatArray) -> None:
        """Run until these efforts ``(joints,)`` are added; states that the relay misses take longer."""
        bound = 0.03 * np.max(np.abs(expected))
        self._observer.wait_for(
            lambda: bool(np.max(np.abs(self.run(20) - expected)) < bound), "the efforts of the load"
        )

    def state(self, loaded: bool) -> JointState:
        """What the robot measures, by a clock that is a step ahead: the relay's timer may answer before the state does,
        which is a step late then."""
        message = JointState(name=JOINTS, position=POSITION.tolist(), velocity=[0.0] * 3)
        message.effort = efforts_at_rest(loaded).tolist()
        message.header.stamp = ros_time(self._time + STEP)
        return message

    def publish(self, message: JointState) -> None:
        """Send it once."""
        self._states.publish(message)

    def send(self, message: JointState) -> None:
        """Wait for an answer; send again if none comes, since the relay may have missed the first."""
        looks, count = itertools.count(), len(self.corrections)

        def is_answered() -> bool:
            if next(looks) % AGAIN == 0:
                self.publish(message)
            return len(self.corrections) > count

        self._observer.wait_for(is_answered, "an answer")

    def tick(self) -> None:
        """Let time go on."""
        self._time += STEP
        self._clock.publish(Clock(clock=ros_time(self._time)))


class Adapting:
    """A relay with the model of the URDF alone."""

    def __init__(self, stage: Stage) -> None:
        parameters = {"urdf": str(URDF), "heaviest_payload": 2.0, "use_sim_time": True}
        self.relay = stage.node(parameters, module="geomid_ros.ros.feedforward", ready=False)
        self.observer, self.lockstep = stage.observer, Lockstep(stage)
        self.statuses = stage.observer.collect(DiagnosticArray, "/diagnostics")

    def reset(self) -> None:
        assert self.observer.trigger("/geomid_feedforward/reset")[0]


@pytest.fixture(scope="module")
def adapting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Adapting]:
    with staged(tmp_path_factory.mktemp("adapting")) as stage:
        yield Adapting(stage)


def test_a_load_is_found_and_its_efforts_are_added(adapting: Adapting) -> None:
    """Until no joint states come: then it says so, and adds nothing until it is reset."""
    lockstep, expected = adapting.lockstep, efforts_at_rest(loaded=True) - efforts_at_rest(loaded=False)
    assert np.max(np.abs(expected)) > 1.0
    np.testing.assert_allclose(lockstep.run(5, loaded=False), 0.0, atol=1e-6)
    lockstep.settle(expected)
    assert lockstep.inertias[-1].header.frame_id == "link3"
    assert lockstep.inertias[-1].inertia.m > lockstep.inertias[0].inertia.m + 0.2

    def is_off() -> bool:
        lockstep.tick()
        return not any(lockstep.corrections[-1].effort) and "no joint states for" in adapting.relay.output

    adapting.observer.wait_for(is_off, "the end of the correction")
    adapting.observer.wait_for(
        lambda: any(s.status[0].level == DiagnosticStatus.ERROR for s in adapting.statuses), "a diagnosis"
    )
    np.testing.assert_array_equal(lockstep.run(10), 0.0)
    adapting.reset()
    lockstep.settle(expected)


LACKING: dict[str, dict[str, object]] = {
    "they lack efforts": {"effort": []},
    "they lack 'joint3'": {"name": JOINTS[:2], "position": [0.0] * 2, "velocity": [0.0] * 2, "effort": [0.0] * 2},
    "they are not finite": {"position": [np.nan] * 3},
}


def test_joint_states_that_lack_something_are_named_and_not_used(adapting: Adapting) -> None:
    """Later ones that lack nothing are used: corrections are numbers, and change no faster than ever."""
    adapting.reset()
    lockstep, spoiled = adapting.lockstep, []
    for lacking, fields in LACKING.items():
        message = lockstep.state(loaded=True)
        for name, value in fields.items():
            setattr(message, name, value)
        spoiled.append(message)

        def is_named(message: JointState = message, said: str = f"no usable joint states: {lacking}") -> bool:
            lockstep.tick()
            lockstep.publish(message)
            told = (status for array in adapting.statuses for status in array.status)
            return any(status.level == DiagnosticStatus.WARN and status.message == said for status in told)

        adapting.observer.wait_for(is_named, "a warning")
    adapting.reset()  # it may have waited for too long
    assert np.max(np.abs(lockstep.run(60))) > 1.0
    for message in spoiled:
        lockstep.tick()
        lockstep.publish(message)
        lockstep.run(2)
    assert np.isfinite([correction.effort for correction in lockstep.corrections]).all()


def test_it_ends_where_something_else_has_changed_until_that_is_taken_back(adapting: Adapting) -> None:
    adapting.reset()
    lockstep, observer, begin = adapting.lockstep, adapting.observer, len(adapting.relay.output)
    gaps = observer.node.create_publisher(String, "/geomid/gap/open", latched(1))
    observer.wait_for(lambda: gaps.get_subscription_count() > 0, "the relay")

    def is_left_out(times: int) -> bool:
        lockstep.run(1)
        return adapting.relay.output.count("is left out") == times

    for number, text in enumerate(("[", "[]"), 1):
        gaps.publish(String(data=text))
        observer.wait_for(partial(is_left_out, number), "a warning")  # the last message alone waits for the relay
    for channels in ([], [{"channel": "/wrench/fx"}]):
        gaps.publish(String(data=json.dumps({"gaps": channels})))
        lockstep.run(10)
    assert is_left_out(2)
    assert "has changed" not in adapting.relay.output[begin:]
    adapting.reset()  # a busy machine may have been late
    gaps.publish(String(data=json.dumps({"gaps": [{"channel": "/wrench/fx"}, {"channel": "joint2"}]})))
    observer.wait_for(lambda: "off until ~/reset: joint 'joint2' has changed" in adapting.relay.output, "the end")
    np.testing.assert_array_equal(lockstep.run(10), 0.0)
    gaps.publish(String(data=json.dumps({"gaps": []})))  # it was a payload, after all
    observer.wait_for(lambda: "names no joint any more" in adapting.relay.output, "the next beginning")
    assert np.max(np.abs(lockstep.run(60))) > 1.0


def test_what_is_carried_stays_with_a_newer_estimate(stage: Stage) -> None:
    """It is used with the next trajectory, whether that reaches a controller or not."""
    parameters = {"heaviest_payload": 2.0, "adapt_friction": True, "use_sim_time": True}
    relay, node = stage.node(parameters, module="geomid_ros.ros.feedforward", ready=False), stage.observer.node
    estimates = node.create_publisher(String, "/geomid/estimate", latched(1))
    sent = node.create_publisher(JointTrajectory, "/geomid_feedforward/joint_trajectory", 10)
    urdf = URDF.read_text()
    links = [link_entry(body.name, body.merged, body.parameters) for body in Robot(urdf).bodies if body.joint]
    friction = [{"name": "viscous_friction", "joint": joint, "value": 0.5} for joint in JOINTS]
    estimate = {"format": 1, "links": links, "effects": friction, "robot_description": urdf}
    estimates.publish(String(data=json.dumps(estimate)))
    lockstep = Lockstep(stage)
    lockstep.run(5, loaded=False)
    lockstep.run(60)
    before = len(lockstep.inertias)
    links[-1]["mass"] += 0.01
    del friction[0]
    estimates.publish(String(data=json.dumps(estimate)))
    rest = np.zeros((2, len(JOINTS)))
    still = message_of(Trajectory(tuple(JOINTS), np.array([0.0, 1.0]), rest + POSITION, rest, rest))

    def is_used() -> bool:
        sent.publish(still)
        lockstep.run(1)
        return relay.output.count("efforts are those of /geomid/estimate") > 1

    stage.observer.wait_for(is_used, "the newer estimate")
    lockstep.run(3)
    assert min(message.inertia.m for message in lockstep.inertias[before:]) > links[-1]["mass"] + 0.2
    statuses = stage.observer.collect(DiagnosticArray, "/diagnostics")

    def adapted() -> dict[str, float]:
        lockstep.tick()
        values = [value for array in statuses[-1:] for value in array.status[0].values]
        return {value.key: float(value.value) for value in values if "friction" in value.key}

    stage.observer.wait_for(adapted, "what else adapts")
    assert adapted().keys() == {f"viscous_friction coefficient of {joint} [N m s/rad]" for joint in JOINTS[1:]}
