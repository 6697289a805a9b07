"""Which set of candidates explains the gap: a greedy search with exact fits, elimination and exchange."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from geomid_ros.estimation.starting_point import USUAL_SPREAD_OF_LINKS
from geomid_ros.gap.candidates import AnyCandidate, Candidate, CurveCandidate
from geomid_ros.gap.evidence.design import Design
from geomid_ros.gap.fitting.fit import JointFit, fit
from geomid_ros.gap.fitting.prior import Prior
from geomid_ros.gap.search.score_test import Trial, score_tests
from geomid_ros.model.effects import Place, joints_of

Group: TypeAlias = tuple[str, Place] | tuple[str, int]

LEAST_GAIN = 12.0
"""A name that improves the score by less is not taken: e^-6 in probability."""
KEPT_PROMISE = 2.5
"""A name brings no more than so many times what the score test promises: of some 3,000 on measured robots none did."""
UNCHANGED = 1e-3
"""Of its uncertainty: how much may move what is as it was."""
_SHORTLIST = 4
_PAYLOADS = 3
_EXCHANGES = 4
_MOST_EFFECTS = 40
_PLAUSIBLE = 0.5  # of a name's loss: what the score test must promise of a rival that is tried in its place
_LET_GO = 2.0  # times the usual error of a link
_NEEDED = 5.0 * LEAST_GAIN  # a name whose loss is larger, by a quadratic estimate, need not be tried to be left out


class Search:
    """Search over sets of candidates for one design."""

    def __init__(
        self, design: Design, prior: Prior, candidates: Sequence[Candidate], curves: Sequence[CurveCandidate] = ()
    ) -> None:
        self.design = design
        self.prior = prior
        self.candidates = list(candidates)
        self._scouts = [c for c in self.candidates if c.scout]
        self.curves = list(curves)
        self._fits: dict[frozenset[AnyCandidate], JointFit] = {}
        self._payload_trials: dict[frozenset[AnyCandidate], list[Trial]] = {}
        self._unchanged: dict[AnyCandidate, Search] = {}
        self._excluded: dict[AnyCandidate, frozenset[AnyCandidate]] = {}
        self._contested_at: dict[AnyCandidate, float] = {}  # the score at which another may stand in its place

    def unchanged(self, candidate: AnyCandidate) -> Search:
        """The search in which what the model has of a candidate is as it was, and so is all that the model has at its
        joint; this one if it has nothing of the candidate.

        A name says that it has changed. Without the name it, and what is like it, may still drift in the search, which
        hides what a change is worth.
        """
        if not isinstance(candidate, Candidate) or not set(candidate.terms) & set(self.prior.terms):
            return self
        joints = set(joints_of(candidate.place))
        held = np.array([t in candidate.terms or not joints.isdisjoint(t.joints) for t in self.prior.terms])
        if candidate not in self._unchanged:
            prior = replace(self.prior, spreads=np.where(held, UNCHANGED, 1.0) * self.prior.spreads)
            self._unchanged[candidate] = Search(self.design, prior, self.candidates, self.curves)
        return self._unchanged[candidate]

    def fit(self, chosen: Sequence[AnyCandidate], start: JointFit | None = None) -> JointFit:
        """The joint fit of a set; each set is fitted once."""
        key = frozenset(chosen)
        if key not in self._fits:
            self._fits[key] = fit(self.design, self.prior, chosen, start)
        return self._fits[key]

    def ranked(self, current: JointFit, among: Sequence[AnyCandidate] | None = None) -> list[Trial]:
        """Candidates that could join, the best of each group, by the score test."""
        excluded = set[AnyCandidate]().union(*map(self._excluded_by, current.chosen))
        possible = [c for c in (self._scouts if among is None else among) if c not in excluded]
        best: dict[Group, Trial] = {}
        for trial in score_tests(self.design, current, possible):
            group = trial.candidate.group
            if group not in best or trial.gain > best[group].gain:
                best[group] = trial
        return sorted(best.values(), key=lambda trial: -trial.gain)

    def _excluded_by(self, chosen: AnyCandidate) -> frozenset[AnyCandidate]:
        """The candidates that make no sense beside one that is chosen."""
        if chosen not in self._excluded:
            every: list[AnyCandidate] = [*self.candidates, *self.curves]
            self._excluded[chosen] = frozenset(c for c in every if c.excludes(chosen))
        return self._excluded[chosen]

    def possible(self, found: JointFit) -> bool:
        """Whether no coefficient has a sign or a size that it cannot have, and no payload outweighs the robot."""
        return not any(self.is_absurd(found, candidate) for candidate in found.chosen)

    def without_absurd(self, current: JointFit) -> JointFit:
        """Without the candidates that cannot be, one after the other, or with simpler names in their places."""
        while absurd := [c for c in current.chosen if self.is_absurd(current, c)]:
            current = min((f for c in absurd for f in self._simpler(current, c)), key=lambda f: f.score)
        return current

    def _simpler(self, current: JointFit, candidate: AnyCandidate) -> list[JointFit]:
        """The fit without a candidate, and those with a name that is a special case of it."""
        rest = self.without(current, candidate)
        contained = candidate.effect.contains if isinstance(candidate, Candidate) else ""
        special = [c for c in self.candidates if c.name == contained and c.joint == candidate.joint]
        return [rest, *(self.fit([*rest.chosen, c], rest) for c in special)]

    def is_absurd(self, found: JointFit, candidate: AnyCandidate) -> bool:
        """Whether a candidate has a sign or a size that it cannot have."""
        if isinstance(candidate, CurveCandidate):
            return False
        if candidate.payload is not None:
            place = len(self.prior.inertias) // 10 + found.bodies.index(candidate.payload)
            return bool(found.point.pseudo_inertias[place, 3, 3] > np.sum(self.prior.inertias[::10]))
        values = np.array([found.value(term) for term in candidate.terms])
        return bool(np.any(values[: candidate.positives] <= 0.0)) or candidate.effect.is_absurd(values)

    def let_go(self, found: JointFit) -> set[int]:
        """The links of which a fit says that they are wrong by much more than usual, and than drawings are."""
        usual = max(self.prior.spread, USUAL_SPREAD_OF_LINKS)
        return set(np.flatnonzero(found.spreads > _LET_GO * usual).tolist())

    def _promising(self, current: JointFit, least: float, instead_of: AnyCandidate | None = None) -> list[Trial]:
        """The candidates that are worth an exact fit: those that the score test prefers, and payloads; none of which it
        promises less than ``least``."""
        skip = None if instead_of is None else instead_of.group
        imitable = not isinstance(instead_of, Candidate) or instead_of.effect.like_a_payload
        trials = [t for t in self.ranked(current) if t.gain > least and t.candidate.payload is None]
        trials = [t for t in trials if t.candidate.group != skip][:_SHORTLIST]
        if not current.bodies and imitable:
            trials += [t for t in self._payloads(current) if t.gain > least and t.candidate.group != skip]
        return trials

    def _payloads(self, current: JointFit) -> list[Trial]:
        """The payloads worth a trial. After the fit the score test says little of them: inertias that are nearly free,
        because the payload made all of them wrong, imitate it. So it is asked with the usual spread of the inertias."""
        key = frozenset(current.chosen)
        if key not in self._payload_trials:
            firm = fit(self.design, self.prior, current.chosen, current, self.prior.link_spreads)
            trials = self.ranked(firm, [c for c in self.candidates if c.payload is not None])
            self._payload_trials[key] = [trial for trial in trials if trial.gain > 0.0][:_PAYLOADS]
        return self._payload_trials[key]

    def without(self, current: JointFit, candidate: AnyCandidate) -> JointFit:
        """The fit without one of its candidates."""
        return self.fit([c for c in current.chosen if c is not candidate], current)

    def grow(self, current: JointFit) -> JointFit | None:
        """The best set with one candidate more; None if nothing is worth it."""
        if len(current.chosen) >= _MOST_EFFECTS:
            return None
        best: JointFit | None = None
        for trial in sorted(self._promising(current, 0.5 * LEAST_GAIN), key=lambda t: -t.gain):
            if best is not None and KEPT_PROMISE * trial.gain < current.score - best.score:
                break
            larger = self.fit([*current.chosen, trial.candidate], current)
            if self.possible(larger) and (best is None or larger.score < best.score):
                best = larger
        return best if best is not None and current.score - best.score > LEAST_GAIN else None

    def prune(self, current: JointFit, among: Sequence[AnyCandidate] | None = None) -> JointFit:
        """Without the candidates (those ``among`` these, unless all) that are not worth their parameters, the least one
        first."""
        among = current.chosen if among is None else among
        while doubtful := [c for c in current.chosen if c in among and self._estimated_loss(current, c) < _NEEDED]:
            smaller = min((self.without(current, c) for c in doubtful), key=lambda f: f.score)
            if smaller.score - current.score > LEAST_GAIN:
                break
            current = smaller
        return current

    def _estimated_loss(self, current: JointFit, candidate: AnyCandidate) -> float:
        """By how much the score is worse without a candidate, to second order, its penalty not counted; 0 for a
        payload, whose loss is not nearly quadratic."""
        if candidate.payload is not None:
            return 0.0
        places = [current.place(term) for term in candidate.terms]
        values = np.array([current.value(term) - self.prior.value(term) for term in candidate.terms])
        squared = float(values @ np.linalg.solve(current.covariance[np.ix_(places, places)], values))
        count = float(np.max(self.design.counts))
        return count * float(np.log1p(squared / count))

    def rivals(self, current: JointFit, candidate: AnyCandidate) -> list[JointFit]:
        """The best sets in which another name stands in the place of one candidate, the best first."""
        rest = self.without(current, candidate)
        least = max(0.5 * LEAST_GAIN, _PLAUSIBLE * (rest.score - current.score))
        fits = [self.fit([*rest.chosen, t.candidate], rest) for t in self._promising(rest, least, candidate)]
        return sorted((f for f in fits if self.possible(f)), key=lambda f: f.score)

    def gains_instead(self, current: JointFit, candidate: AnyCandidate) -> JointFit | None:
        """The set in which the gains of all joints' efforts stand in the place of a payload: where all have changed
        alike, a body that weighs more looks the same but for friction and inertia; None of any other name."""
        gains = [c for c in self.candidates if c.effect.scales_measurement]
        if not isinstance(candidate, Candidate) or candidate.payload is None or not gains:
            return None
        rest = [c for c in current.chosen if c is not candidate and c not in gains]
        return self.fit([*rest, *gains], current)

    def add_curve(self, current: JointFit) -> JointFit | None:
        """The best set with one free curve more; None if none is worth its parameters."""
        trials = [trial for trial in self.ranked(current, self.curves) if trial.gain > LEAST_GAIN]
        fits = [self.fit([*current.chosen, trial.candidate], current) for trial in trials[:2]]
        best = min((f for f in fits if self.possible(f)), key=lambda f: f.score, default=None)
        return best if best is not None and current.score - best.score > LEAST_GAIN else None

    def instead(self, current: JointFit, candidate: Candidate) -> JointFit | None:
        """The best set in which free curves at the same joint, or at each of the same joints, stand in the place of a
        name; None if none would help."""
        rest = self.without(current, candidate)
        curves = []
        for joint in joints_of(candidate.place):
            trials = self.ranked(rest, [c for c in self.curves if c.joint == joint])
            curves += [trial.candidate for trial in trials[:1] if trial.gain >= 0.0]
        return self.fit([*rest.chosen, *curves], rest) if curves else None

    def settle(self, current: JointFit, to_the_end: bool = False) -> JointFit:
        """Grow, exchange and prune until nothing changes, or, unless ``to_the_end``, until a name is found that changes
        all columns."""
        known = _turns(current)
        for _ in range(_EXCHANGES):
            before = current.score
            while (larger := self.grow(current)) is not None:
                current = self.prune(larger)
                if _turns(current) - known and not to_the_end:
                    return current
            current = self.exchange(current)
            if current.score >= before - 1e-6:
                break
        return current

    def simplified(self, current: JointFit) -> JointFit:
        """With simpler names in the places of those that contain them, where that costs less than a name is worth."""
        for candidate in current.chosen:
            simpler = [f for f in self._simpler(current, candidate)[1:] if self.possible(f)]
            best = min(simpler, key=lambda f: f.score, default=None)
            if best is not None and best.score - current.score < LEAST_GAIN:
                current = best
        return current

    def neighbours(self, candidate: AnyCandidate) -> list[Candidate]:
        """The same name with the next smaller and the next larger of its scanned constant, where there are such."""
        if not isinstance(candidate, Candidate) or not candidate.effect.scanned:
            return []
        alike = sorted((c for c in self.candidates if c.group == candidate.group), key=lambda c: c.effect.scanned)
        place = alike.index(candidate)
        return [*alike[max(place - 1, 0) : place], *alike[place + 1 : place + 2]]

    def exchange(self, current: JointFit) -> JointFit:
        """Replace candidates one after the other, also by the same name with other constants, where that improves the
        score. One that led all others is tried again once the search has gained as much as it led by."""
        for candidate in current.chosen:
            if candidate not in current.chosen or current.score > self._contested_at.get(candidate, np.inf):
                continue
            others = [f for f in self._exchanged(current, candidate) if candidate not in f.chosen and self.possible(f)]
            best = min([current, *others], key=lambda f: f.score)
            if best.score < current.score - 1e-3:
                current = best
            else:
                self._contested_at[candidate] = current.score - self._lead(current, candidate, others)
        return current

    def _lead(self, current: JointFit, candidate: AnyCandidate, others: Sequence[JointFit]) -> float:
        """By how much a candidate leads the fits with ``others`` in its place, and those that were not plausible, none
        of which promised to make up for so much of its loss."""
        loss = self.without(current, candidate).score - current.score
        return min([(1.0 - _PLAUSIBLE) * loss, *(other.score - current.score for other in others)])

    def _exchanged(self, current: JointFit, candidate: AnyCandidate) -> list[JointFit]:
        """The fits with others in the place of one candidate."""
        rest = self.without(current, candidate)
        same = [c for c in self.candidates if c.group == candidate.group]
        others = [self.fit([*rest.chosen, t.candidate], rest) for t in self.ranked(rest, same)]
        others += [self.fit([*rest.chosen, c], current) for c in self.neighbours(candidate)]
        return [*others, *self.rivals(current, candidate), *filter(None, [self.gains_instead(current, candidate)])]


def _turns(found: JointFit) -> set[str]:
    """The names of a fit whose size all other columns depend on."""
    return {c.name for c in found.chosen if isinstance(c, Candidate) and c.effect.far}
