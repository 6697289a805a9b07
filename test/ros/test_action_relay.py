"""Goals of FollowJointTrajectory go on to the controller with efforts, and end here as they do there."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path
from threading import Event
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action.server import CancelResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from trajectory_msgs.msg import JointTrajectory

import geomid_ros
from geomid_ros.api.feedforward import fill_efforts
from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.ros import relay
from geomid_ros.ros.controller import ActionRelay, Filled, message_of

from .actions import Client, FollowJointTrajectory, ended
from .stage import Stage
from .test_feedforward import identified, model, motion
from .waiting import PATIENCE

__all__ = ["identified", "model"]  # a fixture

MOTION = Trajectory(("a",), np.array([0.5, 2.25]), np.ones((2, 1)), np.zeros((2, 1)), np.ones((2, 1)))
TOO_FAST = "too fast"  # a joint that the robot of these tests has not the efforts for
ACTIVE = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)


class Handle:
    """A goal of the relay's server, with the states and transitions of rcl_action."""

    count = 0

    def __init__(self, server: Server, goal: Any) -> None:
        Handle.count += 1
        self.goal_id = SimpleNamespace(uuid=np.full(16, Handle.count, dtype=np.uint8))
        self.request, self.status, self.feedback, self.result = goal, GoalStatus.STATUS_ACCEPTED, [], None
        self._server = server

    @property
    def is_cancel_requested(self) -> bool:
        return self.status == GoalStatus.STATUS_CANCELING

    def publish_feedback(self, feedback: Any) -> None:
        assert self.status in ACTIVE
        self.feedback.append(feedback)

    def execute(self) -> None:
        if not self.is_cancel_requested:
            self._go(GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_ACCEPTED)
        self.result = self._server.execute(self)
        assert self.status not in ACTIVE

    def succeed(self) -> None:
        self._go(GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)

    def abort(self) -> None:
        self._go(GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)

    def canceled(self) -> None:
        self._go(GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_CANCELING)

    def _go(self, status: int, *before: int) -> None:
        assert self.status in before
        self.status = status


class Server:
    """What rclpy's action server calls."""

    last: Server

    def __init__(self, _node: Any, action: Any, name: str, execute: Any, **callbacks: Any) -> None:
        assert action is FollowJointTrajectory
        assert name == "~/follow_joint_trajectory"
        self.execute, self._callbacks = execute, callbacks
        Server.last = self

    def send(self, joint: str = "a") -> Handle:
        """A goal from a planner."""
        goal = FollowJointTrajectory.Goal(message_of(MOTION), goal_time_tolerance=0.25)
        goal.trajectory.joint_names = [joint]
        handle = Handle(self, goal)
        self._callbacks["handle_accepted_callback"](handle)
        return handle

    def cancel(self, handle: Handle) -> None:
        assert self._callbacks["cancel_callback"](handle) == CancelResponse.ACCEPT
        handle.status = GoalStatus.STATUS_CANCELING


class Log:
    def __init__(self) -> None:
        self.errors: list[str] = []

    def error(self, sentence: str) -> None:
        self.errors.append(sentence)


class Rig:
    """The relay between a planner and a controller that the test plays."""

    def __init__(self) -> None:
        self.log = Log()
        self.followed: list[Trajectory | None] = []
        node: Any = SimpleNamespace(get_logger=lambda: self.log)
        ActionRelay(node, "/arm", FollowJointTrajectory, self._fill, self._follow, Client, Server)
        self.controller, self.planner = Client.last, Server.last

    @staticmethod
    def _fill(message: JointTrajectory, done: Callable[[Future[Filled]], None]) -> None:
        found = Trajectory(
            MOTION.joints, MOTION.times, MOTION.positions, MOTION.velocities, MOTION.accelerations, np.full((2, 1), 7.0)
        )
        result = Future[Filled]()
        if message.joint_names == [TOO_FAST]:
            result.set_exception(InputError("trajectory: joint 'a' would need 7, more than its limit"))
        else:
            result.set_result(Filled(message_of(found), found))
        done(result)

    def _follow(self, found: Filled) -> None:
        self.followed.append(found.trajectory)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_a_goal_goes_on_with_efforts_and_ends_as_it_does_there(rig: Rig) -> None:
    handle = rig.planner.send()
    assert rig.controller.name == "/arm/follow_joint_trajectory"
    ((goal, _),) = rig.controller.goals
    assert [point.effort.tolist() for point in goal.trajectory.points] == [[7.0], [7.0]]
    assert [point.positions.tolist() for point in goal.trajectory.points] == [[1.0], [1.0]]
    assert goal.goal_time_tolerance == 0.25
    assert rig.followed == []  # the controller has not taken it yet
    sent = rig.controller.accept(0)
    assert rig.followed[0].efforts[0, 0] == 7.0  # type: ignore[union-attr]
    rig.controller.feedback[0](SimpleNamespace(feedback="halfway"))  # type: ignore[misc]
    assert handle.feedback == ["halfway"]
    sent.ended.fulfil(ended(FollowJointTrajectory.Result.SUCCESSFUL, "done", GoalStatus.STATUS_SUCCEEDED))
    assert handle.status == GoalStatus.STATUS_SUCCEEDED
    assert handle.result.error_string == "done"
    assert len(rig.followed) == 1


def test_what_the_controller_aborts_or_cancels_by_itself_is_aborted(rig: Rig) -> None:
    for status in (GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED):
        handle = rig.planner.send()
        sent = rig.controller.accept(-1)
        sent.ended.fulfil(ended(FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, "path tolerance", status))
        assert handle.status == GoalStatus.STATUS_ABORTED
        assert handle.result.error_code == FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED
        assert handle.result.error_string == "path tolerance"
        assert rig.followed[-1] is None


@pytest.mark.parametrize("early", [False, True])
def test_an_order_to_cancel_goes_on(rig: Rig, early: bool) -> None:
    """One that comes before the controller's answer, after it; of a goal that has ended nothing is sent."""
    handle = rig.planner.send()
    if early:
        rig.planner.cancel(handle)
    sent = rig.controller.accept(0)
    if not early:
        rig.planner.cancel(handle)
    assert sent.cancelled == 1
    assert handle.status == GoalStatus.STATUS_CANCELING  # until the controller has stopped
    sent.ended.fulfil(ended(FollowJointTrajectory.Result.SUCCESSFUL, status=GoalStatus.STATUS_CANCELED))
    assert handle.status == GoalStatus.STATUS_CANCELED
    assert rig.followed[-1] is None
    rig.planner.cancel(handle)
    assert sent.cancelled == 1


def test_the_end_of_a_goal_that_was_replaced_does_not_stop_the_next(rig: Rig) -> None:
    first, second = rig.planner.send(), rig.planner.send()
    replaced, running = rig.controller.accept(0), rig.controller.accept(1)
    replaced.ended.fulfil(ended(0, "preempted", GoalStatus.STATUS_ABORTED))
    assert first.status == GoalStatus.STATUS_ABORTED
    assert second.status == GoalStatus.STATUS_ACCEPTED
    assert None not in rig.followed
    running.ended.fulfil(ended(0, "", GoalStatus.STATUS_ABORTED))
    assert rig.followed[-1] is None


def test_what_is_refused_is_aborted_with_the_reason(rig: Rig) -> None:
    """Here, or by the controller; and what no controller would take."""
    handle = rig.planner.send(TOO_FAST)
    assert handle.status == GoalStatus.STATUS_ABORTED
    assert handle.result.error_code == FollowJointTrajectory.Result.INVALID_GOAL
    assert "joint 'a' would need 7, more than its limit" in handle.result.error_string
    assert rig.log.errors == [handle.result.error_string]
    assert rig.controller.goals == []
    handle = rig.planner.send()
    rig.controller.goals[0][1].fulfil(SimpleNamespace(accepted=False))
    assert handle.status == GoalStatus.STATUS_ABORTED
    assert "not accepted; check that the controller is active" in handle.result.error_string
    rig.controller.there = False
    handle = rig.planner.send()
    assert handle.status == GoalStatus.STATUS_ABORTED
    assert "nothing serves /arm/follow_joint_trajectory" in handle.result.error_string
    assert len(rig.controller.goals) == 1
    assert rig.followed == []


def test_the_relay_fills_goals_as_it_does_what_comes_on_the_topic(
    stage: Stage, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package, actions, made = ModuleType("control_msgs"), ModuleType("control_msgs.action"), list[Any]()
    actions.FollowJointTrajectory = FollowJointTrajectory  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "control_msgs", package)
    monkeypatch.setitem(sys.modules, "control_msgs.action", actions)
    monkeypatch.setattr(relay, "ActionRelay", lambda *arguments: made.append(arguments))
    meanwhile = Event()

    def held(*arguments: Any) -> Any:
        assert meanwhile.wait(PATIENCE), "the node's thread waits for the efforts"
        return fill_efforts(*arguments)

    monkeypatch.setattr(relay, "fill_efforts", held)
    overrides = [Parameter("model", value=str(model)), Parameter("controller", value="/arm")]
    node = Node(
        "filling",
        context=stage.observer.node.context,
        parameter_overrides=overrides,
        automatically_declare_parameters_from_overrides=True,
    )
    try:
        with closing(relay.FeedforwardRelay(node)):
            ((own, controller, action, fill, _),) = made
            assert (own, controller, action) == (node, "/arm", FollowJointTrajectory)
            results, executor = list[Future[Filled]](), SingleThreadedExecutor(context=node.context)
            for given in (motion(), motion(duration=0.05)):
                fill(message_of(given), results.append)
            meanwhile.set()
            while len(results) < 2:
                rclpy.spin_once(node, executor=executor)
            expected, trajectory = geomid_ros.feedforward(motion(), model).trajectory, results[0].result().trajectory
            assert trajectory is not None
            np.testing.assert_allclose(trajectory.efforts, expected.efforts, atol=1e-6)
            with pytest.raises(InputError, match="more than its limit"):
                results[1].result()
    finally:
        node.destroy_node()
