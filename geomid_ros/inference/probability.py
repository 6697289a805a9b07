"""Probability of a hypothesis: its weight against nothing and against every rival in its place."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomid_ros.estimation.estimate import SIGNIFICANT_STDS
from geomid_ros.inference.candidates import Candidate
from geomid_ros.inference.design import Design, remembered
from geomid_ros.inference.fit import JointFit, fit, scattered
from geomid_ros.inference.selection import Selection
from geomid_ros.types import FloatArray

_ALONG = 0.5  # fraction of a channel's remainder, as RMS, that may lie along a hypothesis's columns


def posterior_probabilities(scores: Sequence[float] | FloatArray) -> FloatArray:
    """Probabilities ``(k,)`` of hypotheses, exactly one of which is true, from their ``scores (k,)``: minus twice the
    log evidence of each, its cost included."""
    weights = np.exp(-0.5 * (np.asarray(scores) - np.min(scores)))
    return np.asarray(weights / np.sum(weights))


def probability_of_square(square: float) -> float:
    """Largest probability that a size is not zero, if it is ``sqrt(square)`` standard deviations from zero. Within
    three of these it is no evidence."""
    return 1.0 / (1.0 + float(np.exp(-0.5 * np.clip(square - SIGNIFICANT_STDS**2, -1e3, 1e3))))


@dataclass(frozen=True, eq=False)
class Support:
    """Evidence for a hypothesis: the ``loss`` of score without it; ``relative_std``, the relative standard deviation of
    its size due to the remainder; the ``rivals``, each with the loss in its place, and its ``probability`` among all of
    these."""

    loss: float
    relative_std: float
    rivals: tuple[tuple[Candidate, float], ...]
    probability: float


class Supports:
    """Supports of the hypotheses of a fit that a ``selection`` ``found``."""

    def __init__(self, selection: Selection, found: JointFit) -> None:
        self.selection = selection
        self.found = found
        self._sized = scattered(selection.design, found)
        self._covariance = self._sized.covariance
        self.known: dict[str, dict[Any, Any]] = {}
        self._groups_of_odds: dict[float, set[Hashable]] = {}
        for hypothesis in selection.hypotheses:
            self._groups_of_odds.setdefault(hypothesis.odds, set()).add(hypothesis.group)

    def of(self, candidate: Candidate) -> Support:
        """Return the support of one hypothesis.

        Its absence is scored with a remainder estimated anew: what a free curve explains as well is no evidence for an
        effect. The adjusted loss is at most that of its size: the ratio of posterior and prior density at zero (Dickey,
        "The weighted likelihood ratio", 1971), with standard deviations from the scatter between blocks of time. Losses
        with rivals shrink by the same factor. Prior odds are corrected by how common such hypotheses are on this robot.
        """
        loss, worth, common = self.loss(candidate), self.adjusted_loss(candidate), self._common(candidate)
        rivals = self._rivals(self.selection.without(self.found, candidate), candidate)
        kept = max(worth, 0.0) / loss if loss > 0.0 else 1.0
        against = [worth + common, *(kept * worse + common - self._common(rival) for rival, worse in rivals)]
        ordered = tuple(sorted(rivals, key=lambda rival: rival[1]))
        return Support(loss, self.relative_std(candidate), ordered, float(posterior_probabilities([0.0, *against])[0]))

    def _common(self, candidate: Candidate) -> float:
        """Twice the log factor by which hypotheses like this one are more common than their prior odds: by the Beta
        distribution of these odds, as if seen once before, and the number of others found (Scott and Berger, "Bayes and
        empirical-Bayes multiplicity adjustment in the variable-selection problem", 2010)."""
        alike = self._groups_of_odds[candidate.odds]
        others = sum(c.group in alike for c in self.found.chosen if c.group != candidate.group)
        return 2.0 * float(np.log((1 + others) / (1.0 + candidate.odds * (len(alike) - 1 - others))))

    def adjusted_loss(self, candidate: Candidate) -> float:
        """Loss of score without it, if rows are dependent."""
        of_size = self._of_size(candidate)
        return min(self.loss(candidate), of_size) if of_size > 0.0 else of_size

    @remembered
    def loss(self, candidate: Candidate) -> float:
        """Loss of score without it; each fit uses the better of two remainders, estimated with and without the
        hypothesis."""
        selection, current = self.selection, self.found
        rest = selection.without(current, candidate)
        design = rest.with_fitted_remainder(selection.design, selection.design.affected_channels(candidate))
        both = [fit(design, selection.prior, joint_fit.chosen, joint_fit).score for joint_fit in (rest, current)]
        return min(rest.score, both[0]) - min(current.score, both[1])

    def _rivals(self, rest: JointFit, candidate: Candidate) -> list[tuple[Candidate, float]]:
        """Return the rivals in its place with their losses. These are exact for bodies and for rivals as good as this
        one, and from the score test for others. The same with another constant, and what contains it, are no rivals.
        The gain of a rival in addition to this one is added to its loss: only its advantage in this place counts."""
        selection, current = self.selection, self.found
        additional_gains = {trial.candidate: max(trial.gain, 0.0) for trial in selection.ranked(current)}
        losses = dict[Candidate, float]()
        for trial in selection.ranked(rest):
            rival, loss = trial.candidate, rest.score - trial.gain - current.score
            if rival.includes(candidate) or rival.payload is not None or not np.isfinite(loss):
                continue
            if loss < 0.0:  # the search has tried such exchanges, so the exact loss decides
                instead = selection.fit([*rest.chosen, rival], rest)
                loss = instead.score - current.score if selection.is_plausible(instead) else np.inf
            losses[rival] = loss + additional_gains.get(rival, 0.0)
        for instead in selection.rivals(current, candidate):
            replacements = [c for c in instead.chosen if c not in current.chosen and not c.includes(candidate)]
            if replacements:
                losses[replacements[0]] = instead.score - current.score + additional_gains.get(replacements[0], 0.0)
        return list(losses.items())

    def _of_size(self, candidate: Candidate) -> float:
        """Loss of score if its size is zero, from the size alone; for a body from mass and first moment, whose prior is
        almost flat."""
        current = self.found
        values, places = current.changes[candidate], _places(current, candidate)
        narrowed, covariance = 0.0, self._covariance[np.ix_(places, places)]
        if candidate.payload is not None:
            values, covariance = values[:4], self._sized.body_covariance(places[0] // 10)[:4, :4]
        else:
            narrowed = -float(np.linalg.slogdet(current.inverse[np.ix_(places, places)] * current.weights[places])[1])
        square = float(values @ np.linalg.solve(covariance, values))
        wider = 1.0 + self.relative_std(candidate) ** 2 * square  # of the covariance's determinant
        size, price = square / wider, narrowed - float(np.log(wider)) + candidate.cost
        return size - (price if size > SIGNIFICANT_STDS**2 else max(price, SIGNIFICANT_STDS**2))

    @remembered
    def relative_std(self, candidate: Candidate) -> float:
        """Relative standard deviation of its size due to the remainder."""
        values = self.found.changes[candidate]
        return relative_std_from_remainder(self.selection.design, self.found, candidate, values)


def relative_std_from_remainder(design: Design, found: JointFit, columns: Candidate | int, values: FloatArray) -> float:
    """Relative standard deviation, due to the remainder of a fit, of the ``values (k,)`` of a hypothesis's or a link's
    columns: a part of the remainder may lie along them.

    Least squares weight each channel by the power of these columns there; the channels' remainders may have one cause.
    """
    along = np.array([_ALONG**2 * lack.power for lack in found.remainders(design)])
    powers = np.maximum(design.powers(columns, values) / found.squares, 0.0)  # rounding may leave less
    error = float(np.sum(np.sqrt(along / found.squares * powers)))
    return error / max(float(np.sum(powers)), 1e-300)


def separability(design: Design, found: JointFit, candidate: Candidate) -> float:
    """Fraction of a hypothesis's columns, 0 to 1, that the other parameters of a fit cannot imitate within their prior
    and other recordings."""
    values, places = found.changes[candidate], _places(found, candidate)
    alone = np.zeros(found.manifold.dimension + 1)  # with the target's
    alone[places] = values
    products = design.gather(found.bodies, found.terms)
    pairs = zip(products.places, products.blocks, strict=True)
    squares = np.array([alone[columns] @ block @ alone[columns] for columns, block in pairs])
    information = float(values @ np.linalg.solve(found.covariance[np.ix_(places, places)], values))
    return float(np.clip(information / max(float(np.sum(design.counts / found.squares * squares)), 1e-300), 0.0, 1.0))


def _places(joint_fit: JointFit, candidate: Candidate) -> list[int]:
    """Indices ``(k,)`` of a hypothesis's parameters."""
    if candidate.payload is None:
        return [joint_fit.place(term) for term in candidate.terms]
    first = 10 * (joint_fit.manifold.links - len(joint_fit.bodies) + joint_fit.bodies.index(candidate.payload))
    return list(range(first, first + 10))
