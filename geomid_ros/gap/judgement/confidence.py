"""How sure a name is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.gap.candidates import Candidate
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.gap.judgement.blocks import generalises
from geomid_ros.gap.judgement.closing import CONFIDENT_RIVAL, Closing, contains, is_identified, is_open, open_curves
from geomid_ros.gap.judgement.held_out import HeldOut
from geomid_ros.gap.result import Confidence, Rival
from geomid_ros.gap.search.analysis import Analysis
from geomid_ros.gap.search.beam_search import Search
from geomid_ros.model.effects import EFFECTS, Quantity, joints_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.moving import SIGN
from geomid_ros.types import FloatArray

CONFIDENT_LOSS = 20.0
CONFIDENT_BESIDE_UNEXPLAINED = 200.0
"""Where something is left that has no name, small names may be its shadow."""
CONFIDENT_IN_THE_SHADE = 100.0
"""Of a name whose share of the gap is small because another one's is so large."""
CONFIDENT_SHARE = 0.03
BESIDE_A_GEAR = 0.25
"""Of the loss of an effect that is known to first order only: smaller names may be what that leaves of it."""
DOMINANT_LOSS = 200.0
DOMINANT_SHARE = 0.3
"""A name of the whole robot is sure in spite of what it leaves only if it matters so much more."""
LEAST_RISE = 1.05
"""Without a name that is sure, the remainder of some channel is so many times larger; payloads apart."""
LEAST_OTHER_WAY = 0.05
_SURE_OF_SIZE = 3.0  # standard deviations
_SURE_OF_CHANGE = 3.0  # the same


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """What speaks for one name of an ``analysis``, which is judged on what was fitted and on ``unseen`` data.

    ``loss``: by how much the score is worse without it; ``rivals``: other names in its place.
    """

    model: MeasurementModel
    analysis: Analysis
    unseen: HeldOut
    candidate: Candidate
    rivals: Sequence[Rival]
    loss: float

    @cached_property
    def closing(self) -> Closing:
        """What it closes of unseen data."""
        return Closing(self.analysis, self.unseen, self.candidate)

    @property
    def whole(self) -> JointFit:
        """The fit in which it is judged."""
        return self.closing.beside

    @property
    def joint(self) -> str:
        """The name of its place."""
        return self.model.places.name(self.candidate.place)

    @property
    def _search(self) -> Search:
        return self.analysis.search.unchanged(self.candidate)

    def confidence(self, parameters: dict[str, Quantity]) -> Confidence:
        """How sure the name with these ``parameters`` is."""
        if self._is_ambiguous:
            return "ambiguous"
        if self._is_weak or self._is_small or self._is_as_known:
            return "tentative"
        if self._is_beside_unexplained or self._is_hidden_by_others:
            return "tentative"
        if self._may_be_nothing(parameters) or self.closing.is_outdone:
            return "tentative"
        # Where the floor is reached the score can be trusted; else it takes errors of the model for noise.
        design, prior = self.analysis.search.design, self.analysis.search.prior
        sure = self.closing.is_all or (generalises(design, self.whole, self.candidate, prior) and self.closing.predicts)
        return "confident" if sure else "tentative"

    def _may_be_nothing(self, parameters: dict[str, Quantity]) -> bool:
        """Whether a payload may weigh nothing; or all sizes of a name be those of no effect, unless the model has it
        and it may have come to nothing."""
        if self.candidate.payload is not None:
            return not parameters["mass"].value > _SURE_OF_SIZE * parameters["mass"].std
        if set(self.candidate.terms) <= set(self.analysis.search.prior.terms):
            return False
        effect = self.candidate.effect
        sizes = effect.sizes(parameters).values()
        return all(abs(size.value - effect.nothing) <= _SURE_OF_SIZE * size.std for size in sizes)

    @property
    def _is_ambiguous(self) -> bool:
        return any(rival.loss < CONFIDENT_RIVAL for rival in self._others) or self._rests_on_prior

    @cached_property
    def _others(self) -> list[Rival]:
        """The rivals but for one that contains the name: that fits as well by nature, but better only where needed.
        Where something is left scores do not say so: a name that dominates is the larger part of what contains it."""
        open_here = bool(np.any(is_open(self.unseen)[list(joints_of(self.candidate.place))]))
        return [
            rival
            for rival in self.rivals
            if (EFFECTS[rival.effect].contains, rival.joint) != (self.candidate.name, self.joint)
            or (not self.closing.dominates if open_here else rival.loss < 0.0)
        ]

    @property
    def _rests_on_prior(self) -> bool:
        """Whether a payload is preferred to wrong inertias only by how likely the latter were thought, where that is a
        guess: without it the inertias reach the same remainder."""
        guessed = not is_identified(self.analysis)
        return self.candidate.payload is not None and guessed and self._rise < LEAST_RISE

    @cached_property
    def _margin(self) -> float:
        """By how much the score is worse with anything else in its place, or nothing."""
        return min([self.loss, *(rival.loss for rival in self._others), self._margin_to_curves])

    @property
    def _margin_to_curves(self) -> float:
        """By how much the score is worse with free curves in its place. Those that contain it fit as well by nature,
        but better only where it is not enough."""
        whole, instead = self.whole, self._search.instead(self.whole, self.candidate)
        if instead is None:
            return np.inf
        rest, loss = self._search.without(whole, self.candidate), instead.score - whole.score
        curves = [c for c in instead.chosen if c not in whole.chosen]
        enough = loss >= 0.0 and all(contains(self.analysis, rest, curve, self.candidate) for curve in curves)
        return np.inf if enough or all(map(self.closing.is_varied_by, curves)) else loss

    @property
    def _is_weak(self) -> bool:
        clear = self.closing.dominates or self.closing.is_settled
        beside_unexplained = CONFIDENT_IN_THE_SHADE if clear else CONFIDENT_BESIDE_UNEXPLAINED
        least = CONFIDENT_LOSS if self.closing.is_all else beside_unexplained
        beside_gear = BESIDE_A_GEAR * self._largest_gear_loss
        return self.loss < least or self._margin < CONFIDENT_RIVAL or self.loss < beside_gear

    @property
    def _is_as_known(self) -> bool:
        """Whether what the model had may have been as wrong as the change is large."""
        prior, names, candidate = self.analysis.search.prior, self.analysis.names, self.candidate
        if not candidate.terms or not set(candidate.terms) <= set(prior.terms):
            return False
        forms = candidate.effect.parameters[: len(candidate.terms)]
        places = [prior.terms.index(term) for term in candidate.terms]
        had = {form.name: float(prior.values[place]) for form, place in zip(forms, places, strict=False)}
        expected = candidate.effect.behind_gain(had, self._gain).values()
        return all(
            abs(names.value(term) - value) < _SURE_OF_CHANGE * prior.spreads[place] / self._gain
            for term, place, value in zip(candidate.terms, places, expected, strict=False)
        )

    @property
    def _gain(self) -> float:
        """The gain that was found at its joint; 1 without."""
        names = self.analysis.names
        gains = [
            float(c.effect.transformed(np.array([names.value(c.terms[0])]))[0][0])
            for c in names.chosen
            if isinstance(c, Candidate) and c.effect.scales_measurement and c.place == self.candidate.place
        ]
        return gains[0] if gains and not self.candidate.effect.scales_measurement else 1.0

    @property
    def _is_small(self) -> bool:
        return self.candidate.payload is None and self._rise < LEAST_RISE

    @property
    def _is_beside_unexplained(self) -> bool:
        """Whether what is left without a name is at its joint; of a name of the whole robot: anywhere, unless the name
        matters much more."""
        if self.closing.is_all or self.closing.dominates or self.closing.is_settled:
            return False
        if not joints_of(self.candidate.place):
            return self._margin < DOMINANT_LOSS or self.share < DOMINANT_SHARE
        return any(
            curve.joint in joints_of(self.candidate.place) or curve.variable == self.joint
            for curve in open_curves(self.analysis, self.unseen)
        )

    @property
    def _is_hidden_by_others(self) -> bool:
        """Whether it may be what the larger names lack. Errors of these make differences of scores larger than they
        are: a name that leaves little beside them has to be as much surer of its rivals as of its loss."""
        if self.share >= CONFIDENT_SHARE:
            return False
        surer = CONFIDENT_IN_THE_SHADE / CONFIDENT_LOSS
        clears = self.closing.dominates or self.closing.is_settled
        clear = self.closing.is_all or (clears and self._margin > surer * CONFIDENT_RIVAL)
        return not (clear and self.loss > CONFIDENT_IN_THE_SHADE)

    @property
    def _largest_gear_loss(self) -> float:
        """Of the other names, those that are known to first order only; 0 if there are none."""
        whole, search = self.whole, self.analysis.search
        gears = [c for c in whole.chosen if isinstance(c, Candidate) and c.effect.first_order]
        losses = [search.without(whole, gear).score - whole.score for gear in gears if gear is not self.candidate]
        return max(losses, default=0.0)

    @cached_property
    def share(self) -> float:
        """Of the gap that the inertias leave, above the floor, over the channels that it reaches: how much the name
        closes beside the others."""
        whole, reached = self.whole, self.closing.reached
        without = self._squares_without
        closed = np.sum(((without - whole.squares) / whole.squares)[reached])
        gap = np.sum((np.maximum(self.analysis.bare.squares, without) / whole.squares - 1.0)[reached])
        return float(np.clip(closed / max(float(gap), 1e-300), 0.0, 1.0))

    @property
    def _squares_without(self) -> FloatArray:
        """Sums of squares ``(C,)`` without the name. Without a payload on an identified robot the inertias are those
        that are known: fitted ones would take its place."""
        whole, search = self.whole, self._search
        if self.candidate.payload is None or not is_identified(self.analysis):
            return search.without(whole, self.candidate).squares
        known = whole.point.parameters.copy()
        known[whole.manifold.inertial] = 0.0
        known[: len(search.prior.inertias)] = search.prior.inertias
        vector, products = np.append(known, -1.0), search.design.gather(whole.bodies, whole.terms)
        return np.asarray(np.einsum("cij,i,j->c", products, vector, vector))

    @property
    def _rise(self) -> float:
        """Factor by which the remainder of the channel that is concerned most grows without the name."""
        whole = self.whole
        without = self._search.without(whole, self.candidate)
        return float(np.sqrt(np.max(without.squares / whole.squares)))


def moves_one_way(analysis: Analysis, joint: int) -> bool:
    """Whether a joint hardly ever moves to the other side at the instants that are used."""
    problem = analysis.problem
    signs = problem.records.samples.column(SIGN)[problem.valid[:, joint], joint]
    return float(min(np.mean(signs > 0.0), np.mean(signs < 0.0))) < LEAST_OTHER_WAY
