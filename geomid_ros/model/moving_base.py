"""Moving base: an IMU instead of the base's odometry, and feet on the ground without force sensors.

An accelerometer measures the specific force, acceleration minus gravity. The equations of motion need no more: they do
not depend on which way is up. The direction of up only determines where a round foot touches the ground.

A foot at the end of a leg obeys ``J^T f = Y phi - tau`` in the leg's joints. Solved for the force f and put into the
six equations of the base, this leaves rows that hold whatever the ground forces are. A leg of six joints also
determines the moment on a flat foot; with fewer joints a foot is a point contact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, check_name
from geomid_ros.model import se3
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.options import numbers_in
from geomid_ros.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ImuMount:
    """Pose of an IMU on the base, and the ``gravity (3,)`` of the world [m/s^2].

    ``rotation (3, 3)`` takes vectors from the IMU's axes to the base's; ``origin (3,)`` is its position there [m].
    """

    rotation: FloatArray
    origin: FloatArray
    gravity: FloatArray

    def weighed(self, specific_force: FloatArray) -> FloatArray:
        """Return lengths of ``specific_force (N, 3)`` as multiples of gravity ``(N,)``; about one on average."""
        return np.asarray(np.linalg.norm(specific_force, axis=1) / np.linalg.norm(self.gravity))

    def base_motion(
        self, angular_velocity: FloatArray, angular_acceleration: FloatArray, specific_force: FloatArray, up: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the base's motion in the form of :class:`~geomid_ros.model.samples.Samples`.

        ``up`` gives the tilt; heading and position are arbitrary, and the linear velocity is zero. The acceleration
        minus gravity gives the measured specific force at the IMU, whatever ``up`` is.

        Args:
            angular_velocity, angular_acceleration, specific_force: ``(N, 3)`` in the IMU's axes.
            up: ``(N, 3)`` unit vectors against gravity, in the IMU's axes.

        Returns:
            Poses ``(N, 7)``, velocities and accelerations ``(N, 6)``.
        """
        rate, rate_change = angular_velocity @ self.rotation.T, angular_acceleration @ self.rotation.T
        lever_acceleration = np.cross(rate_change, self.origin) + np.cross(rate, np.cross(rate, self.origin))
        world_up = -self.gravity / np.linalg.norm(self.gravity)
        quaternions = se3.shortest_rotation(up @ self.rotation.T, world_up)
        gravity = se3.rotate_inverse(quaternions, self.gravity)
        acceleration = specific_force @ self.rotation.T - lever_acceleration + gravity
        zeros = np.zeros_like(rate)
        return (
            np.concatenate([zeros, quaternions], axis=1),
            np.concatenate([zeros, rate], axis=1),
            np.concatenate([acceleration, rate_change], axis=1),
        )


DIRECTIONS = 3
"""Components of the force on a foot, and so the least number of joints that determine it."""
_NEARLY_SINGULAR = 0.1
"""Least ratio of smallest to largest singular value of a leg's Jacobian: below it effort noise is magnified."""
_IN_A_LINE = 0.01
"""Least such ratio for the base's motion from its feet: with feet in a line, rotation about the line is unknown."""


@dataclass(frozen=True)
class Contact:
    """A foot on the ground: a ball of a ``radius`` [m] around the origin of the URDF link ``frame``, or a point."""

    frame: str
    radius: float = 0.0

    @staticmethod
    def parse(text: str) -> Contact:
        """Parse ``FRAME`` or ``FRAME:RADIUS``. Raises InputError for any other form."""
        frame, colon, radius = text.partition(":")
        match numbers_in(radius) if colon else [0.0]:
            case [number] if frame and number >= 0.0:
                return Contact(frame, number)
        raise InputError(f"contact '{text}' is not of the form FRAME or FRAME:RADIUS, e.g. FL_foot:0.022 [m]")


class Legs:
    """A robot's legs, each with a foot at its end."""

    def __init__(
        self, robot: Robot, contacts: Sequence[Contact], efforts: Callable[[Samples], FloatArray] | None = None
    ) -> None:
        """
        Args:
            robot: robot with a floating base.
            contacts: the feet, one per leg.
            efforts: known efforts of friction and rotors ``(N, joints)`` in samples, if any.

        Raises:
            InputError: if a foot is not a link, moves with fewer than three joints, or shares a joint with another.
        """
        self._robot = robot
        self.efforts = efforts
        self.contacts = tuple(contacts)
        self.joints = [self._joints(contact) for contact in contacts]
        """Joints between base and foot, for each leg."""
        for index, joints in enumerate(self.joints):
            for other, other_joints in enumerate(self.joints[:index]):
                if shared := set(joints.tolist()) & set(other_joints.tolist()):
                    name = robot.joint_names[min(shared)]
                    feet = f"'{contacts[other].frame}' and '{contacts[index].frame}'"
                    raise InputError(f"contacts: {feet} share joint '{name}'; each foot needs its own leg")

    def _joints(self, contact: Contact) -> IntArray:
        robot, frame = self._robot, contact.frame
        check_name("link of a contact", frame, robot.tree.links)
        above = {joint.name for joint in robot.tree.joints_above(frame)}
        joints = np.array([index for index, name in enumerate(robot.joint_names) if name in above], dtype=np.int64)
        if len(joints) < DIRECTIONS:
            raise InputError(
                f"contacts: the leg of '{frame}' has too few joints ({len(joints)}): at least {DIRECTIONS} are "
                "needed to compute ground reaction forces from efforts; otherwise measure them (--wrench)"
            )
        return joints

    def loads(self, samples: Samples) -> FloatArray:
        """Compute the size of the force on each foot ``(N, feet)``, as a fraction of weight / number of feet."""
        weight_per_foot = self._robot.weight / len(self.contacts)
        return np.asarray(np.linalg.norm(self.forces(samples), axis=2) / weight_per_foot)

    def weight_fraction(self, samples: Samples) -> FloatArray:
        """Compute the total force of all feet against gravity ``(N,)``, as a fraction of the URDF's weight."""
        up = -self._robot.gravity / np.linalg.norm(self._robot.gravity)
        return np.asarray(np.sum(self.forces(samples), axis=1) @ up / self._robot.weight)

    def forces(self, samples: Samples) -> FloatArray:
        """Compute ground forces on each foot ``(N, feet, 3)`` [N] in the world's axes, from the efforts, the URDF and
        the known effects of joints; NaN where they are unknown."""
        q, v, a = self._robot.configuration(samples)
        ground_efforts = self._robot.joint_efforts(q, v, a) - samples.effort
        if self.efforts is not None:
            ground_efforts += self.efforts(samples)
        per_foot = [
            (inverse @ ground_efforts[:, joints, None])[:, :DIRECTIONS, 0]
            for joints, (_, inverse) in zip(self.joints, self._transmissions(q), strict=True)
        ]
        return np.stack(per_foot, axis=1)

    def base_rate(self, samples: Samples) -> FloatArray:
        """Compute the base's angular velocity ``(N, 3)`` [rad/s] in the base frame from joint motion alone, assuming
        that all feet stand; NaN where it is not determined."""
        q = self._robot.configuration(samples)[0]
        jacobians = np.concatenate([jacobian for jacobian, _ in self._transmissions(q)], axis=1)
        of_base, of_joints = np.split(jacobians, [6], axis=2)
        s = np.linalg.svd(of_base, compute_uv=False)
        determined = (s.shape[1] == 6) & (s[:, -1] > _IN_A_LINE * s[:, 0])
        velocity = -np.linalg.pinv(of_base) @ (of_joints @ samples.velocity[:, :, None])
        return np.asarray(np.where(determined[:, None], velocity[:, 3:, 0], np.nan))

    def eliminate(self, samples: Samples, base: IntArray, coefficients: FloatArray, targets: FloatArray) -> None:
        """Eliminate ground forces: subtract the rows of standing legs from the base's rows, in place.

        Targets of standing legs become NaN, and those of the base where a leg is nearly singular.

        Args:
            samples: N samples.
            base: channels of the base ``(6,)``.
            coefficients: ``(N, channels, D)``.
            targets: ``(N, channels)``.
        """
        for joints, stands, onto_base in self.standing(samples):
            rows = stands[:, None]
            singular = np.isnan(onto_base).any(axis=(1, 2))
            onto_base[singular], targets[rows[singular], base] = 0.0, np.nan
            coefficients[rows, base] -= onto_base @ coefficients[rows, joints]
            targets[rows, base] -= (onto_base @ targets[rows, joints][:, :, None])[:, :, 0]
            targets[rows, joints] = np.nan

    def standing(self, samples: Samples) -> list[tuple[IntArray, IntArray, FloatArray]]:
        """Return for each leg its joints, the indices ``(n,)`` of samples where it stands, and the matrix ``(n, 6,
        leg)`` from its joints' efforts to the ground's wrench on the base; NaN where that magnifies noise."""
        legs = []
        transmissions = self._transmissions(self._robot.configuration(samples)[0])
        for joints, (jacobian, inverse), stands in zip(self.joints, transmissions, samples.standing.T, strict=False):
            rows = np.flatnonzero(stands)
            legs.append((joints, rows, jacobian[rows, :, :6].transpose(0, 2, 1) @ inverse[rows]))
        return legs

    def balance(self, samples: Samples) -> tuple[FloatArray, FloatArray]:
        """Compute the ground's wrench on the base from both sides; NaN where a leg is nearly singular.

        Returns:
            The part of each joint's effort ``(N, 6, joints)``, and the sum of all that the URDF's links require
            ``(N, 6)``.
        """
        links = np.array([body.parameters for body in self._robot.bodies]).ravel()
        rows = self._robot.joint_effort_rows(*self._robot.configuration(samples), base=True)
        efforts, required = np.split(rows.reshape(*rows.shape[:2], -1) @ links, [-6], axis=1)
        parts = np.zeros((*required.shape, efforts.shape[1]))
        for joints, stands, onto_base in self.standing(samples):
            parts[np.ix_(stands, np.arange(6), joints)] = -onto_base * samples.effort[stands][:, None, joints]
            required[stands] -= (onto_base @ efforts[stands][:, joints, None])[:, :, 0]
        return parts, required

    def _transmissions(self, q: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return for each foot the Jacobian ``(N, k, 6 + joints)`` of its contact point in the world's axes, and the
        matrix ``(N, k, leg)`` from the leg's efforts to the force (with six joints also the moment); NaN where that is
        nearly singular."""
        transmissions = []
        for contact, joints in zip(self.contacts, self.joints, strict=True):
            components = DIRECTIONS * min(len(joints) // DIRECTIONS, 2)
            jacobian = self._robot.contact_jacobians(q, contact.frame, contact.radius)[:, :components]
            leg = jacobian[:, :, 6 + joints]
            s = np.linalg.svd(leg[:, :DIRECTIONS], compute_uv=False)
            inverse: FloatArray = np.asarray(np.linalg.pinv(leg.transpose(0, 2, 1)))
            gain = np.linalg.norm(inverse[:, :DIRECTIONS], ord=2, axis=(1, 2))
            inverse[(s[:, -1] <= _NEARLY_SINGULAR * s[:, 0]) | (_NEARLY_SINGULAR * s[:, 0] * gain > 1.0)] = np.nan
            transmissions.append((jacobian, inverse))
        return transmissions
