"""Joint controllers of motors without torque sensors: efforts from set-points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.options import numbers_in
from geomid_ros.types import FloatArray


def gains_of(text: str) -> tuple[float, float]:
    """Parse gains of a joint's controller, ``KP:KD`` [N m/rad, N/m; N m s/rad, N s/m]. Raises InputError."""
    match numbers_in(text, ":"):
        case [kp, kd] if kp > 0.0 and kd >= 0.0:
            return kp, kd
    raise InputError(f"gains '{text}' are not of the form KP:KD, e.g. 20:0.5 [N m/rad, N m s/rad], KP above 0")


@dataclass(frozen=True, eq=False)
class PDController:
    """Gains of all joints ``(joints,)``: effort = kp (q_c - q) + kd (v_c - v) + feed-forward.

    Commands act ``delay`` [ns] after their stamps.
    """

    kp: FloatArray
    kd: FloatArray
    delay: int = 0

    @staticmethod
    def of(gains: Mapping[str, tuple[float, float]], joints: Sequence[str], delay: float) -> PDController | None:
        """Build from ``gains`` kp and kd by joint (an empty name: all others) and a ``delay`` [s]; None without gains.

        Raises InputError for an unknown joint or one without gains.
        """
        if not gains:
            return None
        for name in gains:
            if name and name not in joints:
                raise unknown_name("joint with gains", name, joints)
        joint_gains = [gains.get(joint, gains.get("")) for joint in joints]
        if None in joint_gains:
            raise InputError(f"joint '{joints[joint_gains.index(None)]}' has no gains; give KP:KD for all joints")
        kp, kd = np.array([gain for gain in joint_gains if gain is not None]).T
        return PDController(kp, kd, round(1e9 * delay))

    def efforts(self, commands: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Compute efforts ``(N, joints)`` from ``commands (N, 3, joints)``: position, velocity, feed-forward."""
        q_c, v_c, feedforward = commands.swapaxes(0, 1)
        return np.asarray(self.kp * (q_c - position) + self.kd * (v_c - velocity) + feedforward)

    def rate(self, commands: FloatArray) -> FloatArray:
        """Compute effort rates ``(N, joints)`` [N m/s, N/s] from ``commands``, the set-points' time derivatives."""
        return self.efforts(commands, np.zeros_like(commands[:, 0]), np.zeros_like(commands[:, 0]))
