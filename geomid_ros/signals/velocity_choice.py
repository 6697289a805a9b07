"""Which velocity to believe: the message's or the derivative of the position."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray


class VelocityChoice:
    """Per joint: the message's velocity while it agrees with the position's derivative, else that derivative.

    They agree while the root mean square of their difference over the recent past is below 5 % of the derivative's,
    both with a memory of about 100 samples, and not before that many were seen.
    """

    _MEMORY = 100
    _RELATIVE_DISAGREEMENT = 0.05

    def __init__(self, joints: int) -> None:
        self._seen = np.zeros(joints)
        self._difference = np.zeros(joints)
        self._energy = np.zeros(joints)

    def choose(
        self, given: FloatArray, given_rate: FloatArray, derived: FloatArray, derived_rate: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Velocities and accelerations ``(N, joints)`` from the filtered message velocity and its derivative, and from
        the filtered position's first and second derivative."""
        velocity, acceleration = derived.copy(), derived_rate.copy()
        for row in range(len(derived)):
            usable = np.isfinite(given[row])
            error = np.where(usable, given[row] - derived[row], 0.0)
            self._seen = np.where(usable, self._seen + 1, 0.0)
            share = 1.0 / np.minimum(np.maximum(self._seen, 1.0), self._MEMORY)
            self._difference += share * (error**2 - self._difference)
            self._energy += share * (derived[row] ** 2 - self._energy)
            agrees = self._difference <= self._RELATIVE_DISAGREEMENT**2 * self._energy
            use = usable & agrees & (self._seen >= self._MEMORY)
            velocity[row, use] = given[row, use]
            acceleration[row, use] = given_rate[row, use]
        return velocity, acceleration
