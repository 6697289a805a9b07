"""Search for hypotheses that explain the data: added by Rao's score test, which needs no fit, then fitted exactly,
exchanged, and pruned."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from geomid_ros.estimation.tolerances import SHORTLIST
from geomid_ros.inference.candidates import Candidate
from geomid_ros.inference.design import CandidateProducts, Design, remembered
from geomid_ros.inference.fit import JointFit, fit
from geomid_ros.inference.prior import Prior
from geomid_ros.types import BoolArray, FloatArray, IntArray

_LEAST_EIGENVALUE = 1e-7  # columns with a smaller remaining part are a combination of the others
_DIRECTIONS_OF_BODY = 4.0  # mass and centre; the data hardly constrain its inertia
_EVERY = -1  # in place of a limb: affects several, or none
_LEAST_LEFT = 1e-3  # fraction of a channel's squares that remains: bounds the promise of the quadratic model


class ScoreTest(NamedTuple):
    """Score test of a candidate: ``gain``, its improvement of a fit less its cost, and ``separability``, the fraction
    of its columns that the other parameters, within their prior, cannot imitate."""

    candidate: Candidate
    gain: float
    separability: float


def score_tests(design: Design, current: JointFit, candidates: Sequence[Candidate]) -> list[ScoreTest]:
    """Compute by how much each candidate would improve the current fit, to second order.

    For fixed weights the step and the gain are those of the Gaussian model (Rao's score test); the gain is then taken
    from the sums of squares after the step. Candidates of a limb with equally many columns are tested at once.
    """
    limbs, tests, covariance = _limbs(current), dict[int, _Test](), current.covariance
    limb_of_column = np.append(limbs, _EVERY)  # last: a channel with nothing but the target
    of_channel = [limb_of_column[places[0]] for places in design.gather(current.bodies, current.terms).places]
    by_kind: dict[tuple[int, int], list[Candidate]] = {}
    for candidate in candidates:
        reached = {of_channel[channel] for channel in design.affected_channels(candidate)}
        limb = reached.pop() if len(reached) == 1 else _EVERY
        by_kind.setdefault((limb, len(candidate.terms)), []).append(candidate)
    trials: dict[Candidate, ScoreTest] = {}
    for (limb, _), group in by_kind.items():
        if limb not in tests:
            tests[limb] = _Test(design, current, covariance, np.flatnonzero((limbs == limb) | (limb == _EVERY)))
        trials |= tests[limb].of(group)
    return [trials[candidate] for candidate in candidates]


def _limbs(current: JointFit) -> IntArray:
    """Label of each parameter ``(D,)``: the first one that rows or priors connect it with, directly or through others.
    Limbs that share no link, such as an arm and a leg, do not inform on each other."""
    connected = current.information != 0.0
    first = np.arange(len(connected))
    connected[current.manifold.links_blocks] = True
    before = first + 1
    while not np.array_equal(first, before):
        before, first = first, np.min(np.where(connected, first, len(first)), axis=1)
    return first


class _Test:
    """Data that the score tests at one fit share: G candidates of k columns, in the C channels that depend on some of D
    parameters and on no others."""

    def __init__(self, design: Design, current: JointFit, covariance: FloatArray, parameters: IntArray) -> None:
        self._design = design
        self._current = current
        self._columns = np.append(parameters, len(covariance))  # with the target's
        self._vector = np.append(current.point.parameters, -1.0)[self._columns]
        self._covariance = covariance[parameters[:, None], parameters]
        products = design.gather(current.bodies, current.terms)
        place = np.full(products.size, -1)
        place[self._columns] = np.arange(len(self._columns))
        self._channels = [c for c, places in enumerate(products.places) if place[places[0]] >= 0]
        self._counts, self._squares = design.counts[self._channels], current.squares[self._channels]
        self._weights = self._counts / self._squares
        self._by_channel = [(place[products.places[c]], products.blocks[c]) for c in self._channels]
        self._moved = np.zeros((len(self._channels), len(self._vector)))
        for row, (places, block) in zip(self._moved, self._by_channel, strict=True):
            row[places] = block @ self._vector[places]
        self._values = dict(zip(current.terms, current.point.reals.tolist(), strict=True))

    def of(self, alike: Sequence[Candidate]) -> dict[Candidate, ScoreTest]:
        """Compute the score tests of candidates with equally many columns."""
        places = self._design.places(self._current.bodies, self._current.terms)
        products = self._design.candidate_products(
            alike, {channel: places[channel, self._columns] for channel in self._channels}
        )
        trust = self._trust(alike)
        crossed = np.zeros((*trust.shape, len(self._vector)))
        squared = np.zeros((*trust.shape, trust.shape[1]))
        for channel, weight in zip(products, self._weights, strict=True):
            crossed[channel.which] += weight * channel.crossed
            squared[channel.which] += weight * channel.squared
        flat = crossed.reshape(-1, len(self._vector))  # one matrix product for all candidates
        solved = (flat[:, :-1] @ self._covariance).reshape(*trust.shape, -1)
        separate_part = squared - crossed[..., :-1] @ solved.swapaxes(1, 2)
        precision = separate_part + trust[:, :, None] * np.eye(trust.shape[1])
        step, largest = _steps((flat @ self._vector).reshape(trust.shape), squared, separate_part, precision)
        energy = np.einsum("gk,gkl,gl->g", step, squared, step)
        separate_energy = np.einsum("gk,gkl,gl->g", step, separate_part, step)
        gain = self._gain(products, step, -(step[:, None] @ solved)[:, 0])
        gain -= energy - separate_energy  # the quadratic term of the others' step
        separability = np.divide(separate_energy, energy, out=np.zeros_like(energy), where=energy > 0.0)
        separability[largest <= _LEAST_EIGENVALUE] = 0.0
        impossible = self._is_impossible(alike, step)
        separability[impossible] = largest[impossible]
        gain[impossible | (largest <= _LEAST_EIGENVALUE)] = -np.inf
        gain -= np.sum(trust * step**2, axis=1) + np.array([candidate.cost for candidate in alike])
        gain -= self._log_narrowing(alike, precision, trust)
        return {c: ScoreTest(c, g, s) for c, g, s in zip(alike, gain.tolist(), separability.tolist(), strict=True)}

    def _trust(self, alike: Sequence[Candidate]) -> FloatArray:
        """Prior precisions ``(G, k)`` of the candidates' coefficients; of bodies almost zero."""
        if alike[0].payload is not None:
            return np.full((len(alike), 10), 1e-12)
        return np.array([self._design.prior_stds(candidate) for candidate in alike]) ** -2.0

    def _log_narrowing(self, alike: Sequence[Candidate], precision: FloatArray, trust: FloatArray) -> FloatArray:
        """Twice the log of how much the data narrow the coefficients ``(G,)``; of bodies by a rule of thumb."""
        if alike[0].payload is not None:
            return np.full(len(alike), _DIRECTIONS_OF_BODY * np.log(np.max(self._design.counts)))
        return np.asarray(np.linalg.slogdet(precision)[1] - np.sum(np.log(trust), axis=1))

    def _gain(self, products: Sequence[CandidateProducts], step: FloatArray, moved: FloatArray) -> FloatArray:
        """Gain ``(G,)`` of steps of the candidates' coefficients ``(G, k)`` and of all other parameters ``(G, D)``,
        without the quadratic term of the latter."""
        squares, weights = self._squares, self._weights
        padded = np.zeros((len(moved), len(self._vector)))
        padded[:, :-1] = moved
        slopes = padded @ self._moved.T
        curvatures = np.stack(
            [np.sum((padded[:, at] @ products) * padded[:, at], axis=1) for at, products in self._by_channel], 1
        )
        squares_after = squares + 2.0 * slopes + curvatures
        for place, channel in enumerate(products):
            steps, vectors = step[channel.which], self._vector + padded[channel.which]
            along = 2.0 * np.einsum("gkn,gn->gk", channel.crossed, vectors)
            along += np.einsum("gkl,gl->gk", channel.squared, steps)
            squares_after[channel.which, place] += np.sum(along * steps, axis=1)
        gain = np.log(squares / np.maximum(squares_after, _LEAST_LEFT * squares)) @ self._counts
        # At the minimum the prior's slope is the opposite of the data's.
        gain += 2.0 * slopes @ weights + curvatures @ weights
        return np.asarray(gain)

    def _is_impossible(self, alike: Sequence[Candidate], step: FloatArray) -> BoolArray:
        """True if a coefficient that cannot be negative would become so ``(G,)``."""
        impossible = np.zeros(len(alike), dtype=bool)
        for index in np.flatnonzero(np.any(step < 0.0, axis=1)).tolist():
            terms = alike[index].terms[: alike[index].positives]
            impossible[index] = any(
                self._values.get(t, 0.0) + s < 0.0 for t, s in zip(terms, step[index].tolist(), strict=False)
            )
        return impossible


def _steps(
    slope: FloatArray, squared: FloatArray, separate_part: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the steps ``(G, k)`` to the minimum of quadratic models with Hessians ``precision (G, k, k)``, and the
    largest eigenvalue of the columns' ``separate_part``, relative to their ``squared`` sizes, ``(G,)``."""
    size = np.sqrt(np.maximum(np.diagonal(squared, axis1=1, axis2=2), 1e-300))
    values = np.linalg.eigvalsh(separate_part / (size[:, :, None] * size[:, None, :]))
    step = -np.linalg.solve(precision + 1e-12 * size[:, :, None] ** 2 * np.eye(size.shape[1]), slope[:, :, None])
    return np.asarray(step[:, :, 0]), np.max(values, axis=1)


KEPT_PROMISE = 2.5
"""Most that a hypothesis gains, as a multiple of the promise of the score test: of some 3,000 none gained more. No loss
is smaller than its second-order estimate by a larger factor, either."""
_MOST = 40
_PLAUSIBLE = 0.5  # fraction of a loss that the score test must promise of a rival for it to be tried


class Selection:
    """Search over sets of ``hypotheses`` for one design, by the score of their fits: minus twice the log evidence."""

    def __init__(self, design: Design, prior: Prior, hypotheses: Sequence[Candidate]) -> None:
        self.design = design
        self.prior = prior
        self.hypotheses = list(hypotheses)
        self._fits: dict[frozenset[Candidate], JointFit] = {}
        self._groups = {hypothesis.group: hypothesis for hypothesis in self.hypotheses}
        self.known: dict[str, dict[Any, Any]] = {}

    def fit(self, chosen: Collection[Candidate], start: JointFit | None = None) -> JointFit:
        """Return the joint fit of a set; each set is fitted once."""
        key = frozenset(chosen)
        if key not in self._fits:
            self._fits[key] = fit(self.design, self.prior, list(chosen), start)
        return self._fits[key]

    def without(self, current: JointFit, *gone: Candidate) -> JointFit:
        """Return the fit without some of its hypotheses."""
        return self.fit([c for c in current.chosen if c not in gone], current)

    @remembered
    def ranked(self, current: JointFit) -> list[ScoreTest]:
        """Rank the hypotheses that could join, the best of each group, by the score test."""
        return self._rank(current, self.hypotheses)

    def _rank(self, current: JointFit, among: Sequence[Candidate]) -> list[ScoreTest]:
        excluded = set[Hashable]().union(*map(self._excluded_by, current.chosen))
        possible = [c for c in among if c.group not in excluded]
        best: dict[Hashable, ScoreTest] = {}
        for trial in score_tests(self.design, current, possible):
            group = trial.candidate.group
            if group not in best or trial.gain > best[group].gain:
                best[group] = trial
        return sorted(best.values(), key=lambda trial: -trial.gain)

    @remembered
    def _excluded_by(self, chosen: Candidate) -> frozenset[Hashable]:
        """Groups that make no sense together with a chosen hypothesis."""
        return frozenset(group for group, hypothesis in self._groups.items() if hypothesis.excludes(chosen))

    def is_plausible(self, found: JointFit) -> bool:
        """True if no coefficient has an impossible sign or size, and no body has more mass than the robot."""
        return not any(self.is_out_of_range(found, candidate) for candidate in found.chosen)

    def is_out_of_range(self, found: JointFit, candidate: Candidate) -> bool:
        """True if a hypothesis has an impossible sign or size."""
        if candidate.payload is not None:
            place = len(self.prior.inertias) // 10 + found.bodies.index(candidate.payload)
            return bool(found.point.pseudo_inertias[place, 3, 3] > np.sum(self.prior.inertias[::10]))
        values = np.array([found.value(term) for term in candidate.terms])
        return bool(np.any(values[: candidate.positives] <= 0.0)) or candidate.effect.is_out_of_range(values)

    def grow(self, current: JointFit, to_the_end: bool = True) -> JointFit:
        """Grow and prune until nothing changes. Unless ``to_the_end``, stop when a hypothesis joins on which all
        columns depend. Hypotheses out of range are dropped first, and the search goes on."""
        current = self.prune(self.within_range(current))
        groups = {c.group for c in current.chosen}
        while (larger := self._grown(current)) is not None:
            current = self.prune(larger)
            if not to_the_end and any(c.effect.relinearise_beyond and c.group not in groups for c in current.chosen):
                break
        return current

    def optimise(self, current: JointFit) -> JointFit:
        """Grow, and exchange hypotheses for others, until nothing changes."""
        before = np.inf
        while current.score < before - 1e-6:
            before = current.score
            current = self._exchanged(self.grow(current))
        return current

    def within_range(self, current: JointFit) -> JointFit:
        """Drop the hypotheses that are out of range, one after the other."""
        while dropped := [c for c in current.chosen if self.is_out_of_range(current, c)]:
            current = min((self.without(current, c) for c in dropped), key=lambda joint_fit: joint_fit.score)
        return current

    def _grown(self, current: JointFit) -> JointFit | None:
        """Return the best set with one more hypothesis, or None if none improves the score. The first choice of the
        score test is compared only with those that share a channel with it: the others have their turn later."""
        if len(current.chosen) >= _MOST:
            return None
        best: JointFit | None = None
        reached = frozenset[int]()
        for trial in self._promising(current, 0.0):
            channels = frozenset(self.design.affected_channels(trial.candidate))
            if best is not None and KEPT_PROMISE * trial.gain < current.score - best.score:
                break
            if best is not None and not channels & reached:
                continue
            larger = self.fit([*current.chosen, trial.candidate], current)
            if self.is_plausible(larger) and larger.score < (best or current).score:
                best, reached = larger, channels
        return best

    def _promising(self, current: JointFit, least: float, instead_of: Candidate | None = None) -> list[ScoreTest]:
        """Return the hypotheses that are worth an exact fit, best first: those that the score test prefers, and bodies,
        each with a gain above ``least``."""
        trials = [t for t in self.ranked(current) if t.gain > least and t.candidate.payload is None]
        trials = [t for t in trials if instead_of is None or t.candidate is not instead_of][:SHORTLIST]
        if not current.bodies and (instead_of is None or instead_of.effect.confusable_with_payload):
            trials += [t for t in self._promising_bodies(current) if t.gain > least and t.candidate is not instead_of]
        return sorted(trials, key=lambda trial: -trial.gain)

    @remembered
    def _promising_bodies(self, current: JointFit) -> list[ScoreTest]:
        """Return the bodies that are worth an exact fit. At the fit itself the score test underrates them: nearly free
        inertias, which the body made wrong, imitate it. So the test uses the inertias' default prior std."""
        firm = fit(self.design, self.prior, current.chosen, current, self.prior.link_prior_stds)
        trials = self._rank(firm, [c for c in self.hypotheses if c.payload is not None])
        return [trial for trial in trials if trial.gain > 0.0][:SHORTLIST]

    def prune(self, current: JointFit) -> JointFit:
        """Drop the hypotheses that are not worth their cost, the worst first, and pairs that support each other."""
        while smaller := min(self._smaller(current), key=lambda joint_fit: joint_fit.score, default=None):
            if smaller.score > current.score:
                break
            current = smaller
        return current

    def _smaller(self, current: JointFit) -> Iterator[JointFit]:
        sets = [(c,) for c in current.chosen]
        pairs = [pair for pair in combinations(current.chosen, 2) if self._overlap(*pair)]
        for dropped in (*sets, *pairs):
            if self.estimated_loss(current, dropped) < KEPT_PROMISE * self._price(current, dropped):
                yield self.without(current, *dropped)

    def _price(self, current: JointFit, dropped: Sequence[Candidate]) -> float:
        """Cost of some hypotheses, as minus twice a logarithm: from their prior odds, and how much the data narrow
        their coefficients; infinite with a body among them, for which that is not known."""
        if any(c.payload is not None for c in dropped):
            return float("inf")
        covariance = current.covariance_of([term for c in dropped for term in c.terms])
        roots = 1.0 / np.concatenate([self.design.prior_stds(c) for c in dropped])
        log_narrowing = np.linalg.slogdet(covariance * np.outer(roots, roots))[1]
        return sum(c.cost for c in dropped) - float(log_narrowing)

    def _overlap(self, first: Candidate, second: Candidate) -> bool:
        """True if two affect exactly the same channels."""
        reached = [self.design.affected_channels(c) for c in (first, second)]
        return reached[0] == reached[1]

    def estimated_loss(self, current: JointFit, gone: Sequence[Candidate]) -> float:
        """Second-order estimate of the loss of score without some hypotheses, their costs excluded; 0 with a body among
        them, whose loss is far from quadratic."""
        if any(c.payload is not None for c in gone):
            return 0.0
        terms = list(dict.fromkeys(term for c in gone for term in c.terms))
        values = np.array([current.value(term) - self.prior.value(term) for term in terms])
        squared = float(values @ np.linalg.solve(current.covariance_of(terms), values))
        count = float(np.max(self.design.counts))
        return count * float(np.log1p(max(squared, 0.0) / count))

    def rivals(self, current: JointFit, candidate: Candidate) -> list[JointFit]:
        """Return the best sets with another hypothesis instead of one, best first; maybe the same with another
        constant."""
        rest = self.without(current, candidate)
        least = _PLAUSIBLE * (rest.score - current.score)
        fits = [self.fit([*rest.chosen, t.candidate], rest) for t in self._promising(rest, least, candidate)]
        fits += [f for f in (self._rescaled(current, candidate),) if f is not None]
        fits += self._with_other_constants(current, candidate)
        return sorted((f for f in fits if self.is_plausible(f)), key=lambda joint_fit: joint_fit.score)

    def _with_other_constants(self, current: JointFit, candidate: Candidate) -> Iterator[JointFit]:
        """Yield sets in which another hypothesis replaces one, and a third one in the same channels has the constants
        that suit the other: its present constants were chosen together with the replaced one, and favour it."""
        overlapping = [h for h in self.hypotheses if self._overlap(h, candidate)]
        for neighbour in current.chosen:
            variants = [h for h in self.hypotheses if h.group == neighbour.group]
            if neighbour is candidate or len(variants) == 1 or not self._overlap(neighbour, candidate):
                continue
            rest, groups = self.without(current, candidate, neighbour), {candidate.group, neighbour.group}
            others = [h for h in overlapping if h.group not in groups]
            trials = list[tuple[float, JointFit, Candidate]]()
            for other in [t.candidate for t in self._rank(rest, others) if t.gain > 0.0][:SHORTLIST]:
                larger = self.fit([*rest.chosen, other], rest)
                trials += [(larger.score - t.gain, larger, t.candidate) for t in self._rank(larger, variants)]
            if trials:
                _, larger, best = min(trials, key=lambda scored: scored[0])
                yield self.fit([*larger.chosen, best], larger)

    def _rescaled(self, current: JointFit, candidate: Candidate) -> JointFit | None:
        """Return the set in which factors at all channels replace a body; None for anything else. A common change of
        all factors looks like a heavier body, except in friction and inertia."""
        factors = [c for c in self.hypotheses if c.effect.scales_measurement]
        if candidate.payload is None or not factors:
            return None
        kept = [c for c in current.chosen if c is not candidate and c not in factors]
        return self.fit([*kept, *factors], current)

    def _exchanged(self, current: JointFit) -> JointFit:
        """Exchange hypotheses for others where that improves the score."""
        for candidate in current.chosen:
            if candidate in current.chosen:
                others = [other for other in self.rivals(current, candidate) if candidate not in other.chosen]
                best = min(others, key=lambda joint_fit: joint_fit.score, default=current)
                current = best if best.score < current.score - 1e-3 else current
        return current
