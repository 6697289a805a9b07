"""How probable a hypothesis is: its weight beside nothing and beside every rival in its place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np

from geomid_ros.inference.fit import JointFit, fit, scattered
from geomid_ros.inference.hypothesis import Chosen, Term
from geomid_ros.inference.selection import Selection

_LEAST_SQUARE = 3.0**2
"""A size within three standard deviations of nothing is no evidence."""


@dataclass(frozen=True, eq=False)
class Support(Generic[Chosen]):
    """What speaks for a hypothesis: by how much the score is worse without it (``loss``), and what that is ``worth``
    where rows depend on each other; the same loss with each of the ``rivals`` in its place, and its ``probability``
    among all of these."""

    loss: float
    worth: float
    rivals: tuple[tuple[Chosen, float], ...]
    probability: float


class Supports(Generic[Chosen, Term]):
    """The supports of the hypotheses that a ``selection`` ``found``."""

    def __init__(self, selection: Selection[Chosen, Term], found: JointFit[Chosen, Term]) -> None:
        self._selection = selection
        self._found = found
        self._sized = scattered(selection.design, found)
        self._losses: dict[Chosen, float] = {}

    def of(self, candidate: Chosen) -> Support[Chosen]:
        """The support of one of them.

        Its absence is judged beside a remainder that is estimated anew: what a free curve says as well is no evidence
        for a name. It is worth no more than its size says, by the density at nothing of its posterior and its prior
        (Dickey, "The weighted likelihood ratio", 1971), with the standard deviations that the scatter between blocks of
        time shows; and rivals are as much less unlikely.
        """
        loss, worth = self.loss(candidate), self.worth(candidate)
        rivals = self._rivals(self._selection.without(self._found, candidate), candidate)
        kept = max(worth, 0.0) / loss if loss > 0.0 else 1.0
        against = [worth, *(kept * worse for _, worse in rivals)]
        odds = float(np.sum(np.exp(-0.5 * np.clip(against, -1e3, 1e3))))
        return Support(loss, worth, tuple(sorted(rivals, key=lambda rival: rival[1])), 1.0 / (1.0 + odds))

    def worth(self, candidate: Chosen) -> float:
        """By how much the score is worse without it, where rows depend on each other."""
        of_size = self._of_size(candidate)
        return min(self.loss(candidate), of_size) if of_size > 0.0 else of_size

    def loss(self, candidate: Chosen) -> float:
        """By how much the score is worse without it, each beside the remainder that suits it better: the one at hand,
        or that which the hypothesis would leave."""
        if candidate not in self._losses:
            selection, found = self._selection, self._found
            rest = selection.without(found, candidate)
            design = rest.settled(selection.design, selection.design.reached(candidate))
            both = [fit(design, selection.prior, each.chosen, each).score for each in (rest, found)]
            self._losses[candidate] = min(rest.score, both[0]) - min(found.score, both[1])
        return self._losses[candidate]

    def _rivals(self, rest: JointFit[Chosen, Term], candidate: Chosen) -> list[tuple[Chosen, float]]:
        """The others in its place, each with the loss: exactly of those that are as good as this, of all others as the
        score test says. The same with another constant, and what contains it, deny nothing."""
        selection, found = self._selection, self._found
        denies = [t for t in selection.ranked(rest) if not t.candidate.includes(candidate)]
        worse = {t.candidate: rest.score - t.gain - found.score for t in denies if np.isfinite(t.gain)}
        for instead in selection.rivals(found, candidate):
            own = [c for c in instead.chosen if c not in found.chosen and not c.includes(candidate)]
            if own:
                worse[own[0]] = instead.score - found.score
        return list(worse.items())

    def _of_size(self, candidate: Chosen) -> float:
        """By how much the score is worse if it is nothing, as its size says."""
        sized, found = self._sized, self._found
        if candidate.payload is None:
            places = [found.place(term) for term in candidate.terms]
            values = np.array([found.value(t) - self._selection.prior.value(t) for t in candidate.terms])
            inverse = found.inverse[np.ix_(places, places)]
            narrowed = max(0.0, -float(np.linalg.slogdet(inverse * found.weights[places])[1]))
        else:  # mass and first moment: its prior is next to none
            first = 10 * (found.manifold.links - len(found.bodies) + found.bodies.index(candidate.payload))
            places = list(range(first, first + 4))
            values, narrowed = found.point.parameters[places], 0.0
        square = float(values @ np.linalg.solve(sized.covariance[np.ix_(places, places)], values))
        return square - max(narrowed + candidate.cost, _LEAST_SQUARE)
