"""The action of a joint_trajectory_controller, on a stub of what ``control_msgs`` and rclpy's client offer: the package
has no wheel. The names are those of control_msgs/action/FollowJointTrajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from trajectory_msgs.msg import JointTrajectory


class Later:
    """A future that the test fulfils."""

    def __init__(self) -> None:
        self.callbacks: list[Callable[[Any], None]] = []

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        self.callbacks.append(callback)

    def fulfil(self, value: Any) -> None:
        for callback in self.callbacks:
            callback(SimpleNamespace(result=lambda: value))


class FollowJointTrajectory:
    @dataclass
    class Goal:
        trajectory: JointTrajectory = field(default_factory=JointTrajectory)
        goal_time_tolerance: float = 0.0

    @dataclass
    class Result:
        error_code: int = 0
        error_string: str = ""

        SUCCESSFUL = 0
        INVALID_GOAL = -1
        PATH_TOLERANCE_VIOLATED = -4


class Sent:
    """A goal that a server has accepted."""

    accepted = True

    def __init__(self) -> None:
        self.ended = Later()
        self.cancelled = 0

    def get_result_async(self) -> Later:
        return self.ended

    def cancel_goal_async(self) -> None:
        self.cancelled += 1


class Client:
    """An action client whose goals the test answers."""

    last: Client

    def __init__(self, _node: Any, action: Any, name: str) -> None:
        assert action is FollowJointTrajectory
        self.name = name
        self.there = True
        self.goals: list[tuple[Any, Later]] = []
        self.feedback: list[Callable[[Any], None] | None] = []
        Client.last = self

    def server_is_ready(self) -> bool:
        return self.there

    def send_goal_async(self, goal: Any, feedback_callback: Callable[[Any], None] | None = None) -> Later:
        self.goals.append((goal, Later()))
        self.feedback.append(feedback_callback)
        return self.goals[-1][1]

    def accept(self, number: int) -> Sent:
        """Accept a goal."""
        sent = Sent()
        self.goals[number][1].fulfil(sent)
        return sent


def ended(code: int, text: str = "", status: int = 0) -> Any:
    """The answer of a server whose goal has ended."""
    return SimpleNamespace(status=status, result=FollowJointTrajectory.Result(code, text))
