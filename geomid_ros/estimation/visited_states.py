"""The states that a robot came through, and how often it came back to each.

What a model lacks depends on the state: in motions that repeat, so do its errors, and all the repeats together tell no
more of them than one. A robot is back in a state if that is nearer than the next one that the filter leaves
independent: the motion itself says how near that is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.types import FloatArray

_MOST = 1024  # states that are kept: of more, one of two
# Which of two, by chance: every second one would again and again be the same one of a motion that repeats.
_WHICH = np.random.default_rng(0).integers(2, size=_MOST - 1)
_NEXT = 1.0 - 1e-6


@dataclass(frozen=True, eq=False)
class Visits:
    """What :class:`VisitedStates` hold.

    Attributes:
        kept: ``(n, 3, S)``: the state, the step before, the step after.
        every: of so many states one is kept, a power of two.
        count: of the states that might have been kept.
        last: those that count, at most three ``(l, S)``.
        age: of the last one, as far as it matters [s].
    """

    kept: FloatArray
    every: int
    count: int
    last: FloatArray
    age: float


class VisitedStates:
    """Some of the states of a motion, about evenly, each with the steps that led to it and on from it."""

    def __init__(self, apart: float = 0.0) -> None:
        """``apart``: time from one state to the next that counts [s]."""
        self._apart = apart
        self._age = apart
        self._last: list[FloatArray] = []
        self._count = 0
        self.kept: FloatArray = np.zeros((0, 3, 0))
        self.every = 1

    @property
    def visits(self) -> Visits:
        """All that they hold."""
        return Visits(self.kept, self.every, self._count, np.array(self._last), min(self._age, self._apart))

    def restore(self, visits: Visits) -> None:
        """Take what others held."""
        self.kept, self.every = visits.kept, visits.every
        self._count, self._last, self._age = visits.count, [*visits.last], visits.age

    def add(self, states: FloatArray, elapsed: FloatArray) -> None:
        """Add ``states (N, S)``, each so long ``elapsed (N,)`` [s] after the one before."""
        found = []
        for state, passed in zip(states, elapsed.tolist(), strict=True):
            self._age += passed
            if self._age < self._apart:
                continue
            self._age = 0.0
            self._last = [*self._last[-2:], state]
            if len(self._last) == 3:
                before, own, after = self._last
                if self._is_kept(self._count):
                    found.append(np.stack([own, own - before, after - own]))
                self._count += 1
        if found:
            self._keep(np.array(found) if not len(self.kept) else np.concatenate([self.kept, found]), self.every)

    def _is_kept(self, number: int) -> bool:
        every = self.every
        while every > 1:
            number, second = divmod(number, 2)
            if second != _WHICH[number % len(_WHICH)]:
                return False
            every //= 2
        return True

    def _keep(self, kept: FloatArray, every: int) -> None:
        while len(kept) > _MOST:
            kept, every = _one_of(kept, 2), 2 * every
        self.kept, self.every = kept, every

    def plus(self, other: Visits) -> None:
        """Add what others kept of another motion."""
        most = max(other.every, self.every)
        pairs = ((self.kept, self.every), (other.kept, other.every))
        both = [_one_of(own, most // each) for own, each in pairs if len(own)]
        self._keep(np.concatenate(both) if both else self.kept, most)

    def copy(self) -> VisitedStates:
        """A copy that later additions do not change."""
        copy = VisitedStates(self._apart)
        vars(copy).update(vars(self))
        return copy

    @property
    def distinct(self) -> float:
        """The number of states that differ over that of all states, 0 to 1."""
        if len(self.kept) < 2:
            return 1.0
        states = self.kept[:, 0]
        scales = np.std(states, axis=0)
        told = scales > ROUNDING * np.max(np.abs(states), axis=0)
        places, before, after = np.moveaxis(self.kept[:, :, told] / scales[told], 1, 0)
        squares = np.sum(places**2, axis=1)
        apart = squares[:, None] + squares - 2.0 * places @ places.T
        near = np.minimum(np.sum(before**2, axis=1), np.sum(after**2, axis=1))
        np.fill_diagonal(apart, np.inf)
        # What is as near as the next one, but for rounding, is the next one.
        again = np.count_nonzero(apart < _NEXT * near[:, None], axis=1)
        return float(np.mean(1.0 / (1.0 + self.every * again)))


def _one_of(kept: FloatArray, every: int) -> FloatArray:
    """Of so many states one, as if they were the first."""
    while every > 1:
        pairs = np.arange((len(kept) + 1) // 2)
        places = 2 * pairs + _WHICH[pairs % len(_WHICH)]
        kept, every = kept[places[places < len(kept)]], every // 2
    return kept
