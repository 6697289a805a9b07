"""The identification node: topics in, estimates out; the work is done by :class:`Worker`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.urdf import with_identified_inertias
from geomid_ros.gap_session import gap_session
from geomid_ros.model.samples import Samples
from geomid_ros.ros.diagnostics import NO_DESCRIPTION, STOPPED, Diagnostics
from geomid_ros.ros.gap_search import GapSearch, SearchStatus
from geomid_ros.ros.messages import inertia_message, marker_message, predicted_message
from geomid_ros.ros.parameters import read_parameters
from geomid_ros.ros.worker import Status, Worker
from geomid_ros.session import Session
from geomid_ros.types import FloatArray

# Best effort matches publishers of either kind; the depth carries a 1 kHz stream over pauses of Python.
_SENSOR_QOS = QoSProfile(depth=2000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
_CHANGED = "the robot description has changed; it is used after ~/reset"


def _take_wrench(topic: str, worker: Worker, message: WrenchStamped) -> None:
    worker.wrench(topic, message)


def _latched(depth: int = 1) -> QoSProfile:
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)


class GeomidNode(Node):
    """Subscribes to ``joint_states``, wrench topics, ``odom`` and ``robot_description``; publishes what it finds."""

    def __init__(self) -> None:
        try:
            super().__init__("geomid", automatically_declare_parameters_from_overrides=True)
        except ValueError as error:
            raise InputError(f'a parameter has no value; an empty list is written as [""] ({error})') from error
        self._configuration = read_parameters(self)
        self._active: bool = self._configuration["active"]
        self._worker: Worker | None = None
        self._search = GapSearch(self._publish_finding)
        self._urdf = ""  # the latest, not necessarily the worker's
        self._problem = ""
        self._dropped: Counter[str] = Counter()
        self._diagnostics = Diagnostics(self.get_fully_qualified_name().lstrip("/"))
        self._inertias = self.create_publisher(InertiaStamped, "~/inertias", _latched(256))
        self._predicted = self.create_publisher(JointState, "~/predicted_joint_states", 1000)
        self._identified = self.create_publisher(String, "~/robot_description", _latched())
        self._markers = self.create_publisher(MarkerArray, "~/markers", _latched())
        self._findings = self.create_publisher(String, "~/gap", _latched())
        self._diagnostic_arrays = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_service(Trigger, "~/start", partial(self._set_active, active=True))
        self.create_service(Trigger, "~/stop", partial(self._set_active, active=False))
        self.create_service(Trigger, "~/reset", self._reset)
        self.create_service(Trigger, "~/save", self._save)
        self.create_service(Trigger, "~/find_gap", self._find_gap)
        self._listen(JointState, "joint_states", Worker.joint_state)
        if self._configuration["floating_base"]:
            self._listen(Odometry, "odom", Worker.odometry)
        for sensor in self._configuration.sensors:
            self._listen(WrenchStamped, sensor.topic, partial(_take_wrench, sensor.topic))
        # On the steady clock: simulated time may stand still, and that is when one wants to hear why.
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        # Last, as it starts threads: from here on nothing fails that would leave them behind.
        if self._configuration["robot_description"]:
            self._build(self._configuration["robot_description"], "parameter robot_description")
        else:
            self.create_subscription(String, "robot_description", self._on_description, _latched())

    def _listen(self, kind: type, topic: str, take: Callable[[Worker, Any], None]) -> None:
        def callback(message: Any) -> None:
            if self._worker is None:
                self._dropped[NO_DESCRIPTION] += 1
            elif not self._active:
                self._worker.drop(STOPPED)
            else:
                take(self._worker, message)

        options = QoSOverridingOptions.with_default_policies()
        try:
            self.create_subscription(kind, topic, callback, _SENSOR_QOS, qos_overriding_options=options)
        except NameValidationException as error:
            raise InputError(f"parameters: topic '{topic}': {' '.join(str(error).split())}") from error

    def _on_description(self, message: String) -> None:
        self._urdf = message.data
        if self._worker is not None:
            changed = message.data != self._worker.session.urdf
            self.report(_CHANGED if changed else "")
            return
        try:
            self._build(message.data, "topic robot_description")
        except GeomidError as error:
            self.report(str(error))

    def report(self, problem: str) -> None:
        """Let the log and the diagnostics tell of a problem, or of none."""
        if problem and problem != self._problem:
            self.get_logger().error(problem)
        self._problem = problem

    def _build(self, urdf: str, source: str) -> None:
        """Begin to identify the robot of this description. Raises InputError when it does not fit the parameters."""
        session = Session(urdf, self._configuration, source)
        if self._worker is not None:
            self._worker.close()
        self._urdf, self._problem = urdf, ""
        self._worker = Worker(
            session, self._configuration["solve_period"], self._publish_prediction, self._publish_estimate
        )
        self.get_logger().info(
            f"identifying {len(session.model.body_names)} links from {len(session.model.channels)} channels"
        )
        if session.loaded.not_predicted:
            self.get_logger().warning(session.loaded.not_predicted)

    def _publish_prediction(self, session: Session, samples: Samples, parameters: FloatArray) -> None:
        if self._predicted.get_subscription_count() == 0:
            return
        efforts = session.model.predicted_efforts(samples, parameters)
        for index in range(len(samples)):
            self._predicted.publish(predicted_message(session.robot, samples, index, efforts[index]))

    def _publish_estimate(self, session: Session, estimate: Estimate) -> None:
        stamp = self.get_clock().now().nanoseconds
        for link in estimate.links:
            self._inertias.publish(inertia_message(link, stamp))
        self._identified.publish(String(data=with_identified_inertias(session.urdf, estimate.links)))
        self._markers.publish(marker_message(estimate.links, stamp))

    def _publish_diagnostics(self) -> None:
        status = self._worker.status(self._active) if self._worker is not None else Status(self._active)
        status.dropped.update(self._dropped)
        array = self._diagnostics.array(replace(status, problem=self._problem or status.problem), self._search.status)
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostic_arrays.publish(array)

    def _publish_finding(self, status: SearchStatus) -> None:
        self._findings.publish(String(data=json.dumps(status.document, indent=2)))
        self.get_logger().info(status.sentence)

    def _set_active(self, _: Trigger.Request, response: Trigger.Response, active: bool) -> Trigger.Response:
        self._active = active
        response.success, response.message = True, "identifying" if active else "stopped; rows and estimate are kept"
        return response

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._worker is None:
            response.success, response.message = False, NO_DESCRIPTION
            return response
        if self._urdf != self._worker.session.urdf:
            try:
                self._build(self._urdf, "topic robot_description")
            except GeomidError as error:
                response.success, response.message = False, str(error)
                return response
        self._worker.reset()
        response.success, response.message = True, "all rows forgotten"
        return response

    def _find_gap(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        refusal = self._why_not_look()
        response.success, response.message = not refusal, refusal or "looking; the finding comes on ~/gap"
        return response

    def _why_not_look(self) -> str:
        """Begin to look for a gap; what is in the way of it, or nothing."""
        if self._worker is None:
            return NO_DESCRIPTION
        if self._search.running:
            return "already looking; the finding comes on ~/gap"
        if self._configuration["gap.memory"] == 0.0:
            return "nothing to look at: the parameter gap.memory is 0"
        messages = self._worker.recent_messages()
        if not messages:
            return "no data yet"
        urdf = self._worker.session.urdf
        self._search.start(lambda: gap_session(urdf, self._configuration, "robot_description"), messages)
        return ""

    async def _save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._worker is None:
            response.success, response.message = False, NO_DESCRIPTION
            return response
        future: Future = Future(executor=self.executor)
        worker = self._worker
        worker.final_estimate(lambda result: future.set_result(self._saved(worker.session, result)))
        response.success, response.message = await future
        return response

    def _saved(self, session: Session, result: Estimate | GeomidError) -> tuple[bool, str]:
        if isinstance(result, GeomidError):
            return False, str(result)
        folder = Path(self._configuration["output_folder"] or ".").resolve()
        try:
            session.save(folder, result)
        except Exception as error:  # noqa: BLE001 whoever called must have an answer
            return False, str(error)
        return True, f"written: {folder / 'estimate.json'}, {folder / 'identified.urdf'}"

    def close(self) -> None:
        """End the threads; with an output folder, the last estimate is saved there.

        At once, as whoever ends the node may not wait for a solver at work; and again if that has found another.
        """
        self._search.close()
        if self._worker is None:
            return
        saved = self._save_last(self._worker)
        self._worker.close()
        if self._worker.estimate is not saved:
            self._save_last(self._worker)

    def _save_last(self, worker: Worker) -> Estimate | None:
        estimate = worker.estimate
        if estimate is not None and self._configuration["output_folder"]:
            _, message = self._saved(worker.session, estimate)
            self.get_logger().info(message)
        return estimate
