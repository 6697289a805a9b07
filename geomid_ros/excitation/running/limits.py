"""What a robot may do, by its description, and whether a motion keeps to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

_SLACK = 1e-6  # of rounding, in numbers that were written to a file
_AT_REST = 1e-3  # [rad/s, m/s]
_OUTSIDE = 0.005  # [rad, m] of a range, as a joint may rest at its end


@dataclass(frozen=True, eq=False)
class RobotLimits:
    """Limits of ``joints``, each ``(joints,)``, infinite where there is none.

    ``lower`` and ``upper`` [rad, m], ``speeds`` [rad/s, m/s], ``efforts`` [N m, N].
    """

    joints: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    speeds: FloatArray
    efforts: FloatArray

    @staticmethod
    def of(robot: Robot, joints: tuple[str, ...], source: str) -> RobotLimits:
        """Those of a robot's URDF. Raises InputError naming the ``source`` of the joints if it has none of a name."""
        for name in joints:
            if name not in robot.joint_names:
                unknown = unknown_name(f"joint of {robot.source}", name, robot.joint_names)
                raise InputError(f"{source}: made for another robot: {unknown}")
        places = [robot.joint_names.index(name) for name in joints]
        lower, upper = robot.position_limits[places].T
        return RobotLimits(joints, lower, upper, robot.speed_limits[places], robot.effort_limits[places])

    def out_of_range(self, position: FloatArray) -> str:
        """Which joint is out of its range at a position ``(joints,)``, in a sentence, if one is."""
        for index in np.flatnonzero((position < self.lower - _OUTSIDE) | (position > self.upper + _OUTSIDE)):
            limits = f"{self.lower[index]:g} to {self.upper[index]:g}"
            return f"joint '{self.joints[index]}' is at {position[index]:.3f}, outside its range {limits}"
        return ""


def check_motion(motion: Trajectory, limits: RobotLimits, source: str) -> None:
    """Refuse a motion that a robot cannot make, or that neither begins nor ends at rest.

    Raises:
        InputError: naming ``source`` and the joint.
    """
    if not motion.accelerations.shape[1]:
        raise InputError(f"{source}: no point has accelerations; expected a motion as 'geomid excite' writes it")
    for index, when in ((0, "begins"), (-1, "ends")):
        fast = int(np.argmax(np.abs(motion.velocities[index])))
        if abs(motion.velocities[index, fast]) > _AT_REST:
            raise InputError(
                f"{source}: the motion {when} at {motion.velocities[index, fast]:.3g} rad/s (m/s) of joint "
                f"'{motion.joints[fast]}'; it must begin and end at rest"
            )
    lowest, highest = motion.positions.min(axis=0), motion.positions.max(axis=0)
    for index, joint in enumerate(motion.joints):
        if lowest[index] < limits.lower[index] - _SLACK or highest[index] > limits.upper[index] + _SLACK:
            raise InputError(
                f"{source}: joint '{joint}' moves from {lowest[index]:.3f} to {highest[index]:.3f}, outside its range "
                f"{limits.lower[index]:g} to {limits.upper[index]:g} in the URDF"
            )
        if motion.speeds[index] > limits.speeds[index] * (1.0 + _SLACK):
            raise InputError(
                f"{source}: joint '{joint}' moves at {motion.speeds[index]:.3g}, faster than {limits.speeds[index]:g} "
                "in the URDF; lower --speed"
            )
