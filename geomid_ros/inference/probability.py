"""How probable a hypothesis is: its weight beside nothing and beside every rival in its place."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Generic

import numpy as np

from geomid_ros.estimation.estimate import TOLD
from geomid_ros.inference.design import Design
from geomid_ros.inference.fit import JointFit, fit, scattered
from geomid_ros.inference.hypothesis import Chosen, Hypothesis, Term
from geomid_ros.inference.selection import Selection
from geomid_ros.types import FloatArray

_ALONG = 0.5  # of what a channel lacks, as a root mean square, may lie along a hypothesis's columns


def shares(scores: Sequence[float] | FloatArray) -> FloatArray:
    """Probabilities ``(k,)`` of hypotheses of which one is true, by their ``scores (k,)``: minus twice the logarithm of
    each one's evidence, its cost included."""
    weights = np.exp(-0.5 * (np.asarray(scores) - np.min(scores)))
    return np.asarray(weights / np.sum(weights))


def probability_of_square(square: float) -> float:
    """The largest probability that a size is not nothing, from which it is the root of ``square`` standard deviations
    away; within three of these it is no evidence."""
    return 1.0 / (1.0 + float(np.exp(-0.5 * np.clip(square - TOLD**2, -1e3, 1e3))))


@dataclass(frozen=True, eq=False)
class Support(Generic[Chosen]):
    """What speaks for a hypothesis: by how much the score is worse without it (``loss``), and what that is ``worth``
    where rows depend on each other; the relative ``doubt`` of its size that comes from what the model lacks; the same
    loss with each of the ``rivals`` in its place, and its ``probability`` among all of these."""

    loss: float
    worth: float
    doubt: float
    rivals: tuple[tuple[Chosen, float], ...]
    probability: float


class Supports(Generic[Chosen, Term]):
    """The supports of the hypotheses that a ``selection`` ``found``."""

    def __init__(self, selection: Selection[Chosen, Term], found: JointFit[Chosen, Term]) -> None:
        self._selection = selection
        self._found = found
        self._sized = scattered(selection.design, found)
        self._covariance = self._sized.covariance
        self._lacking = _lacking(selection.design, found)
        self._losses: dict[Chosen, float] = {}
        self._groups_of_odds: dict[float, set[Hashable]] = {}
        for hypothesis in selection.hypotheses:
            self._groups_of_odds.setdefault(hypothesis.odds, set()).add(hypothesis.group)

    def of(self, candidate: Chosen) -> Support[Chosen]:
        """The support of one of them.

        Its absence is judged beside a remainder that is estimated anew: what a free curve says as well is no evidence
        for a name. It is worth no more than its size says, by the density at nothing of its posterior and its prior
        (Dickey, "The weighted likelihood ratio", 1971), with the standard deviations that the scatter between blocks of
        time shows; and rivals are as much less unlikely. All are as common as this robot shows such hypotheses to be.
        """
        loss, worth, common = self.loss(candidate), self.worth(candidate), self._common(candidate)
        rivals = self._rivals(self._selection.without(self._found, candidate), candidate)
        kept = max(worth, 0.0) / loss if loss > 0.0 else 1.0
        against = [worth + common, *(kept * worse + common - self._common(rival) for rival, worse in rivals)]
        ordered = tuple(sorted(rivals, key=lambda rival: rival[1]))
        return Support(loss, worth, self.doubt(candidate), ordered, float(shares([0.0, *against])[0]))

    def _common(self, candidate: Chosen) -> float:
        """By how much more common than their prior odds say hypotheses like one are, as twice a logarithm: of the Beta
        distribution that these are from, as if they had been seen once before, and how many others were found (Scott
        and Berger, "Bayes and empirical-Bayes multiplicity adjustment in the variable-selection problem", 2010)."""
        alike = self._groups_of_odds[candidate.odds]
        others = sum(c.group in alike for c in self._found.chosen if c.group != candidate.group)
        return 2.0 * float(np.log((1 + others) / (1.0 + candidate.odds * (len(alike) - 1 - others))))

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
        """The others in its place, each with the loss: exactly of bodies and of those that are as good as this, of all
        others as the score test says. The same with another constant, and what contains it, deny nothing; what would
        improve the fit beside it as well does so only by what it is better in its place."""
        selection, found = self._selection, self._found
        beside = {trial.candidate: max(trial.gain, 0.0) for trial in selection.ranked(found)}
        worse = dict[Chosen, float]()
        for trial in selection.ranked(rest):
            rival, loss = trial.candidate, rest.score - trial.gain - found.score
            if rival.includes(candidate) or rival.payload is not None or not np.isfinite(loss):
                continue
            if loss < 0.0:  # a promise that the search, which has tried exchanges, did not find kept
                instead = selection.fit([*rest.chosen, rival], rest)
                loss = instead.score - found.score if selection.possible(instead) else np.inf
            worse[rival] = loss + beside.get(rival, 0.0)
        for instead in selection.rivals(found, candidate):
            own = [c for c in instead.chosen if c not in found.chosen and not c.includes(candidate)]
            if own:
                worse[own[0]] = instead.score - found.score + beside.get(own[0], 0.0)
        return list(worse.items())

    def _of_size(self, candidate: Chosen) -> float:
        """By how much the score is worse if it is nothing, as its size says; of a body its mass and first moment, whose
        prior is next to none."""
        found = self._found
        values, places = found.changes[candidate], _places(found, candidate)
        narrowed = 0.0
        if candidate.payload is not None:
            values, places = values[:4], places[:4]
        else:
            narrowed = -float(np.linalg.slogdet(found.inverse[np.ix_(places, places)] * found.weights[places])[1])
        square = float(values @ np.linalg.solve(self._covariance[np.ix_(places, places)], values))
        wider = 1.0 + self.doubt(candidate) ** 2 * square  # of the covariance's determinant
        size, price = square / wider, narrowed - float(np.log(wider)) + candidate.cost
        return size - (price if size > TOLD**2 else max(price, TOLD**2))

    def doubt(self, candidate: Chosen) -> float:
        """The relative standard deviation of its size that comes from what the model lacks."""
        return _doubt(self._selection.design, self._found, self._lacking, candidate, self._found.changes[candidate])


def relative_doubt(
    design: Design, found: JointFit[Any, Any], columns: Hypothesis[Any] | int, values: FloatArray
) -> float:
    """The relative standard deviation of ``values (k,)`` of a hypothesis's columns, or of a link's, that comes from
    what their channels lack beside a fit: a part of it may lie along them.

    Least squares weigh what each channel says by the power that the columns have there; what channels lack may have
    one cause.
    """
    return _doubt(design, found, _lacking(design, found), columns, values)


def _lacking(design: Design, found: JointFit[Any, Any]) -> FloatArray:
    """Of what each channel lacks beside a fit, the part that may lie along any columns: a sum of squares ``(C,)``."""
    return np.array([_ALONG**2 * lack.power for lack in found.remainders(design)])


def _doubt(
    design: Design,
    found: JointFit[Any, Any],
    lacking: FloatArray,
    columns: Hypothesis[Any] | int,
    values: FloatArray,
) -> float:
    """The same, of which the part of each channel's sum of squares that may lie along columns is known."""
    powers = np.maximum(design.powers(columns, values) / found.squares, 0.0)  # rounding may leave less
    left = float(np.sum(np.sqrt(lacking / found.squares * powers)))
    return left / max(float(np.sum(powers)), 1e-300)


def _places(found: JointFit[Chosen, Term], candidate: Chosen) -> list[int]:
    """Where a hypothesis's parameters stand ``(k,)``."""
    if candidate.payload is None:
        return [found.place(term) for term in candidate.terms]
    first = 10 * (found.manifold.links - len(found.bodies) + found.bodies.index(candidate.payload))
    return list(range(first, first + 10))
