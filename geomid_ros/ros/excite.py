"""Runs a motion on a robot: plans, executes, monitors and records it, in a bag that is complete even after an error."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import WriterError
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import String

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.excitation.approach import ApproachPath, stopping_accelerations, stopping_trajectory, trajectory_through
from geomid_ros.excitation.limits import JointState, MotionMonitor, RobotLimits, check_motion
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.live.threads import MOST_AT_ONCE
from geomid_ros.model.robot import Robot
from geomid_ros.ros.controller import TrajectoryController, find_controller
from geomid_ros.ros.inputs import DATA
from geomid_ros.ros.outputs import latched
from geomid_ros.ros.startup import PATIENCE, POLL, running_node
from geomid_ros.session.excitation import collision_model, not_watched, without_touching
from geomid_ros.session.options import RunOptions
from geomid_ros.signals.messages import JOINT_STATES, parse
from geomid_ros.simulation.bag import BagWriter
from geomid_ros.types import FloatArray

_DESCRIPTION = "robot_description"
_WRENCH, _STATE, _TEXT = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
T = TypeVar("T")


class Recorder:
    """Writes serialised messages into a new bag; a context manager.

    It writes in a separate thread, as the monitoring of a robot must not wait for a disk.
    """

    def __init__(self, path: Path, topics: Mapping[str, str]) -> None:
        """
        Args:
            path: of the bag, which does not exist yet.
            topics: types of the messages, as ``sensor_msgs/msg/JointState``, by topic.

        Raises:
            GeomidError: the bag cannot be written.
        """
        self.path = path
        self.problem = ""
        """Reason why recording has stopped; empty if it has not."""
        try:
            self._bag = BagWriter(path)
        except (OSError, WriterError) as error:
            raise GeomidError(f"{path}: cannot be written ({error})") from error
        self._topics = {topic: self._bag.topic(topic, kind) for topic, kind in topics.items()}
        self._thread = ThreadPoolExecutor(1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.submit(self._do, self._bag.close)
        self._thread.shutdown()

    def write(self, topic: str, data: bytes) -> None:
        """Record a message as received now."""
        self._thread.submit(self._do, self._bag.write, self._topics[topic], time.time_ns(), data)

    def _do(self, act: Callable[..., object], *arguments: Any) -> None:
        try:
            act(*arguments)
        except OSError as error:
            self.problem = f"{self.path}: cannot be written ({error.strerror or error})"


class RobotMonitor:
    """Subscribes to joint states and the description, and records messages on request."""

    def __init__(self, node: Node, joints: tuple[str, ...], topic: str, interrupted: Callable[[], bool]) -> None:
        """
        Args:
            node: subscribes.
            joints: whose states are requested.
            topic: of the joint states.
            interrupted: returns True if the user interrupts.
        """
        self._node, self._joints, self._interrupted = node, joints, interrupted
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._new: list[JointState] = []
        self._recorder: Recorder | None = None
        self.description = ""
        """URDF of the robot, as received."""
        self.positions: dict[str, float] = {}
        """Positions of all received joints by name; not finite if unknown."""
        self.state: JointState | None = None
        """Latest joint state."""
        self._states = node.create_subscription(JointStateMessage, topic, self._take, DATA, raw=True)
        self._descriptions = node.create_subscription(String, _DESCRIPTION, self._describe, latched())
        self.topic: str = self._states.topic_name
        """Full name of the joint states' topic."""

    def poll(self) -> list[JointState]:
        """Return the joint states since the last call, or within a moment."""
        self._executor.spin_once(timeout_sec=POLL)
        for _ in range(MOST_AT_ONCE):
            with self._states.handle:
                taken = self._states.handle.take_message(JointStateMessage, True)
            if taken is None:
                break
            self._take(taken[0])
        states, self._new = self._new, []
        return states

    def wait_for(self, find: Callable[[], T | None], patience: float) -> T | None:
        """Return the result of ``find``, None after ``patience`` [s]. Raises GeomidError if the user interrupts."""
        end = time.monotonic() + patience
        while (result := find()) is None and time.monotonic() < end:
            if self._interrupted():
                raise GeomidError("interrupted; nothing has moved")
            self.poll()
        return result

    def period(self, seconds: float) -> float:
        """Mean time between joint states [s], measured for some ``seconds``."""
        begin, count = time.monotonic(), 0
        while time.monotonic() - begin < seconds:
            count += len(self.poll())
        return (time.monotonic() - begin) / max(count, 1)

    @contextmanager
    def record(self, path: Path, urdf: str) -> Iterator[Recorder]:
        """Record joint states and all wrenches into a new bag, with the ``urdf`` as description."""
        topics = self._node.get_topic_names_and_types()
        wrenches = {topic: _WRENCH for topic, kinds in topics if kinds == [_WRENCH]}
        description: str = self._descriptions.topic_name
        with Recorder(path, {self.topic: _STATE, description: _TEXT, **wrenches}) as recorder:
            recorder.write(description, serialize_message(String(data=urdf)))
            for topic in wrenches:
                write = partial(recorder.write, topic)
                self._node.create_subscription(WrenchStamped, topic, write, DATA, raw=True)
            self._recorder = recorder
            try:
                yield recorder
            finally:
                self._recorder = None

    def _take(self, data: bytes) -> None:
        if self._recorder is not None:
            self._recorder.write(self.topic, data)
        message = parse(JOINT_STATES, deserialize_message(data, JointStateMessage))
        count, position = len(message.names), message.arrays[0]
        positions = position if len(position) == count else np.full(count, np.nan)
        self.positions.update(zip(message.names, positions.tolist(), strict=True))
        if (state := JointState.of(message, self._joints)) is not None:
            self.state = state
            self._new.append(state)

    def _describe(self, message: String) -> None:
        self.description = message.data


_SILENCE, _PERIODS = 0.04, 3.0  # [s] and periods without joint states
_SETTLING = 0.5  # [s] monitored before a motion, for the rate of joint states, and after it
_RESTING, _LATELY = 0.02, 0.1  # [rad/s, m/s] below which a joint is at rest, over the last [s]


@dataclass(frozen=True, kw_only=True)
class MotionRequest:
    """Request to run a motion.

    Attributes:
        motion: at full speed.
        source: its origin, for messages.
        speed: factor on the motion's speed.
        urdf: text and source of the robot's description; None for that on the topic robot_description.
        options: the controller, and what stops the motion.
    """

    motion: Trajectory
    source: str
    speed: float
    urdf: tuple[str, str] | None
    options: RunOptions


@dataclass(frozen=True, eq=False)
class Plan:
    """Plan of a run: the slow ``approach`` from the present pose to the start, then the ``motion``, within ``limits``.
    Joint states may be missing for ``silence`` [s]. ``notes``: sentences on the checks."""

    approach: Trajectory
    motion: Trajectory
    limits: RobotLimits
    silence: float
    notes: tuple[str, ...]


@contextmanager
def prepared_run(order: MotionRequest) -> Iterator[MotionRun]:
    """Prepare a run with its node. SIGINT and SIGTERM stop it.

    Raises:
        InputError: the motion does not fit the robot, or something required is missing.
    """
    signals: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda number, _: signals.append(number)) for number in numbers}
    try:
        with running_node("geomid_excite") as node:
            yield MotionRun(node, order, lambda: bool(signals))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class MotionRun:
    """Run of one motion on one robot; see :func:`prepared_run`."""

    def __init__(self, node: Node, order: MotionRequest, interrupted: Callable[[], bool]) -> None:
        self._node, self._order, self._interrupted = node, order, interrupted
        self._robot = RobotMonitor(node, order.motion.joints, order.options.joint_topic, interrupted)
        self._urdf, source = order.urdf or self._description()
        robot = Robot(self._urdf, source=source)
        self._limits = RobotLimits.of(robot, order.motion.joints, order.source)
        motion = order.motion.at_speed(order.speed)
        check_motion(motion, self._limits, order.source)
        present = self._heard().position
        if outside := self._limits.out_of_range(present):
            raise InputError(f"{outside} in the URDF: move it back first")
        silence = order.options.silence or max(_SILENCE, _PERIODS * self._robot.period(_SETTLING))
        postures, notes = self._postures(robot, present)
        approach = trajectory_through(motion.joints, postures, self._limits.speeds)
        self.plan = Plan(approach, motion, self._limits, silence, notes)
        self._stopping = stopping_accelerations(order.motion, self._limits.speeds)

    def _description(self) -> tuple[str, str]:
        text = self._robot.wait_for(lambda: self._robot.description or None, PATIENCE)
        if text is None:
            raise InputError("no message on robot_description; give the URDF with --urdf")
        return text, "topic robot_description"

    def _heard(self) -> JointState:
        state = self._robot.wait_for(lambda: self._robot.state, PATIENCE)
        if state is not None:
            return state
        topic, missing = self._robot.topic, sorted({*self._order.motion.joints} - self._robot.positions.keys())
        if not self._robot.positions:
            raise InputError(
                f"no joint states on {topic}: check that the driver runs; --joint-topic names another topic"
            )
        problem = f"no data of {', '.join(missing)}" if missing else "no message has finite positions of all joints"
        raise InputError(f"{topic}: {problem}; {self._order.source} moves {', '.join(self._order.motion.joints)}")

    def _postures(self, robot: Robot, present: FloatArray) -> tuple[list[FloatArray], tuple[str, ...]]:
        """Return the postures of the approach from the ``present`` one to the start, and sentences on the checks.

        Raises InputError if there is no free way, or the motion comes too close to something.
        """
        options, motion = self._order.options, self._order.motion
        start = motion.positions[0]
        collision = collision_model(options, robot, Path(robot.source))
        received = [self._robot.positions.get(name, np.nan) for name in robot.joint_names]
        passage = ApproachPath(robot, motion.joints, np.nan_to_num(received), collision)
        unwatched = without_touching(collision, passage.all_positions(start[None])[0])
        for label, position in (("at the present pose", present), ("at the start of the motion", start)):
            if touching := passage.overlap(position):
                raise InputError(f"{label}, {touching}; move it away first, or correct --avoid")
        passage.require_clearance(np.array([present, start]), options.clearance)
        passage.check(motion, self._order.source)
        return [present, *passage.find_postures(present, start)], tuple(not_watched(collision, unwatched))

    def execute(self, bag: Path, say: Callable[[str], None]) -> None:
        """Move, and record.

        Args:
            bag: to write, which does not exist yet.
            say: receives sentences on the progress.

        Raises:
            GeomidError: the motion was stopped, for the reason stated. The bag is complete.
        """
        controller = find_controller(self._node, self._order.options.controller, self._robot.poll)
        with self._robot.record(bag, self._urdf) as recorder:
            for name, motion in (("to the start", self.plan.approach), ("the motion", self.plan.motion)):
                say(f"{name}: {motion.duration:.1f} s")
                self._follow(motion, controller, recorder, say)
        if recorder.problem:
            raise GeomidError(recorder.problem)

    def _follow(
        self, motion: Trajectory, controller: TrajectoryController, recorder: Recorder, say: Callable[[str], None]
    ) -> None:
        """Let the robot follow a motion, and monitor it. Raises GeomidError if it had to be stopped."""
        if self._interrupted():
            raise GeomidError(f"interrupted before {'the motion' if motion is self.plan.motion else 'anything moved'}")
        self._robot.poll()
        begin = self._robot.state.stamp if self._robot.state is not None else 0
        watch = MotionMonitor(
            motion, self._limits, tolerance=self._order.options.tolerance, silence=self.plan.silence, begin=begin
        )
        controller.send(motion)

        def stop(reason: str) -> str:
            way = stopping_trajectory(motion.joints, *watch.present_state, self._stopping)
            controller.send(way)
            say(f"stopping: {reason}")
            return self._ending(way.duration + _SETTLING)

        problem, before = "", time.monotonic()
        try:
            while watch.elapsed < motion.duration + _SETTLING and not problem:
                states, now = self._robot.poll(), time.monotonic()
                deviation = watch.check(states, now - before)
                before, interruption = now, "interrupted" if self._interrupted() else ""
                problem = interruption or controller.problem or deviation or recorder.problem
        except BaseException as error:
            stop(repr(error))  # watched until it rests: the command would be lost if the node ended at once
            raise
        if problem:
            ending = stop(problem)
            raise GeomidError(f"the motion was stopped: {problem}. {ending}. Recorded until then: {recorder.path}")

    def _ending(self, seconds: float) -> str:
        """Return a sentence on whether the robot is at rest after some seconds."""
        states: list[JointState] = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            states += self._robot.poll()
        recent = [state.position for state in states if state.stamp > states[-1].stamp - 1e9 * _LATELY]
        if len(recent) < 2:
            return "It is not known whether the robot is at rest, as no joint states arrive: check it"
        if np.max(np.ptp(recent, axis=0)) > _RESTING * _LATELY:
            return "The robot still moves: use its emergency stop"
        return "The robot is at rest"
