"""States that a robot visited, and how often it returned to each.

The remainder of a model depends on the state. In motions that repeat, so do the model's errors, and all repeats
together have no more information on them than one. A robot has returned to a state if it is nearer than the next state
that is independent after the filter: the motion itself sets that distance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.types import FloatArray

_MOST = 1024  # states that are kept; of more, one of each pair is dropped
# Which one of a pair, at random: in a motion that repeats, every second one could be the same state again and again.
_WHICH = np.random.default_rng(0).integers(2, size=_MOST - 1)
_NEXT = 1.0 - 1e-6


@dataclass(frozen=True, eq=False)
class Visits:
    """Roughly evenly spaced subset of the states of a motion, each with the steps before and after it.

    Attributes:
        kept: ``(n, 3, S)``: the state, the step before it, the step after it.
        every: one of this many states is kept, a power of two.
        count: number of states that were candidates to be kept.
        last: the last independent states, at most three ``(l, S)``.
        age: time since the last one [s], up to the time between two independent states.
    """

    kept: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 0)))
    every: int = 1
    count: int = 0
    last: FloatArray = field(default_factory=lambda: np.zeros(0))
    age: float = 0.0

    def with_states(self, states: FloatArray, elapsed: FloatArray, apart: float) -> Visits:
        """Add ``states (N, S)``, each ``elapsed (N,)`` [s] after the one before. States are independent if they are
        ``apart`` [s]."""
        added, count, last, age = [], self.count, [*self.last], self.age
        for state, passed in zip(states, elapsed.tolist(), strict=True):
            age += passed
            if age < apart:
                continue
            age = 0.0
            last = [*last[-2:], state]
            if len(last) == 3:
                before, between, after = last
                if self._is_kept(count):
                    added.append(np.stack([between, between - before, after - between]))
                count += 1
        kept, every = self.kept, self.every
        if added:
            kept, every = _thinned(np.concatenate([kept, added]) if len(kept) else np.array(added), every)
        return Visits(kept, every, count, np.array(last), age)

    def _is_kept(self, number: int) -> bool:
        every = self.every
        while every > 1:
            number, second = divmod(number, 2)
            if second != _WHICH[number % len(_WHICH)]:
                return False
            every //= 2
        return True

    def plus(self, other: Visits) -> Visits:
        """Merge the visits of two motions, neither of which continues."""
        most = max(other.every, self.every)
        both = [_one_of(visits.kept, most // visits.every) for visits in (self, other) if len(visits.kept)]
        return Visits(*_thinned(np.concatenate(both) if both else self.kept, most))

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


def _thinned(kept: FloatArray, every: int) -> tuple[FloatArray, int]:
    """Halve the states, of which one of ``every`` is kept, until there are no more than :data:`_MOST`."""
    while len(kept) > _MOST:
        kept, every = _one_of(kept, 2), 2 * every
    return kept, every


def _one_of(kept: FloatArray, every: int) -> FloatArray:
    """Keep one of ``every`` states, chosen as if they were the first."""
    while every > 1:
        pairs = np.arange((len(kept) + 1) // 2)
        places = 2 * pairs + _WHICH[pairs % len(_WHICH)]
        kept, every = kept[places[places < len(kept)]], every // 2
    return kept
