"""Inverse dynamics of an identified robot, in the unit of its effort interface."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.model.dynamics import InverseDynamics
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray


class MotorEfforts:
    """Motor efforts for a motion of ``joints``, in the unit of the robot's messages.

    Offsets of effort sensors are left out: they move nothing. Gains of effort sensors are part of the unit. Dry
    friction follows the commanded velocity and is zero at rest.
    """

    def __init__(
        self,
        model: MeasurementModel,
        parameters: FloatArray,
        gains: FloatArray,
        joints: Sequence[str],
        source: str,
    ) -> None:
        """
        Args:
            model: of the robot.
            parameters: of the model ``(D,)``.
            gains: factors ``(all joints,)`` from the messages' efforts to N m (or N).
            joints: in the order of the motion.
            source: of the motion, for messages.

        Raises:
            InputError: the joints are not those of the robot, or not all efforts can be predicted.
        """
        robot = model.robot
        if robot.floating_base:
            raise InputError("the base floats: what its legs have to do depends on their contacts")
        if not model.layout.efforts:
            raise InputError("efforts cannot be predicted: an external wrench sensor does not measure all six axes")
        for joint in joints:
            if joint not in robot.joint_names:
                raise InputError(f"{source}: {unknown_name('joint', joint, robot.joint_names)}")
        if missing := [joint for joint in robot.joint_names if joint not in joints]:
            names = ",".join(missing)
            raise InputError(f"{source}: says nothing of {names}; if they stand at zero, --lock {names}")
        self._robot = robot
        self._order = np.array([robot.joint_names.index(joint) for joint in joints])
        self._gains = gains[self._order]
        of_sensors = np.array([c.effect.of_sensor for c in model.coefficients], dtype=bool)
        own = parameters.copy()
        own[len(model.nominal_inertias) :][of_sensors] = 0.0
        self._dynamics = InverseDynamics(model, own)
        self.limits = robot.effort_limits[self._order] / np.abs(self._gains)
        """Effort limits of the URDF ``(joints,)`` in that unit, infinite where it has none."""

    def __call__(self, motion: FloatArray) -> FloatArray:
        """Efforts ``(N, joints)`` of positions, velocities and accelerations ``(3, N, joints)``."""
        own = np.empty_like(motion)
        own[:, :, self._order] = motion
        return np.asarray(self._dynamics(own)[:, self._order] / self._gains)

    def of_body(self, name: str) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
        """The function that makes regressors ``(joints, 10)`` of these efforts by the inertia of a body, from motions
        ``(3, joints)``; and that inertia ``(10,)``.

        Raises:
            InputError: there is no such body, or no effort depends on it.
        """
        robot, own = self._robot, np.empty((3, 1, len(self._order)))
        if name not in robot.body_names:
            raise unknown_name("link", name, robot.body_names)
        body = robot.body_names.index(name)
        if robot.bodies[body].joint == 0:
            raise InputError(f"link '{name}' does not move: no effort depends on its inertia")

        def rows(motion: FloatArray) -> FloatArray:
            own[:, 0, self._order] = motion
            q, v, a = robot.moved(own)
            return np.asarray(robot.body_effort_rows(q[0], v[0], a[0], body)[self._order] / self._gains[:, None])

        return rows, self._dynamics.inertias[body]
