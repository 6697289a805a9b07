"""Which set of candidates explains the gap: a greedy search with exact fits, elimination and exchange."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from geomid_ros.gap.design import Design
from geomid_ros.gap.fit import JointFit, Prior, fit, improvement
from geomid_ros.gap.library import Candidate

LEAST_GAIN = 12.0
"""A name that improves the score by less is not taken: e^-6 in probability."""
_SHORTLIST = 4
_PAYLOADS = 3
_EXCHANGES = 4
_LARGEST_GAIN_ERROR = 0.5  # beyond, it is no error of a sensor
_MOST_EFFECTS = 40


@dataclass(frozen=True)
class Trial:
    """A candidate's improvement of a fit by the score test, its penalty paid, and its separability."""

    candidate: Candidate
    gain: float
    separability: float


class Search:
    """Search over sets of candidates for one design."""

    def __init__(
        self, design: Design, prior: Prior, candidates: Sequence[Candidate], curves: Sequence[Candidate] = ()
    ) -> None:
        self.design = design
        self.prior = prior
        self.candidates = list(candidates)
        self.curves = list(curves)
        self._fits: dict[frozenset[Candidate], JointFit] = {}

    def fit(self, chosen: Sequence[Candidate], start: JointFit | None = None) -> JointFit:
        """The joint fit of a set; each set is fitted once."""
        key = frozenset(chosen)
        if key not in self._fits:
            self._fits[key] = fit(self.design, self.prior, chosen, start)
        return self._fits[key]

    def ranked(self, current: JointFit, among: Sequence[Candidate] | None = None) -> list[Trial]:
        """Candidates that could join, the best of each group, by the score test."""
        best: dict[tuple[str, int, int], Trial] = {}
        for candidate in self.candidates if among is None else among:
            if any(candidate.excludes(other) for other in current.chosen):
                continue
            gain, separability = improvement(self.design, current, candidate)
            if candidate.group not in best or gain > best[candidate.group].gain:
                best[candidate.group] = Trial(candidate, gain, separability)
        return sorted(best.values(), key=lambda trial: -trial.gain)

    def possible(self, found: JointFit) -> bool:
        """Whether no coefficient has a sign that it cannot have, and no gain is far from 1."""
        signs = all(found.value(term) > 0.0 for c in found.chosen for term in c.terms[: c.positives])
        gains = [found.value(c.terms[0]) for c in found.chosen if c.effect == "effort_gain"]
        return signs and all(abs(gain) < _LARGEST_GAIN_ERROR for gain in gains)

    def extended(self, current: JointFit, skip: tuple[str, int, int] | None = None) -> list[JointFit]:
        """Exact fits with one candidate more, the best first: those that the score test prefers, and payloads."""
        trials = [t for t in self.ranked(current) if t.gain > 0.5 * LEAST_GAIN and t.candidate.payload < 0]
        shortlist = [t.candidate for t in trials if t.candidate.group != skip][:_SHORTLIST]
        shortlist += [c for c in self._payloads if c.payload not in current.bodies and c.group != skip]
        fits = [self.fit([*current.chosen, candidate], current) for candidate in shortlist]
        return sorted((f for f in fits if self.possible(f)), key=lambda f: f.score)

    @cached_property
    def _payloads(self) -> list[Candidate]:
        """The payloads worth a trial. After the fit the score test says little of them: inertias that are nearly free,
        because the payload made all of them wrong, imitate it. So it is asked with the usual spread of the inertias."""
        firm = fit(self.design, self.prior, [], spread=self.prior.spread)
        payloads = [c for c in self.candidates if c.payload >= 0]
        trials = [trial for trial in self.ranked(firm, payloads) if trial.gain > 0.0]
        return [trial.candidate for trial in trials[:_PAYLOADS]]

    def without(self, current: JointFit, candidate: Candidate) -> JointFit:
        """The fit without one of its candidates."""
        return self.fit([c for c in current.chosen if c is not candidate], current)

    def grow(self, current: JointFit) -> JointFit | None:
        """The best set with one candidate more; None if nothing is worth it."""
        if len(current.chosen) >= _MOST_EFFECTS:
            return None
        fits = self.extended(current)
        return fits[0] if fits and current.score - fits[0].score > LEAST_GAIN else None

    def prune(self, current: JointFit) -> JointFit:
        """Without the candidates that are not worth their parameters, the least one first."""
        while current.chosen:
            losses = [(self.without(current, c).score - current.score, i) for i, c in enumerate(current.chosen)]
            loss, index = min(losses)
            if loss > LEAST_GAIN:
                break
            current = self.without(current, current.chosen[index])
        return current

    def rivals(self, current: JointFit, candidate: Candidate) -> list[JointFit]:
        """The best sets in which another name stands in the place of one candidate."""
        return self.extended(self.without(current, candidate), candidate.group)

    def add_curve(self, current: JointFit) -> JointFit | None:
        """The best set with one free curve more; None if none is worth its parameters."""
        trials = [trial for trial in self.ranked(current, self.curves) if trial.gain > LEAST_GAIN]
        fits = [self.fit([*current.chosen, trial.candidate], current) for trial in trials[:2]]
        best = min((f for f in fits if self.possible(f)), key=lambda f: f.score, default=None)
        return best if best is not None and current.score - best.score > LEAST_GAIN else None

    def instead(self, current: JointFit, candidate: Candidate) -> JointFit | None:
        """The best set in which a free curve at the same joint stands in the place of a name."""
        rest = self.without(current, candidate)
        trials = self.ranked(rest, [c for c in self.curves if c.joint == candidate.joint])
        if not trials or trials[0].gain < 0.0:
            return None
        return self.fit([*rest.chosen, trials[0].candidate], rest)

    def settle(self, current: JointFit) -> JointFit:
        """Grow, exchange and prune until nothing changes; then let the free curves compete for the rest."""
        for _ in range(_EXCHANGES):
            before = current.score
            while (larger := self.grow(current)) is not None:
                current = self.prune(larger)
            current = self.exchange(current)
            if current.score >= before - 1e-6:
                break
        return current

    def exchange(self, current: JointFit) -> JointFit:
        """Replace candidates, also by the same name with other constants, while that improves the score."""
        for candidate in current.chosen:
            rest = self.without(current, candidate)
            same = [c for c in self.candidates if c.group == candidate.group]
            others = [self.fit([*rest.chosen, t.candidate], rest) for t in self.ranked(rest, same)]
            others += self.rivals(current, candidate)
            better = [f for f in others if self.possible(f) and f.score < current.score - 1e-3]
            if better:
                return min(better, key=lambda f: f.score)
        return current
