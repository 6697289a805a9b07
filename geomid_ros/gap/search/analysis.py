"""Search and linearisation in turn, until the total model settles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import Candidate, CurveCandidate, CurveTerm, EffectTerm, Term
from geomid_ros.gap.evidence.curves import Curves
from geomid_ros.gap.evidence.noise import Autoregression, noise_by_repeats, runs_of
from geomid_ros.gap.evidence.record import Records, TotalModel
from geomid_ros.gap.fitting.fit import JointFit, fit, unfitted
from geomid_ros.gap.fitting.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.fitting.prior import Prior
from geomid_ros.gap.search.beam_search import LEAST_GAIN, Search
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

_ROUNDS = 6
_REFITS = 3  # more rounds, without a search
_SETTLED = 0.5  # standard deviations
_MOST_CURVES = 4
_TOLD_BY_ROWS = 0.25  # directions for each row, which leaves most of the noise as it is
_MEDIAN_OF_GAUSSIAN = 0.6745
_CERTAINTY_OF_HELD = 100.0  # of links that may hardly be more wrong than usual
_CONTRADICTED = 4.0  # times the variance that other recordings state of the links
_VISIBLE = 1.07  # times larger, to be worth a word

Columns = dict[Term, dict[int, FloatArray]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Analysis:
    """Where the search ended: the last ``problem`` and ``search``; the fit with ``names`` alone, with curves for what
    they leave (``whole``), and without either (``bare``); the standard deviation of each channel's noise, ``floor
    (C,)``, from repeats of a motion if there are any; ``contested``: whether the link that has been changed may as well
    be another one."""

    problem: LinearisedProblem
    search: Search
    bare: JointFit
    names: JointFit
    whole: JointFit
    floor: FloatArray
    curves: Curves
    contested: bool = False


@dataclass(frozen=True, eq=False)
class _Task:
    """What is searched: the ``model`` in the ``records``, with candidates that are ``tried`` and ``curves`` for what
    these leave; ``progress`` is told of it."""

    model: MeasurementModel
    records: Records
    tried: Sequence[Candidate]
    curves: Curves
    progress: Callable[[str, float], None]


def analyse(
    model: MeasurementModel, records: Records, prior: Prior, progress: Callable[[str, float], None]
) -> Analysis:
    """Find the set of names that explains the records best, and what is to be thought of the links beside it."""
    situation = LinearisedProblem(model, records, total_model(model, unfitted(prior))).situation
    tried = library.candidates(model, [term for term in prior.terms if isinstance(term, EffectTerm)])
    task = _Task(model, records, tried, Curves(model, records, situation), progress)
    return _with_changed_link(task, _with_held_links(task, _searched(task, prior, "searching")))


def _with_held_links(task: _Task, analysis: Analysis) -> Analysis:
    """An analysis, with names in whose places links were let go. Beside a link that is let go such a name brings
    nothing more. So the search is repeated with links that are held; what it finds is fitted without holding them, and
    taken if that is the better, and fewer links are let go beside it."""
    search, names = analysis.search, analysis.names
    if search.prior.certainty >= _CERTAINTY_OF_HELD or not search.let_go(names):
        return analysis
    held = _searched(task, replace(search.prior, certainty=_CERTAINTY_OF_HELD), "searching with links held").names
    instead = search.fit(held.chosen, held)
    if instead.score > names.score - LEAST_GAIN or not search.let_go(instead) < search.let_go(names):
        return analysis
    return replace(analysis, names=instead, whole=with_curves(search, instead))


def _with_changed_link(task: _Task, analysis: Analysis) -> Analysis:
    """An analysis, or one of a robot of which a link has been changed since it was identified, if that is the better.
    What contradicts other recordings loosens all links at once, or is told as a payload, which cannot be negative. Of
    links that explain it about as well each is tried."""
    search, names = analysis.search, analysis.names
    if search.prior.known is None:
        return analysis
    rest = search.fit([c for c in names.chosen if not isinstance(c, Candidate) or c.payload is None], names)
    if rest.inflation < _CONTRADICTED:
        return analysis
    priors = [search.prior.with_changed(link) for link in range(len(names.inertias))]
    scores = [fit(search.design, prior, rest.chosen, rest).score for prior in priors]
    if min(scores) > rest.score - LEAST_GAIN:
        return analysis

    def with_changed(prior: Prior) -> tuple[float, Analysis]:
        changed = _searched(task, prior, "searching with a link changed")
        return fit(search.design, prior, changed.names.chosen, changed.names).score, changed

    likely = [prior for prior, score in zip(priors, scores, strict=True) if score < min(scores) + LEAST_GAIN]
    (score, changed), *others = sorted(map(with_changed, likely), key=lambda found: found[0])
    contested = any(other < score + LEAST_GAIN for other, _ in others)
    return replace(changed, contested=contested) if score < names.score - LEAST_GAIN else analysis


def _searched(task: _Task, prior: Prior, stage: str) -> Analysis:
    """The names beside which the total model settles, with curves for what they leave."""
    last = _last_round(task, prior, stage)
    problem, search = last.problem, last.search
    names, whole = _with_and_without_curves(search, last.found)
    task.progress(stage, 1.0)
    residual = problem.residual(last.columns, whole)
    repeats = noise_by_repeats(task.model, task.records)
    counts = search.design.counts
    rows = np.where(counts > 0.0, counts, np.nan)
    freedom = np.maximum(rows - whole.parameters_by_channel(search.design), 1.0) / rows
    return Analysis(
        problem=problem,
        search=search,
        bare=search.fit([]),
        names=names,
        whole=whole,
        floor=repeats.floor(_root_mean_square(residual, problem.valid) / np.sqrt(freedom)),
        curves=task.curves,
    )


@dataclass(frozen=True, eq=False)
class _Round:
    """A ``problem`` linearised at what the round before had found, with its ``columns``, the ``search`` for its noise,
    and what it ``found``."""

    problem: LinearisedProblem
    columns: Columns
    search: Search
    found: JointFit


def _last_round(task: _Task, prior: Prior, stage: str) -> _Round:
    """Search and linearisation in turn, until the total model settles. One that does not is fitted along what the last
    search has found, in the noise of that: it may have dropped names, with whose sizes all was linearised."""
    noise, total = _beginning(task, prior)
    floor: FloatArray | None = None
    before: JointFit | None = None
    rounds: list[_Round] = []
    for attempt in range(_ROUNDS + _REFITS):
        task.progress(stage, min(1.0, attempt / _ROUNDS))
        problem = LinearisedProblem(task.model, task.records, total, floor)
        rounds.clear()  # columns and their products are large, and go before others come
        rounds.append(_round(task, prior, problem, noise, before, attempt))
        found = rounds[-1].found
        total = total_model(task.model, found)
        if _same(before, found):
            break
        before = found
        if attempt < _ROUNDS - 1:
            residual = problem.residual(rounds[-1].columns, found)
            floor = _typical_size(residual, problem.valid)
            noise = _noise(residual, problem.valid, task.records)
    return rounds[-1]


def _beginning(task: _Task, prior: Prior) -> tuple[tuple[Autoregression, ...], TotalModel]:
    """The first noise, and the total model without names."""
    problem = LinearisedProblem(task.model, task.records, total_model(task.model, unfitted(prior)))
    columns = problem.columns(task.tried, prior.terms, task.curves)
    noise = (Autoregression.white(),) * len(task.model.channels)
    bare = Search(problem.design(columns, noise), prior, task.tried).fit([])
    return _flexible_noise(problem, columns, bare, problem.valid), total_model(task.model, bare)


def _round(
    task: _Task,
    prior: Prior,
    problem: LinearisedProblem,
    noise: Sequence[Autoregression],
    before: JointFit | None,
    attempt: int,
) -> _Round:
    """A fit along what was found ``before``, and a search from there if the columns are good for that. The last attempt
    that searches does so to the end; those after it do not."""
    is_last = attempt == _ROUNDS - 1
    columns = problem.columns(task.tried, prior.terms, task.curves)
    search = Search(problem.design(columns, noise), prior, task.tried, task.curves.candidates)
    found = search.without_absurd(search.fit(before.chosen if before else ()))
    if is_last or (attempt < _ROUNDS and _near(total_model(task.model, found), problem.total)):
        found = search.without_absurd(search.settle(search.prune(found), to_the_end=is_last))
    return _Round(problem, columns, search, found)


def _with_and_without_curves(search: Search, found: JointFit) -> tuple[JointFit, JointFit]:
    """The fit of the names alone, and the one with the curves that they leave room for: the same names in both.

    A curve of velocity spans viscous friction, and one of friction Coulomb's: beside them a name would not be needed.
    """
    names = search.without_absurd(search.simplified(found))
    return names, with_curves(search, names)


def with_curves(search: Search, found: JointFit) -> JointFit:
    """With the free curves that the rest needs: those without which some channel's remainder is visibly larger."""
    current = found
    while len(current.chosen) < len(found.chosen) + _MOST_CURVES and (larger := search.add_curve(current)) is not None:
        current = search.prune(larger, [c for c in larger.chosen if isinstance(c, CurveCandidate)])
    for curve in [c for c in current.chosen if isinstance(c, CurveCandidate)]:
        without = search.without(current, curve)
        if float(np.sqrt(np.max(without.squares / current.squares))) < _VISIBLE:
            current = without
    return current if search.possible(current) else found


def _near(found: TotalModel, total: TotalModel) -> bool:
    """Whether columns for one are good for the other."""
    before = {(effect, place): coefficients for effect, place, coefficients in total.effects}
    after = {(effect, place): coefficients for effect, place, coefficients in found.effects}
    return all(
        bool(np.all(np.abs(after.get(key, 0.0) - before.get(key, np.zeros(1))) < key[0].far))
        for key in {**before, **after}
        if key[0].far
    )


def _same(before: JointFit | None, found: JointFit) -> bool:
    """Whether the same was found as in the round before, up to a share of the standard deviations."""
    if before is None or {c.group for c in before.chosen} != {c.group for c in found.chosen}:
        return False
    stds = np.sqrt(np.diag(found.covariance))
    shared = [term for term in found.terms if term in before.terms]
    return all(abs(before.value(term) - found.value(term)) < _SETTLED * stds[found.place(term)] for term in shared)


def _flexible_noise(
    problem: LinearisedProblem, columns: Columns, bare: JointFit, valid: BoolArray
) -> tuple[Autoregression, ...]:
    """First noise: what the motions of each channel's own joint and the whole robot's effects leave of the residual.

    Of all their directions only so many are taken as rows can tell: of rows that are as few nothing but rounding errors
    would be left, and what they say of the noise.
    """
    residual = problem.residual(columns, bare)
    left = np.full(residual.shape, np.nan)
    for channel in range(residual.shape[1]):
        chosen = valid[:, channel]
        own = [by[channel] for term, by in columns.items() if channel in by and not isinstance(term, CurveTerm)]
        matrix = np.column_stack(own)[chosen] if own else np.zeros((np.count_nonzero(chosen), 0))
        matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-12)
        directions, sizes, _ = np.linalg.svd(matrix, full_matrices=False)
        most = int(_TOLD_BY_ROWS * len(matrix))
        directions = directions[:, :most][:, sizes[:most] > 1e-6 * np.max(sizes, initial=0.0)]
        rest = residual[chosen, channel]
        left[chosen, channel] = rest - directions @ (directions.T @ rest)
    return _noise(left, valid, problem.records)


def _noise(residual: FloatArray, valid: BoolArray, records: Records) -> tuple[Autoregression, ...]:
    used = valid & np.isfinite(residual)
    channels = zip(residual.T, used.T, strict=True)
    return tuple(Autoregression.fit(values, runs_of(own, records.segment)) for values, own in channels)


def _typical_size(residual: FloatArray, valid: BoolArray) -> FloatArray:
    """Of each channel ``(C,)``: the standard deviation that the median size would have if it were Gaussian."""
    return _by_channel(lambda values: np.median(np.abs(values)), residual, valid) / _MEDIAN_OF_GAUSSIAN


def _root_mean_square(residual: FloatArray, valid: BoolArray) -> FloatArray:
    return np.sqrt(_by_channel(lambda values: np.mean(values**2), residual, valid))


def _by_channel(function: Callable[[FloatArray], Any], residual: FloatArray, valid: BoolArray) -> FloatArray:
    """A function of each channel's valid values ``(C,)``, NaN where there are none."""
    channels = zip(residual.T, valid.T, strict=True)
    return np.array([function(values[used]) if np.any(used) else np.nan for values, used in channels])
