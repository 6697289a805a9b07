"""Feet on the ground whose forces nobody measures: the efforts of their legs tell them.

A foot at the end of a leg obeys ``J^T f = Y phi - tau`` in the leg's joints. Solved for the force f and put into the
six equations of the base, that leaves rows which hold whatever the ground does. Six joints tell the moment on a flat
foot, too; at the end of fewer a foot touches in a point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray

DIRECTIONS = 3
"""Of the force on a foot: so many joints tell it."""
_NEARLY_SINGULAR = 0.1
"""Smallest singular value of a leg's Jacobian as a share of the largest: beyond it noise of efforts is magnified."""
_IN_A_LINE = 0.01
"""The same of a base's motion by its feet: of those in a line nobody knows how the base turns about it."""


@dataclass(frozen=True)
class Contact:
    """A foot on the ground: the URDF link ``frame`` has its centre at the origin, and it is round with a ``radius``
    [m]."""

    frame: str
    radius: float = 0.0

    @staticmethod
    def parse(text: str) -> Contact:
        """From ``FRAME`` or ``FRAME:RADIUS``. Raises InputError for another form."""
        frame, colon, radius = text.partition(":")
        try:
            contact = Contact(frame, float(radius) if colon else 0.0)
        except ValueError:
            contact = Contact("")
        if not contact.frame or not 0.0 <= contact.radius < math.inf:
            raise InputError(f"contact '{text}' is not of the form FRAME or FRAME:RADIUS, e.g. FL_foot:0.022 [m]")
        return contact


class Legs:
    """A robot's legs, each with a foot at its end."""

    def __init__(self, robot: Robot, contacts: Sequence[Contact]) -> None:
        """
        Args:
            robot: with a floating base.
            contacts: the feet, one at each leg.

        Raises:
            InputError: a foot is no link, is not behind three actuated joints, or shares a joint with another.
        """
        self._robot = robot
        self.contacts = tuple(contacts)
        self.joints = [self._joints(contact) for contact in contacts]
        """The joints between base and foot, of each leg."""
        for index, joints in enumerate(self.joints):
            for other, others in enumerate(self.joints[:index]):
                if shared := set(joints.tolist()) & set(others.tolist()):
                    name = robot.joint_names[min(shared)]
                    feet = f"'{contacts[other].frame}' and '{contacts[index].frame}'"
                    raise InputError(f"contacts: {feet} both move with joint '{name}', expected one foot at each leg")

    def _joints(self, contact: Contact) -> IntArray:
        robot, frame = self._robot, contact.frame
        if frame not in robot.tree.links:
            raise unknown_name("link of a contact", frame, robot.tree.links)
        above = {joint.name for joint in robot.tree.joints_above(frame)}
        joints = np.array([index for index, name in enumerate(robot.joint_names) if name in above], dtype=np.int64)
        if len(joints) < DIRECTIONS:
            raise InputError(
                f"contacts: {len(joints)} moving joints are between the base and '{frame}', expected at least "
                f"{DIRECTIONS}: the forces of the ground are found from a leg's efforts; measure them (--wrench)"
            )
        return joints

    def loads(self, samples: Samples) -> FloatArray:
        """Sizes of the :meth:`forces` on each foot ``(N, feet)``, as shares of what each bears when all stand."""
        share = self._robot.weight / len(self.contacts)
        return np.asarray(np.linalg.norm(self.forces(samples), axis=2) / share)

    def carried(self, samples: Samples) -> FloatArray:
        """The forces on all feet against gravity ``(N,)``, as shares of the robot's weight by the URDF."""
        up = -self._robot.gravity / np.linalg.norm(self._robot.gravity)
        return np.asarray(np.sum(self.forces(samples), axis=1) @ up / self._robot.weight)

    def forces(self, samples: Samples) -> FloatArray:
        """Forces of the ground on each foot ``(N, feet, 3)`` [N] in the world's axes, by the efforts and the URDF; NaN
        where they are not known."""
        q, v, a = self._robot.configuration(samples)
        missing = self._robot.joint_efforts(q, v, a) - samples.effort
        found = [
            (inverse @ missing[:, joints, None])[:, :DIRECTIONS, 0]
            for joints, (_, inverse) in zip(self.joints, self._transmissions(q), strict=True)
        ]
        return np.stack(found, axis=1)

    def turning(self, samples: Samples) -> FloatArray:
        """Angular velocities of the base ``(N, 3)`` [rad/s] in its own axes, by the joints alone, if all feet
        stand; NaN where they do not tell."""
        q = self._robot.configuration(samples)[0]
        jacobians = np.concatenate([jacobian for jacobian, _ in self._transmissions(q)], axis=1)
        of_base, of_joints = np.split(jacobians, [6], axis=2)
        s = np.linalg.svd(of_base, compute_uv=False)
        told = (s.shape[1] == 6) & (s[:, -1] > _IN_A_LINE * s[:, 0])
        velocity = -np.linalg.pinv(of_base) @ (of_joints @ samples.velocity[:, :, None])
        return np.asarray(np.where(told[:, None], velocity[:, 3:, 0], np.nan))

    def eliminate(self, samples: Samples, base: IntArray, coefficients: FloatArray, targets: FloatArray) -> None:
        """Put what the legs' rows say of the ground's forces into those of the base, in place; NaN in what that leaves
        of the legs that stand.

        Args:
            samples: N instants.
            base: channels of the base ``(6,)``.
            coefficients: ``(N, channels, D)``.
            targets: ``(N, channels)``.
        """
        for joints, stands, onto_base in self.standing(samples):
            at = stands[:, None]
            singular = np.isnan(onto_base).any(axis=(1, 2))
            onto_base[singular], targets[at[singular], base] = 0.0, np.nan
            coefficients[at, base] -= onto_base @ coefficients[at, joints]
            targets[at, base] -= (onto_base @ targets[at, joints][:, :, None])[:, :, 0]
            targets[at, joints] = np.nan

    def standing(self, samples: Samples) -> list[tuple[IntArray, IntArray, FloatArray]]:
        """Of each leg its joints, the instants ``(n,)`` at which it stands, and the matrix ``(n, 6, leg)`` that makes
        the ground's wrench on the base of its joints' efforts; NaN where that magnifies noise."""
        found = []
        transmissions = self._transmissions(self._robot.configuration(samples)[0])
        for joints, (jacobian, inverse), stands in zip(self.joints, transmissions, samples.standing.T, strict=False):
            at = np.flatnonzero(stands)
            found.append((joints, at, jacobian[at, :, :6].transpose(0, 2, 1) @ inverse[at]))
        return found

    def _transmissions(self, q: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Of each foot the Jacobian ``(N, k, 6 + joints)`` of where it touches, in the world's axes, and the matrix
        ``(N, k, leg)`` that makes forces, of six joints also moments, of the leg's efforts; NaN where it is nearly
        singular."""
        found = []
        for contact, joints in zip(self.contacts, self.joints, strict=True):
            told = DIRECTIONS * min(len(joints) // DIRECTIONS, 2)
            jacobian = self._robot.contact_jacobians(q, contact.frame, contact.radius)[:, :told]
            leg = jacobian[:, :, 6 + joints]
            s = np.linalg.svd(leg[:, :DIRECTIONS], compute_uv=False)
            inverse: FloatArray = np.asarray(np.linalg.pinv(leg.transpose(0, 2, 1)))
            gain = np.linalg.norm(inverse[:, :DIRECTIONS], ord=2, axis=(1, 2))
            inverse[(s[:, -1] <= _NEARLY_SINGULAR * s[:, 0]) | (_NEARLY_SINGULAR * s[:, 0] * gain > 1.0)] = np.nan
            found.append((jacobian, inverse))
        return found
