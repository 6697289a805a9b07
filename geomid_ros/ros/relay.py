"""Relay to a joint_trajectory_controller that adds efforts to trajectories, and adapts them to a payload.

Natural adaptation: receives joint states, publishes the link's inertia and correcting efforts.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from geomid_ros.api.feedforward import check_model, fill_efforts, robot_to_move
from geomid_ros.control.correction import LONGEST_FAULT, CommandedMotion, Correction, Reading
from geomid_ros.control.feedforward import MotorEfforts
from geomid_ros.errors import GeomidError, InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.trajectories import trajectory_of
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.ros.controller import NOT_SENT, ActionRelay, Filled, follow_joint_trajectory, message_of, nothing
from geomid_ros.ros.diagnostics import status_message
from geomid_ros.ros.inputs import given_parameters
from geomid_ros.ros.outputs import inertia_message, latched, ros_time
from geomid_ros.session.configuration import AT_START, Parameter
from geomid_ros.session.options import FillOptions
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

# Of the identification node in the same namespace.
_GAPS, _ESTIMATE, _PAYLOAD = "geomid/gap/open", "geomid/estimate", "geomid/payload/inertia"


class AdaptationNode:
    """Answers every joint state on ``~/inertia`` and ``~/correction``; its status is in ``/diagnostics``."""

    def __init__(self, node: Node, session: Session, link: str, heaviest: float, friction: bool) -> None:
        """
        Args:
            node: publishes and subscribes.
            session: the robot and its model.
            link: that adapts; the last one if empty.
            heaviest: largest payload [kg].
            friction: True to adapt friction, too.

        Raises:
            InputError: this link cannot adapt.
        """
        self._node, self._session, self._heaviest, self._friction = node, session, heaviest, friction
        self._joints = session.robot.joint_names
        self._link = link or session.robot.body_names[-1]
        self._correction = self._new()
        self._commanded = CommandedMotion(self._joints)
        self._said = ""
        self._change = ""  # last change that switched the correction off
        self._lacking = "none has come"  # why joint states are unusable
        self._inertias = node.create_publisher(InertiaStamped, "~/inertia", 10)
        self._corrections = node.create_publisher(JointState, "~/correction", 10)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(JointState, "joint_states", self._on_state, latest)
        self._gaps = node.create_subscription(String, _GAPS, self._on_gaps, latched()).topic_name
        node.create_service(Trigger, "~/reset", self._reset)
        node.create_timer(LONGEST_FAULT / 4.0, self._send)
        node.create_timer(1.0, self._report)
        node.get_logger().info(f"link '{self._link}' adapts to a payload of at most {heaviest:g} kg")

    def _new(self) -> Correction:
        model, parameters = self._session.model, self._session.known_parameters
        efforts = MotorEfforts(model, parameters, self._session.effort_gains, self._joints, "the adaptation")
        return Correction(efforts, self._joints, self._link, self._heaviest, self._friction)

    def use(self, session: Session) -> None:
        """Go on with another model of the robot: what is carried stays, and a correction that is off stays off."""
        before, self._session = self._correction, session
        self._begin_anew()
        self._correction.adaptation.resume(before.adaptation.body)
        self._correction.latch.switch_off(before.latch.reason)

    def _begin_anew(self) -> None:
        before, self._correction = self._correction, self._new()
        self._correction.continue_from(before)

    @property
    def _now(self) -> float:
        return float(1e-9 * self._node.get_clock().now().nanoseconds)

    def follow(self, trajectory: Trajectory | None, start: float) -> None:
        """Record the trajectory that the controller follows from ``start`` [s] on, or now if 0; None if none."""
        self._commanded.follow(trajectory, start or self._now, self._now)

    def _on_state(self, message: JointState) -> None:
        places = {name: place for place, name in enumerate(message.name)}
        fields = {"positions": message.position, "velocities": message.velocity, "efforts": message.effort}
        absent = [f"'{joint}'" for joint in self._joints if joint not in places]
        absent = absent or [name for name, values in fields.items() if len(values) != len(message.name)]
        if absent:
            self._lacking = f"they lack {', '.join(absent)}"
            return  # the watchdog reports it if usable ones came before
        order = [places[joint] for joint in self._joints]
        position, velocity, effort = (np.array(values)[order] for values in fields.values())
        stamp = message.header.stamp
        time = stamp.sec + 1e-9 * stamp.nanosec or self._now
        reading = Reading(time, position, velocity, effort)
        self._lacking = "" if reading.is_complete else "they are not finite"
        if reading.is_complete:
            self._commanded.position = position
        self._correction.learn(self._now, reading, self._commanded(time))
        self._send()

    def _send(self) -> None:
        """Publish the present inertia and correction, also if no joint states arrive."""
        now = self._now
        sent, stamp = self._correction(now, self._commanded(now)), round(1e9 * now)
        self._inertias.publish(inertia_message(self._link, self._correction.adaptation.body, stamp))
        message = JointState(name=list(self._joints), effort=sent.tolist())
        message.header.stamp = ros_time(stamp)
        self._corrections.publish(message)
        if self._correction.latch.reason != self._said:
            self._report()

    def _on_gaps(self, message: String) -> None:
        """Switch off if the identification node notices that a joint has changed, until it takes this back: it may find
        that it was a payload, which is no gap."""
        try:
            channels = {gap["channel"] for gap in json.loads(message.data)["gaps"]}
        except (ValueError, TypeError, KeyError, RecursionError):
            self._node.get_logger().warning(f"a message on {self._gaps} is left out: it names no gaps")
            return
        if changed := [joint for joint in self._joints if joint in channels]:
            self._change = f"joint '{changed[0]}' has changed, not by a payload ({self._gaps})"
            self._correction.latch.switch_off(self._change)
            self._report()
        elif self._change and self._correction.latch.reason == self._change:
            self._node.get_logger().info(
                f"adaptation of '{self._link}' begins anew: {self._gaps} names no joint any more"
            )
            self._begin_anew()

    def _report(self) -> None:
        """Publish the status, and log once why the correction is off."""
        reason, change = self._correction.latch.reason, float(self._correction.adaptation.change[0])
        level, sentence = DiagnosticStatus.OK, f"{change:+.2f} kg"
        if self._lacking:
            level, sentence = DiagnosticStatus.WARN, f"no usable joint states: {self._lacking}"
        if reason:
            level, sentence = DiagnosticStatus.ERROR, f"off until ~/reset: {reason}"
        if reason and reason != self._said:
            self._node.get_logger().error(f"adaptation of '{self._link}' is {sentence}")
        self._said = reason
        name = f"{self._node.get_fully_qualified_name().lstrip('/')}: adaptation of {self._link}"
        values = {"mass change": change, "delay [ms]": 1e3 * self._correction.delay, **self._correction.coefficients}
        array = DiagnosticArray(status=[status_message(name, level, sentence, values)])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin_anew()
        response.success, response.message = True, "adaptation begins anew from the identified model"
        return response


_IN = "~/joint_trajectory"
_at_start = partial(Parameter, change=AT_START)
_PARAMETERS = (
    _at_start(
        "model",
        "",
        f"estimate.json, read again when it has changed; empty: the urdf alone, or the last usable one on {_ESTIMATE}",
    ),
    _at_start("urdf", "", "robot description; empty: that of the model"),
    _at_start("config", "", "parameter file of the identification node, for effort gains and locked joints"),
    _at_start("controller", "joint_trajectory_controller", "name of the controller"),
    _at_start(
        "tolerance", FillOptions.tolerance, "largest error of interpolated efforts, as a share of the largest", 0.0, 1.0
    ),
    _at_start("force", FillOptions.force, "take a model whose verdict is not 'usable', too"),
    _at_start("link", "", "link that adapts to a payload; empty: the last one"),
    _at_start("heaviest_payload", 0.0, "largest payload that a link adapts to [kg]; 0: no adaptation", 0.0, 1e6),
    _at_start("adapt_friction", False, "adapt friction together with the link, for friction that has changed"),
)


class _RobotOfFile:
    """Robot with the model in a file, or that of a URDF alone."""

    def __init__(self, options: FillOptions, path: str) -> None:
        """Read the file at this ``path``; none if empty. Raises InputError if it is unusable."""
        self._options, self._path = options, path
        self._changed = self._changed_at()
        self._session = self._read()

    def current(self) -> Session:
        """Return the robot; the file is read again if it has changed. Raises InputError if it is unusable."""
        if (changed := self._changed_at()) != self._changed:
            self._session, self._changed = self._read(), changed
        return self._session

    def _read(self) -> Session:
        return robot_to_move(self._options, EstimateFile.read(Path(self._path)) if self._path else None)

    def _changed_at(self) -> int:
        try:
            return Path(self._path).stat().st_mtime_ns
        except OSError:
            return 0  # reading reports it


class _RobotOfNode:
    """Robot with the last usable estimate of the identification node."""

    def __init__(self, options: FillOptions, node: Node) -> None:
        self._options, self._log = options, node.get_logger()
        self._topic = node.resolve_topic_name(_ESTIMATE)
        self._refusal = f"no estimate on {self._topic} yet; start geomid_node, or set the parameter model"
        self._log.info(f"waits for a usable estimate on {self._topic}")
        self._file: EstimateFile | None = None
        self._carried: dict[str, FloatArray] = {}  # by the link that carries it
        self._session: Session | None = None  # of the file and what is carried, once it is needed

    def carry(self, message: InertiaStamped) -> None:
        """Count what a link carries as part of it; no mass if it carries nothing."""
        body, centre = message.inertia, message.inertia.com
        entries = [getattr(body, name) for name in pseudo_inertia.INERTIA_NAMES]
        quantities = np.array([body.m, centre.x, centre.y, centre.z, *entries])
        is_carried = body.m > 0.0 and np.all(np.isfinite(quantities))
        self._carried = {message.header.frame_id: pseudo_inertia.parameters_of(quantities)} if is_carried else {}
        self._session = None

    def take(self, text: str) -> bool:
        """Take an estimate. Return False, and keep the one before, if it is doubtful or unusable."""
        try:
            file = EstimateFile.parse(text, self._topic)
            check_model(self._options, file)
        except InputError as error:
            if self._file is not None and not self._refusal:
                self._log.warning(f"{error}; the last usable estimate stays")
            self._refusal = str(error)
            return False
        self._file, self._session, self._refusal = file, None, ""
        return True

    def current(self) -> Session:
        """Return the robot. Raises InputError if there is no usable estimate."""
        if self._file is None:
            raise InputError(self._refusal)
        session = self._session or robot_to_move(self._options, self._file, self._carried)
        self._session = session
        return session


class FeedforwardRelay:
    """Adds efforts to trajectories on ``~/joint_trajectory``, and sends them on to ``CONTROLLER/joint_trajectory``.

    It does the same for goals of ``~/follow_joint_trajectory`` (:class:`~geomid_ros.ros.controller.ActionRelay`) if
    ``control_msgs`` is installed.

    Its node declares the parameters that it was given. Refused trajectories are not sent on. With ``heaviest_payload``
    a ``link`` adapts to a payload (:class:`~geomid_ros.ros.relay.AdaptationNode`). Efforts are computed in a thread of
    their own, one trajectory after the other, as joint states must be answered meanwhile.
    """

    def __init__(self, node: Node) -> None:
        """Raises InputError if a parameter, the robot or its model is unusable."""
        self._log = node.get_logger()
        try:
            self._set_up(node)
        except NameValidationException as error:
            raise InputError(f"controller: not a name in ROS: {' '.join(str(error).split())}") from error

    def _set_up(self, node: Node) -> None:
        table = {parameter.name: parameter for parameter in _PARAMETERS}
        values: dict[str, Any] = {name: parameter.default for name, parameter in table.items()}
        values |= given_parameters(node, table)
        model, controller, heaviest = values["model"], values["controller"], values["heaviest_payload"]
        urdf, config, force = values["urdf"] or None, values["config"] or None, values["force"]
        self._options = FillOptions(urdf, config=config, tolerance=values["tolerance"], force=force)
        self._session: Session | None = None  # that trajectories were last filled for
        self._adapting: AdaptationNode | None = None
        self._adapt: Callable[[Session], AdaptationNode] | None = None
        if heaviest:
            asked = values["link"], heaviest, values["adapt_friction"]
            self._adapt = lambda session: AdaptationNode(node, session, *asked)
        self._filling = ThreadPoolExecutor(1)
        self._due: SimpleQueue[Callable[[], None]] = SimpleQueue()  # what the thread leaves to the node's
        self._is_due = node.create_guard_condition(self._on_due)
        self._robot: _RobotOfFile | _RobotOfNode
        if model or urdf:
            self._robot = _RobotOfFile(self._options, model)
            self._current()
            self._do_due()
        else:
            self._robot = of_node = _RobotOfNode(self._options, node)
            node.create_subscription(String, _ESTIMATE, partial(self._on_estimate, of_node), latched())
            if not heaviest:  # else the link adapts to it
                node.create_subscription(InertiaStamped, _PAYLOAD, of_node.carry, latched())
        self._publisher = node.create_publisher(JointTrajectory, f"{controller}/joint_trajectory", 10)
        node.create_subscription(JointTrajectory, _IN, partial(self._fill, done=self._relay), 10)
        if (action := follow_joint_trajectory()) is not None:
            ActionRelay(node, controller, action, self._fill, self._follow)
        self._log.info(f"fills the efforts of {node.resolve_topic_name(_IN)} for {self._publisher.topic_name}")

    def _on_estimate(self, robot: _RobotOfNode, message: String) -> None:
        self._filling.submit(self._take, robot, message.data)

    def _take(self, robot: _RobotOfNode, text: str) -> None:
        """Take an estimate of the identification node; begin to adapt with the first usable one."""
        with suppress(GeomidError):  # a trajectory's refusal reports it
            if robot.take(text) and self._session is None:
                self._current()

    def _current(self) -> Session:
        """Return the robot with the present model. Raises InputError if there is none, or it is unusable."""
        session = self._robot.current()
        if session is not self._session:
            self._log.info(f"efforts are those of {session.loaded.source or session.source}")
            self._later(partial(self._use, session))
        self._session = session
        return session

    def _use(self, session: Session) -> None:
        if self._adapting is not None:
            self._adapting.use(session)
        elif self._adapt is not None:
            self._adapting = self._adapt(session)

    def close(self) -> None:
        """Wait for the trajectory whose efforts are being computed."""
        self._filling.shutdown(cancel_futures=True)

    def _later(self, function: Callable[[], None]) -> None:
        """Call a function in the node's thread."""
        self._due.put(function)
        self._is_due.trigger()

    def _on_due(self) -> None:
        try:
            self._do_due()
        except InputError as error:  # of a robot that comes with an estimate; trajectories are filled all the same
            self._log.error(f"the adaptation cannot use the last estimate: {error}")

    def _do_due(self) -> None:
        while not self._due.empty():
            self._due.get()()

    def _relay(self, result: Future[Filled]) -> None:
        try:
            filled = result.result()
        except GeomidError as error:
            self._log.error(f"{NOT_SENT}: {error}")
            return
        if not self._publisher.get_subscription_count():
            self._log.error(f"{NOT_SENT}: {nothing('subscribes to', self._publisher.topic_name)}")
            return
        self._publisher.publish(filled.message)
        self._follow(filled)

    def _fill(self, message: JointTrajectory, done: Callable[[Future[Filled]], None]) -> None:
        """Add efforts to a trajectory; ``done`` is called in the node's thread."""
        self._filling.submit(self._filled, message).add_done_callback(lambda result: self._later(partial(done, result)))

    def _filled(self, message: JointTrajectory) -> Filled:
        """Add efforts to a trajectory. Raises GeomidError if it is refused."""
        if not message.points:  # a command to stop
            return Filled(message, None)
        given = trajectory_of(message, "trajectory")
        result = fill_efforts(self._current(), given, self._options.tolerance, "trajectory")
        answer = message_of(result.trajectory)
        answer.header = message.header
        return Filled(answer, result.trajectory)

    def _follow(self, filled: Filled) -> None:
        """Adapt while the controller follows this trajectory, which it was sent."""
        if filled.trajectory is not None:
            self._log.info(f"a trajectory is sent on with efforts, of {len(filled.message.points)} points")
        if self._adapting is not None:
            stamp = filled.message.header.stamp
            self._adapting.follow(filled.trajectory, stamp.sec + 1e-9 * stamp.nanosec)
