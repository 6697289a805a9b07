"""Which velocities are used: those of the messages, or the derivatives of the positions."""

from __future__ import annotations

import numpy as np

from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.types import BoolArray, FloatArray

SCALED = Reason(
    "velocities are the positions' derivatives but for a factor: do the stamps run too fast or too slow, or is their "
    "unit another one? They are not used",
    "told",
)
_UNITS_OF_SPEED = (180.0 / np.pi, 1000.0, 30.0 / np.pi, 0.5 / np.pi)  # degrees, mrad, 1/min, turns in a rad/s


class VelocityChoice:
    """Chooses for each joint the message's velocity while it agrees with the position's derivative, else the latter.

    They agree while the root mean square of their difference is below 5 % of the derivative's, both with a memory of
    about 100 samples, and not before that many were seen; and while a delay, which is what is in proportion to the
    derivative's rate, makes no more of it than half. The effects' columns are functions of the positions: with links
    that follow a late velocity, rotors would take over masses.
    """

    _MEMORY = 100
    _RELATIVE_DISAGREEMENT = 0.05
    _IN_PROPORTION = 0.99
    _WRONG_CLOCK = 1.5  # a velocity that is off by less may be a gear's or a filter's

    def __init__(self, joints: int) -> None:
        self._seen = np.zeros(joints, dtype=np.int64)
        self._means = np.zeros((4, joints))  # of the products in choose
        self._sums = np.zeros((3, joints))  # of the velocity's square, its product with the derivative, of its square
        self._known = np.zeros(joints, dtype=np.int64)
        self._told = False

    @property
    def scaled(self) -> BoolArray:
        """At which joints the messages' velocities are the derivatives but for a factor ``(joints,)``."""
        given, both, derived = self._sums
        told = (self._known >= self._MEMORY) & (both > 0.0) & (both**2 > self._IN_PROPORTION * given * derived)
        return np.asarray(told & (np.abs(both - derived) > self._RELATIVE_DISAGREEMENT * derived))

    def remark(self) -> Reason | None:
        """What is peculiar about the messages' velocities, said once."""
        if self._told or not self.scaled.any():
            return None
        self._told = True
        rate = self.common_rate()
        return _wrong_clock(rate) if rate else SCALED

    def common_rate(self) -> float:
        """How many times the derivatives the messages' velocities are, if that is the same at all joints that tell and
        no unit's factor; else 0."""
        _, both, derived = self._sums
        rates = both[self.scaled] / derived[self.scaled]
        if len(rates) < 2:
            return 0.0
        alike = np.all(np.abs(rates / np.median(rates) - 1.0) < self._RELATIVE_DISAGREEMENT)
        sizes = np.abs(np.log(np.median(rates))) - np.abs(np.log(_UNITS_OF_SPEED))
        of_unit = np.any(np.abs(sizes) < self._RELATIVE_DISAGREEMENT)
        far = abs(np.log(np.median(rates))) > np.log(self._WRONG_CLOCK)
        every = far and np.all(self.scaled | (self._known < self._MEMORY) | ~(both > 0.0))
        return float(np.median(rates)) if every and alike and not of_unit else 0.0

    def choose(
        self, given: FloatArray, given_rate: FloatArray, derived: FloatArray, derived_rate: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Choose for N samples.

        Args:
            given: ``(N, joints)`` the messages' velocity, filtered; NaN where there is none.
            given_rate: its derivative.
            derived: ``(N, joints)`` the filtered position's first derivative.
            derived_rate: its second.

        Returns:
            Velocities and accelerations ``(N, joints)``.
        """
        known = np.isfinite(given)
        own = np.where(known, given, 0.0)
        self._sums += [np.sum(own**2, axis=0), np.sum(own * derived, axis=0), np.sum(known * derived**2, axis=0)]
        self._known += np.sum(known, axis=0)
        off = np.where(known, given - derived, 0.0)
        squares = np.stack([off**2, derived**2, off * derived_rate, derived_rate**2], axis=1)
        places = np.arange(1, len(given) + 1)[:, None]
        lost = np.maximum.accumulate(np.where(known, 0, places))
        seen = places - lost + np.where(lost, 0, self._seen)
        shares = 1.0 / np.clip(seen, 1, self._MEMORY)
        means = np.empty_like(squares)
        mean = self._means
        for row, (share, square) in enumerate(zip(shares, squares, strict=True)):
            means[row] = mean = mean + share * (square - mean)
        difference, size, with_rate, rate = means.transpose(1, 0, 2)
        punctual = 2.0 * with_rate**2 <= difference * rate
        use = known & punctual & (difference <= self._RELATIVE_DISAGREEMENT**2 * size) & (seen >= self._MEMORY)
        self._means, self._seen = mean, seen[-1]
        return np.where(use, given, derived), np.where(use, given_rate, derived_rate)


def _wrong_clock(rate: float) -> Reason:
    return driver_error(
        f"stamps run {max(rate, 1.0 / rate):.3g} times too {'slow' if rate < 1.0 else 'fast'}: at all "
        "joints the velocities are so many times as small or large as the positions' derivatives; stamp messages in "
        "seconds, when they are measured"
    )
