"""What an identification says of the IMU that it relies on."""

from __future__ import annotations

import math

import numpy as np

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.effects import effect_class
from geomid_ros.model.robot import Robot

_TURNED = 1.0  # [deg]
_SURE = 3.0  # standard deviations


def turned_imu(estimate: Estimate, robot: Robot) -> list[str]:
    """That the IMU is turned or biased, in a sentence, if it is so by more than a degree.

    Args:
        estimate: what was found.
        robot: whose weight by the URDF serves.
    """
    offsets = [effect for effect in estimate.effects if effect_class(effect.name).place == "base"]
    force = math.hypot(*(offset.value for offset in offsets))
    std = math.hypot(*(offset.std for offset in offsets))
    share = force / robot.weight
    angle = math.degrees(math.atan(share))
    if angle < _TURNED or force < _SURE * std:
        return []
    acceleration = share * float(np.linalg.norm(robot.gravity))
    sentence = (
        f"the IMU seems to be turned by {angle:.1f} degrees against its frame in the URDF, or its acceleration across "
        f"gravity is off by {acceleration:.2f} m/s^2; that is compensated. Calibrate it, or correct the frame"
    )
    return [sentence]
