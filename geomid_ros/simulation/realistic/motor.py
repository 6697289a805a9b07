"""What motors give for what is commanded, and how lubricants warm up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geomid_ros.types import FloatArray


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
