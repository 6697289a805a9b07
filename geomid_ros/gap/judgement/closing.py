"""What a name closes of the gap: of the data that were fitted, and of unseen ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.estimation.fit import CERTAINTY
from geomid_ros.gap.candidates import AnyCandidate, Candidate, CurveCandidate
from geomid_ros.gap.fitting.fit import JointFit, fit
from geomid_ros.gap.judgement.held_out import HeldOut
from geomid_ros.gap.search.analysis import Analysis
from geomid_ros.gap.search.score_test import score_test
from geomid_ros.model.effects import joints_of
from geomid_ros.types import BoolArray, FloatArray

DOMINATING = 8.0
"""A name that closes so many times what is left of unseen data, where it acts, is no shadow of what is left."""
REACHED = 1.15
"""A channel whose remainder is below this times the floor has reached it."""
CONFIDENT_RIVAL = 12.0
"""By how much the score is worse with another name in the place of one that is sure."""
LEAST_PREDICTED = 0.5
"""Share of the gap of unseen data that a sure name closes where something is left."""
_ALONG = 0.5
"""Share of what is left without a name, as a root mean square, that may lie along a name's columns."""
_CONTAINED = 0.1
"""Of what nothing else imitates of a name: a curve beside which less is left contains it."""


@dataclass(frozen=True, eq=False)
class Closing:
    """What a ``candidate`` of an ``analysis`` closes of ``unseen`` data, over the channels that it reaches."""

    analysis: Analysis
    unseen: HeldOut
    candidate: Candidate

    @cached_property
    def reached(self) -> list[int]:
        """The channels that it can change."""
        return self.analysis.search.design.reached(self.candidate)

    @cached_property
    def is_all(self) -> bool:
        """Whether nothing at all is left open of unseen data, some of which it reaches."""
        return self._is_judged and not (open_curves(self.analysis, self.unseen) or np.any(is_open(self.unseen)))

    @cached_property
    def dominates(self) -> bool:
        """Whether little is left of what it closes."""
        return self._is_judged and self.closed > DOMINATING * self._left

    @cached_property
    def is_settled(self) -> bool:
        """Whether at its joints nothing is left open, or curves say what it is on unseen data, too. A name of the whole
        robot changes all columns, and may be what makes room for the curves."""
        of_joints = bool(joints_of(self.candidate.place))
        left = is_above(self.unseen, self.unseen.with_curves, REACHED)[self.reached]
        return of_joints and self._is_judged and not np.any(left)

    @cached_property
    def beside(self) -> JointFit:
        """The fit in which it is judged: the names with the curves that they leave room for. A name that dominates is
        no shadow of what these say: one that lets its size vary, beside which it would bring nothing, is left out."""
        found, search = self.analysis.whole, self.analysis.search.unchanged(self.candidate)
        for curve in found.chosen:
            if self.is_varied_by(curve):
                found = search.without(found, curve)
        return found

    def is_varied_by(self, curve: AnyCandidate) -> bool:
        """Whether a curve says of a name that dominates only that its size is not the same everywhere."""
        if not isinstance(curve, CurveCandidate) or not curve.dry or curve.joint != self.candidate.joint:
            return False
        return bool(np.any(self.candidate.effect.dry_friction(1.0, np.zeros(1)))) and self.dominates

    @cached_property
    def predicts(self) -> bool:
        """Whether it closes enough of the gap."""
        expected = self.unseen.gap.expected[self.reached]
        gap = np.nansum(np.maximum(self._squares_without - expected**2, 0.0))
        return bool(self.closed > LEAST_PREDICTED * gap)

    @property
    def is_outdone(self) -> bool:
        """Whether another name in its place is about as likely by all data, the fitted and the unseen. One that
        contains it is another matter; and so is a payload, whose place fitted inertias would take beside another name.
        """
        if self.candidate.payload is not None:
            return False
        names, search = self.analysis.names, self.analysis.search.unchanged(self.candidate)
        for found in search.rivals(names, self.candidate):
            (rival,) = (c for c in found.chosen if isinstance(c, Candidate) and c not in names.chosen)
            if rival.effect.contains == self.candidate.name:
                continue
            if found.score - names.score + self._worse_unseen(found) < CONFIDENT_RIVAL:
                return True
        return False

    def _worse_unseen(self, found: JointFit) -> float:
        """By how much the score of unseen data is worse with another fit."""
        counts, after = self.unseen.counts[self.reached], self.unseen.gap.after[self.reached]
        return float(np.nansum(counts * np.log(self.unseen.times_floor(found)[self.reached] ** 2 / after**2)))

    @cached_property
    def closed(self) -> float:
        """What it closes, in squares of the floor."""
        return _closed(self.unseen, self.reached, self._squares_without)

    @cached_property
    def doubt(self) -> float:
        """Which share of its size, as a standard deviation, may be a part of what has no name; none where nothing is
        left anywhere."""
        return 0.0 if self.is_all else part_of_remainder(self.unseen, self.reached, self._squares_without)

    @property
    def _is_judged(self) -> bool:
        return bool(np.any(self.unseen.counts[self.reached] > 0.0))

    @property
    def _left(self) -> float:
        return _left(self.unseen, self.reached)

    @cached_property
    def _squares_without(self) -> FloatArray:
        smaller = without(self.analysis, self.analysis.names, self.candidate)
        return np.asarray(self.unseen.times_floor(smaller)[self.reached] ** 2)


def without(analysis: Analysis, found: JointFit, candidate: Candidate) -> JointFit:
    """A fit without a name. What the model has of it is as it was; and so are, without a payload, the inertias of a
    robot that was identified: fitted ones would take its place."""
    search = analysis.search
    if candidate.payload is not None and is_identified(analysis):
        rest = [c for c in found.chosen if c is not candidate]
        return fit(search.design, search.prior, rest, found, search.prior.link_spreads)
    return search.unchanged(candidate).without(found, candidate)


def contains(analysis: Analysis, rest: JointFit, curve: AnyCandidate, candidate: Candidate) -> bool:
    """Whether a curve beside the ``rest`` leaves hardly anything of a name that nothing else imitates."""
    search = analysis.search.unchanged(candidate)
    larger = search.fit([*rest.chosen, curve], rest)
    own, left = (score_test(search.design, each, candidate).separability for each in (rest, larger))
    return left < _CONTAINED * own


def is_identified(analysis: Analysis) -> bool:
    """Whether the inertias were identified before, not guessed."""
    return analysis.search.prior.certainty > CERTAINTY


def open_curves(analysis: Analysis, unseen: HeldOut) -> list[CurveCandidate]:
    """The free curves for which unseen data leave room."""
    room = is_above(unseen, unseen.gap.after, 1.0)
    return [c for c in analysis.whole.chosen if isinstance(c, CurveCandidate) and room[c.joint]]


def part_of_remainder(unseen: HeldOut, channels: Sequence[int], without: FloatArray) -> float:
    """Which share of a size, as a standard deviation, may be a part of what has no name, if the channels' squares are
    so large ``without`` it, in squares of the floor."""
    closed = _closed(unseen, channels, without)
    return min(1.0, _ALONG * float(np.sqrt(_left(unseen, channels) / closed))) if closed > 0.0 else 1.0


def _closed(unseen: HeldOut, channels: Sequence[int], without: FloatArray) -> float:
    return float(np.nansum(without - unseen.gap.after[channels] ** 2))


def _left(unseen: HeldOut, channels: Sequence[int]) -> float:
    """What may be left beyond noise and the uncertainty of all that was fitted: no less than a channel may have that
    counts as closed."""
    after, expected = unseen.gap.after[channels], unseen.gap.expected[channels]
    return float(np.nansum(np.maximum(after, REACHED * expected) ** 2 - expected**2))


def is_open(unseen: HeldOut) -> BoolArray:
    """The channels ``(C,)`` whose gap on unseen data is larger than noise and the uncertainty of all that was fitted
    explain."""
    return is_above(unseen, unseen.gap.after, REACHED)


def is_above(unseen: HeldOut, left: FloatArray, times: float) -> BoolArray:
    """The channels ``(C,)`` of which so much is ``left (C,)``, in floors."""
    # A standard deviation from n values is itself uncertain by 1 / sqrt(2 n), relative.
    reached = times * (1.0 + 2.0 / np.sqrt(2.0 * np.maximum(unseen.counts, 1.0))) * unseen.gap.expected
    return np.asarray(np.nan_to_num(left) >= np.nan_to_num(reached, nan=np.inf))
