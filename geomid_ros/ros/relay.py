"""A relay to a joint_trajectory_controller that fills the efforts of trajectories."""

from __future__ import annotations

import math
from pathlib import Path

from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from geomid_ros.api.feedforward import filled, robot_to_move
from geomid_ros.api.options import FillOptions
from geomid_ros.errors import GeomidError, InputError
from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.files.trajectories import trajectory_of
from geomid_ros.ros.adapting import Adapting
from geomid_ros.ros.excite.controller import message_of
from geomid_ros.session.session import Session

_IN = "~/joint_trajectory"
_CONTROLLER = "/joint_trajectory_controller"


class FeedforwardRelay:
    """Sends on what it hears on ``~/joint_trajectory``, with efforts, to ``CONTROLLER/joint_trajectory``.

    Parameters of its node: ``model`` (an estimate.json, which is read again when it has changed), ``urdf``, ``config``,
    ``tolerance`` and ``force``, as of :func:`geomid_ros.feedforward`; ``controller``. What is refused is not sent on.
    With ``heaviest_payload`` [kg] a ``link`` adapts to one (:class:`~geomid_ros.ros.adapting.Adapting`).
    """

    def __init__(self, node: Node) -> None:
        """Raises InputError if a parameter, the robot or its model cannot be used."""
        self._log = node.get_logger()
        try:
            self._set_up(node)
        except (ParameterException, NameValidationException) as error:
            raise InputError(" ".join(str(error).split())) from error

    def _set_up(self, node: Node) -> None:
        self._model, urdf, config, controller = (
            str(node.declare_parameter(name, default).value)
            for name, default in (("model", ""), ("urdf", ""), ("config", ""), ("controller", _CONTROLLER))
        )
        tolerance = float(node.declare_parameter("tolerance", FillOptions.tolerance).value)
        force = bool(node.declare_parameter("force", FillOptions.force).value)
        self._options = FillOptions(urdf or None, config=config or None, tolerance=tolerance, force=force)
        self._read_at = self._changed_at()
        self._session = self._read()
        self._publisher = node.create_publisher(JointTrajectory, f"{controller}/joint_trajectory", 10)
        node.create_subscription(JointTrajectory, _IN, self._relay, 10)
        link = str(node.declare_parameter("link", "").value)
        heaviest = float(node.declare_parameter("heaviest_payload", 0.0).value)
        if not 0.0 <= heaviest < math.inf:
            raise InputError(f"heaviest_payload is {heaviest:g}, expected a mass in kg, or 0 for no adaptation")
        self._adapting = Adapting(node, self._session, link, heaviest) if heaviest else None
        self._log.info(f"fills the efforts of {node.resolve_topic_name(_IN)} for {self._publisher.topic_name}")

    def _changed_at(self) -> int:
        try:
            return Path(self._model).stat().st_mtime_ns
        except OSError:
            return 0  # reading says so

    def _read(self) -> Session:
        return robot_to_move(self._options, self._model or None)

    def _relay(self, message: JointTrajectory) -> None:
        if not message.points:  # tells the controller to stop
            self._publisher.publish(message)
            self._follow(None, message)
            return
        try:
            if (changed_at := self._changed_at()) != self._read_at:
                self._session = self._read()
                self._read_at = changed_at
                if self._adapting is not None:
                    self._adapting.use(self._session)
                self._log.info(f"{self._model} has changed and is read again")
            found = filled(self._session, trajectory_of(message, "trajectory"), self._options.tolerance, "trajectory")
        except GeomidError as error:
            self._log.error(f"a trajectory is not sent on: {error}")
            return
        filled_message = message_of(found.trajectory)
        filled_message.header = message.header
        self._publisher.publish(filled_message)
        self._follow(found.trajectory, message)
        self._log.info(f"{len(message.points)} points are sent on with efforts, as {len(filled_message.points)}")

    def _follow(self, trajectory: Trajectory | None, message: JointTrajectory) -> None:
        if self._adapting is not None:
            stamp = message.header.stamp
            self._adapting.follow(trajectory, stamp.sec + 1e-9 * stamp.nanosec)
