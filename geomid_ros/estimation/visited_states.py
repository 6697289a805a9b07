"""States that a robot visited, and how often it returned to each.

The remainder of a model depends on the state. In motions that repeat, so do the model's errors, and all repeats
together have no more information on them than one. A robot has returned to a state if it is nearer than the next state
that is independent after the filter: the motion itself sets that distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.types import FloatArray

_MOST = 1024  # states that are kept; of more, one of each pair is dropped
# Which one of a pair, at random: in a motion that repeats, every second one could be the same state again and again.
_WHICH = np.random.default_rng(0).integers(2, size=_MOST - 1)
_NEXT = 1.0 - 1e-6


@dataclass(frozen=True, eq=False)
class Visits:
    """State of :class:`VisitedStates`.

    Attributes:
        kept: ``(n, 3, S)``: the state, the step before it, the step after it.
        every: one of this many states is kept, a power of two.
        count: number of states that were candidates to be kept.
        last: the last independent states, at most three ``(l, S)``.
        age: time since the last one [s], up to ``apart``.
    """

    kept: FloatArray
    every: int
    count: int
    last: FloatArray
    age: float


class VisitedStates:
    """Roughly evenly spaced subset of the states of a motion, each with the steps before and after it."""

    def __init__(self, apart: float = 0.0) -> None:
        """``apart``: time between independent states [s]."""
        self._apart = apart
        self._age = apart
        self._last: list[FloatArray] = []
        self._count = 0
        self.kept: FloatArray = np.zeros((0, 3, 0))
        self.every = 1

    @property
    def visits(self) -> Visits:
        """State for :meth:`restore`."""
        return Visits(self.kept, self.every, self._count, np.array(self._last), min(self._age, self._apart))

    def restore(self, visits: Visits) -> None:
        """Continue from the state of another object."""
        self.kept, self.every = visits.kept, visits.every
        self._count, self._last, self._age = visits.count, [*visits.last], visits.age

    def add(self, states: FloatArray, elapsed: FloatArray) -> None:
        """Add ``states (N, S)``, each ``elapsed (N,)`` [s] after the one before."""
        added = []
        for state, passed in zip(states, elapsed.tolist(), strict=True):
            self._age += passed
            if self._age < self._apart:
                continue
            self._age = 0.0
            self._last = [*self._last[-2:], state]
            if len(self._last) == 3:
                before, state_between, after = self._last
                if self._is_kept(self._count):
                    added.append(np.stack([state_between, state_between - before, after - state_between]))
                self._count += 1
        if added:
            self._keep(np.array(added) if not len(self.kept) else np.concatenate([self.kept, added]), self.every)

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
        """Add the visits of another motion."""
        most = max(other.every, self.every)
        pairs = ((self.kept, self.every), (other.kept, other.every))
        both = [_one_of(states, most // every) for states, every in pairs if len(states)]
        self._keep(np.concatenate(both) if both else self.kept, most)

    def copy(self) -> VisitedStates:
        """Copy that later additions do not change."""
        copy = VisitedStates(self._apart)
        vars(copy).update(vars(self))
        return copy

    @property
    def distinct(self) -> float:
        """Number of distinct states as a fraction of all states, 0 to 1."""
        if len(self.kept) < 2:
            return 1.0
        states = self.kept[:, 0]
        scales = np.std(states, axis=0)
        varies = scales > ROUNDING * np.max(np.abs(states), axis=0)
        points, before, after = np.moveaxis(self.kept[:, :, varies] / scales[varies], 1, 0)
        squares = np.sum(points**2, axis=1)
        squared_distances = squares[:, None] + squares - 2.0 * points @ points.T
        squared_steps = np.minimum(np.sum(before**2, axis=1), np.sum(after**2, axis=1))
        np.fill_diagonal(squared_distances, np.inf)
        # A state as near as the next one, up to rounding, is the next one.
        returns = np.count_nonzero(squared_distances < _NEXT * squared_steps[:, None], axis=1)
        return float(np.mean(1.0 / (1.0 + self.every * returns)))


def _one_of(kept: FloatArray, every: int) -> FloatArray:
    """Keep one of ``every`` states, chosen as if they were the first."""
    while every > 1:
        pairs = np.arange((len(kept) + 1) // 2)
        places = 2 * pairs + _WHICH[pairs % len(_WHICH)]
        kept, every = kept[places[places < len(kept)]], every // 2
    return kept
