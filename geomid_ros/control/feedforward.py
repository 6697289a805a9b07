"""Feed-forward efforts of an identified model: for a motion, and for a trajectory.

A joint_trajectory_controller interpolates positions by polynomials and efforts linearly (ros2_controllers adds them to
its feedback since 4.22). Points are added where linear interpolation of the efforts is too coarse. They lie on the same
polynomials, so the motion does not change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.model.dynamics import InverseDynamics, motor_parameters
from geomid_ros.model.effects import Motion, MotionEffect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

EffortsOf: TypeAlias = Callable[[FloatArray], FloatArray]
"""Inverse dynamics: efforts ``(N, joints)`` [N m, N] at positions, velocities and accelerations ``(3, N, joints)``."""
SHORTEST = 1e-3
"""Shortest time between two points [s]: the cycle time of typical controllers."""
_PROBED = 10.0 * SHORTEST  # [s] longest time between checks of the interpolation
_INSIDE = (0.25, 0.5, 0.75)  # further checks between two points, as errors may be antisymmetric about the middle


class MotorEfforts:
    """Motor efforts for a motion of ``joints``, in the unit of the robot's messages.

    Offsets of effort sensors are left out, as they move nothing. Gains of effort sensors are part of the unit. Dry
    friction follows the commanded velocity and is zero at rest.
    """

    def __init__(
        self, model: MeasurementModel, parameters: FloatArray, gains: FloatArray, joints: Sequence[str], source: str
    ) -> None:
        """
        Args:
            model: model of the robot.
            parameters: parameters of the model ``(D,)``.
            gains: factors ``(all joints,)`` from the messages' efforts to N m (or N).
            joints: joints in the order of the motion.
            source: origin of the motion, for messages.

        Raises:
            InputError: the joints are not those of the robot, or not all efforts can be predicted.
        """
        robot = model.robot
        if robot.floating_base:
            raise InputError("floating base: leg efforts depend on the contacts")
        if not model.layout.efforts:
            raise InputError("efforts cannot be predicted: an external wrench sensor does not measure all six axes")
        if unknown := [joint for joint in joints if joint not in robot.joint_names]:
            raise InputError(f"{source}: {unknown_name('joint', unknown[0], robot.joint_names)}")
        if missing := [joint for joint in robot.joint_names if joint not in joints]:
            advice = "if they stay at zero, name them in locked_joints (--lock)"
            raise InputError(f"{source}: does not contain {','.join(missing)}; {advice}")
        self._robot = robot
        self.coefficients = [
            (coefficient.effect, coefficient, float(value))
            for coefficient, value in zip(model.coefficients, parameters[len(model.nominal_inertias) :], strict=True)
            if isinstance(coefficient.effect, MotionEffect) and coefficient.positive and value > 0.0
        ]
        """Positive coefficients of the effects of motion, such as friction: effect, coefficient and value."""
        self._order = np.array([robot.joint_names.index(joint) for joint in joints])
        self._gains, self._load_gains = gains[self._order], model.drive_gains[self._order]
        self._dynamics = InverseDynamics(model, motor_parameters(model, parameters))
        self.limits = robot.effort_limits[self._order] / np.abs(self._gains)
        """Effort limits of the URDF ``(joints,)`` in the messages' unit, infinite where it has none."""

    def __call__(self, motion: FloatArray) -> FloatArray:
        """Efforts ``(N, joints)`` for positions, velocities and accelerations ``(3, N, joints)``."""
        ordered = np.empty_like(motion)
        ordered[:, :, self._order] = motion
        return np.asarray(self._dynamics(ordered)[:, self._order] / self._gains)

    def of_body(self, name: str) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
        """Return a function of motions ``(3, joints)`` that computes regressors ``(joints, 10)`` of these efforts by
        the inertia of a body; and that inertia ``(10,)``.

        Raises:
            InputError: there is no such body, or no effort depends on it.
        """
        robot, ordered = self._robot, np.empty((3, 1, len(self._order)))
        if name not in robot.body_names:
            raise unknown_name("link", name, robot.body_names)
        body = robot.body_names.index(name)
        if robot.bodies[body].joint == 0:
            raise InputError(f"link '{name}' does not move: no effort depends on its inertia")

        def rows(motion: FloatArray) -> FloatArray:
            ordered[:, 0, self._order] = motion
            q, v, a = robot.moved(ordered)
            rows = robot.body_effort_rows(q[0], v[0], a[0], body)[self._order]
            return np.asarray(rows * (self._load_gains / self._gains)[:, None])

        return rows, self._dynamics.inertias[body]

    def of_coefficients(self) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
        """Return a function of motions ``(3, joints)`` that computes the columns ``(joints, K)`` of
        :attr:`coefficients` in these efforts; and their values ``(K,)``."""
        ordered = np.empty((3, len(self._order)))

        def columns(motion: FloatArray) -> FloatArray:
            ordered[:, self._order] = motion
            state = Motion(ordered)
            efforts = [effect.efforts(state, coefficient.place) for effect, coefficient, _ in self.coefficients]
            return np.asarray(np.array(efforts).reshape(-1, len(self._order)).T[self._order] / self._gains[:, None])

        return columns, np.array([value for _, _, value in self.coefficients])


def with_efforts(trajectory: Trajectory, efforts_of: EffortsOf, tolerance: float) -> Trajectory:
    """Add efforts at all points, and further points where needed.

    Args:
        trajectory: the motion.
        efforts_of: inverse dynamics.
        tolerance: largest interpolation error, as a fraction of each joint's largest effort. Where the effort jumps, as
            at the points of cubic polynomials, the error may be larger for :data:`SHORTEST`.
    """
    times = trajectory.times
    unsure = np.ones(len(times) - 1, dtype=np.bool_)
    while True:
        motion = trajectory.states(times)[:3]
        accelerations = motion[2] if trajectory.accelerations.shape[1] else np.zeros((len(times), 0))
        result = Trajectory(trajectory.joints, times, motion[0], motion[1], accelerations, efforts_of(motion))
        largest = np.max(np.abs(result.efforts), axis=0)
        bounds = np.maximum(tolerance * largest, ROUNDING * np.max(largest))
        too_coarse = np.any(interpolation_errors(result, efforts_of, unsure) > bounds, axis=1)
        too_coarse &= np.diff(times) >= 2.0 * SHORTEST
        if not np.any(too_coarse):
            return result
        middle = 0.5 * (times[1:] + times[:-1])
        times = np.sort(np.concatenate([times, middle[too_coarse]]))
        unsure = np.repeat(too_coarse, 1 + too_coarse)  # both halves


def interpolation_errors(found: Trajectory, efforts_of: EffortsOf, where: BoolArray | None = None) -> FloatArray:
    """Largest error of linearly interpolated efforts between two points ``(N - 1, joints)`` [N m, N]; zero where
    ``where (N - 1,)`` is False."""
    times, steps = found.times, np.diff(found.times)
    probes = [np.arange(times[0], times[-1], _PROBED), *(times[:-1] + fraction * steps for fraction in _INSIDE)]
    at = np.concatenate(probes)
    between = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(steps) - 1)
    if where is not None:
        at, between = at[where[between]], between[where[between]]
    fraction = ((at - times[between]) / steps[between])[:, None]
    linear = (1.0 - fraction) * found.efforts[between] + fraction * found.efforts[between + 1]
    errors = np.zeros((len(steps), len(found.joints)))
    np.maximum.at(errors, between, np.abs(efforts_of(found.states(at)[:3]) - linear))
    return errors
