"""A realistic joint: its friction, what its motor gives for what is commanded, and how its lubricant warms up.

The friction is LuGre (Canudas de Wit, Olsson, Astrom, Lischinsky 1995): bristles that bend before the surfaces slide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class LuGre:
    """Friction of n joints; their bristles are bent by ``z (n,)`` [rad].

    ``dz/dt = v - |v| stiffness z / g(v)`` and ``F = stiffness z + damping exp(-(v/speed)^2) dz/dt + viscous v``, with
    the dry friction ``g(v) = level + excess exp(-(v/speed)^2)`` of steady sliding. The bristles' damping fades with
    speed, else friction would drive the joint where it slides fast (Olsson 1996).

    Attributes:
        level, excess: Dry friction while sliding fast ``(n,)``, and how much more it is near standstill [N m].
        speed: Where the excess has fallen to 37 % ``(n,)`` [rad/s].
        stiffness, damping: Of the bristles ``(n,)`` [N m/rad, N m s/rad].
        viscous: ``(n,)`` [N m s/rad], of a joint that is warm.
    """

    level: FloatArray
    excess: FloatArray
    speed: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    viscous: FloatArray

    def sliding(self, velocity: FloatArray) -> FloatArray:
        """Dry friction ``g(v) (n,)`` of steady sliding."""
        return self.level + self.excess * self._slow(velocity)

    def bent(self, z: FloatArray, velocity: FloatArray, dry: FloatArray, step: float) -> FloatArray:
        """The bristles ``(n,)`` after ``step`` [s] at a constant velocity, under the ``dry`` friction g: exact."""
        end = np.sign(velocity) * dry / self.stiffness
        bent: FloatArray = end + (z - end) * np.exp(-step * np.abs(velocity) * self.stiffness / dry)
        return bent

    def force(self, z: FloatArray, velocity: FloatArray, dry: FloatArray, cold: FloatArray | float = 1.0) -> FloatArray:
        """Friction ``(n,)`` [N m], opposite to the motion, where viscous friction is ``cold`` times its warm value."""
        rate = velocity - np.abs(velocity) * self.stiffness * z / dry
        force: FloatArray = (
            self.stiffness * z + self.damping * self._slow(velocity) * rate + cold * self.viscous * velocity
        )
        return force

    def _slow(self, velocity: FloatArray) -> FloatArray:
        slow: FloatArray = np.exp(-((velocity / self.speed) ** 2))
        return slow


@dataclass(frozen=True, eq=False)
class Motors:
    """n motors, each with its gear.

    Attributes:
        cogging: Efforts of the magnets and of the gear's teeth without current, ``(waves, n)`` [N m].
        ripple: Share of the commanded effort by which it varies over a turn ``(n,)``.
        cycles, phase: Waves of cogging per turn of the joint, and their phases ``(waves, n)`` [rad]; the ripple has
            twice the first.
        limit: Largest effort ``(n,)`` [N m].
    """

    cogging: FloatArray
    ripple: FloatArray
    cycles: FloatArray
    phase: FloatArray
    limit: FloatArray

    def supplied(self, commanded: FloatArray) -> FloatArray:
        """The commanded efforts ``(n,)`` within the limits: what the currents say."""
        return np.clip(commanded, -self.limit, self.limit)

    def unseen(self, effort: FloatArray, position: FloatArray) -> FloatArray:
        """What reaches the joints ``(n,)`` beyond the efforts that the currents say."""
        angles = self.cycles * position + self.phase
        cogging = (self.cogging * np.sin(angles)).sum(axis=0)
        unseen: FloatArray = cogging + self.ripple * effort * np.sin(2.0 * angles[0])
        return unseen


@dataclass(frozen=True, eq=False)
class WarmUp:
    """Viscous friction is ``1 + excess exp(-t / time)`` times its warm value: ``excess (n,)``, ``time`` [s]."""

    excess: FloatArray
    time: float

    def cold(self, instant: float) -> FloatArray:
        """The factor ``(n,)`` at an instant [s]."""
        return 1.0 + self.excess * math.exp(-instant / self.time)
