"""Search and linearisation in turn, until the total model settles."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import CLEARLY, ODDS, Candidate, NamesFit, NamesPrior, NamesSearch
from geomid_ros.gap.evidence.features import StandingRemainder
from geomid_ros.gap.evidence.linearised_problem import Columns, LinearisedProblem, mean_of, total_model
from geomid_ros.gap.evidence.noise import Autoregression, noise_by_repeats, runs_of
from geomid_ros.gap.evidence.record import FEWEST_ROWS, Records, TotalModel
from geomid_ros.inference.fit import fit, unfitted
from geomid_ros.inference.probability import Support, Supports
from geomid_ros.inference.selection import Selection
from geomid_ros.model.effects import joints_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

_ROUNDS = 6
_REFITS = 3  # more rounds, without a search
_SETTLED = 0.5  # standard deviations
_TOLD_BY_ROWS = 0.25  # directions for each row, which leaves most of the noise as it is
_MEDIAN_OF_GAUSSIAN = 0.6745
_WHITENINGS = 4  # of a remainder by the noise that it leaves


@dataclass(frozen=True, eq=False, kw_only=True)
class Analysis:
    """Where the search ended: the last ``problem`` and ``search``; the fit with ``names`` and the one without
    (``bare``); what ``supports`` each of these that is likely; the standard deviation of each channel's noise, ``floor
    (C,)``, from repeats of a motion if there are any; ``contested``: the odds that another link than the one that was
    found has been changed."""

    problem: LinearisedProblem
    search: NamesSearch
    bare: NamesFit
    names: NamesFit
    supports: dict[Candidate, Support[Candidate]]
    floor: FloatArray
    contested: float = 0.0

    @property
    def likely(self) -> NamesFit:
        """The fit with the names that are likely alone."""
        return self.search.without(self.names, *(c for c in self.names.chosen if c not in self.supports))


@dataclass(frozen=True, eq=False)
class _Task:
    """What is searched: the ``model`` in the ``records``, with candidates that are ``tried``, and ``links`` that may
    have been changed, of which those that are ``inner`` ones of a drawing may be wrong as well as loaded, beside what
    the model is known to lack (``standing``); ``progress`` is told."""

    model: MeasurementModel
    records: Records
    tried: Sequence[Candidate]
    links: Sequence[int]
    inner: Collection[int]
    standing: StandingRemainder | None
    progress: Callable[[str, float], None]

    def linearised(self, total: TotalModel, floor: FloatArray | None = None) -> LinearisedProblem:
        """The problem at a total model."""
        return LinearisedProblem(self.model, self.records, total, floor, self.standing)


def analyse(
    model: MeasurementModel,
    records: Records,
    prior: NamesPrior,
    progress: Callable[[str, float], None],
    standing: StandingRemainder | None = None,
) -> Analysis:
    """Find the set of names that explains the records best, and what is to be thought of the links beside it.

    A payload hangs at the end of a limb, or lies on a base that moves. What another link of an identified model has
    gained is told as a link that has been changed: on the axis of a last joint a payload would else be one of the link
    before as well. On another link of a drawing it may as well be an error of that.
    """
    tried = _told(library.candidates(model, prior.terms, bare=not prior.identified), records.moving)
    links = [c.payload for c in tried if c.payload is not None]
    inner = {c.payload for c in tried if c.payload is not None and c.joint is not None} - _ends(model, links)
    if prior.known is not None:
        tried, inner = [c for c in tried if c.payload not in inner], set()
    task = _Task(model, records, tried, links, inner=inner, standing=standing, progress=progress)
    return _with_changed_link(task, _searched(task, prior, "searching"))


def _told(tried: Sequence[Candidate], moving: BoolArray) -> list[Candidate]:
    """Those that act at joints which move together, where these are ``moving (N, joints)``: of links that move as one
    the first carries what they carry, and what two joints have in common no motion of each alone shows."""
    return [c for c in tried if np.count_nonzero(np.all(moving[:, joints_of(c.place)], axis=1)) >= FEWEST_ROWS]


def standing_remainder(model: MeasurementModel, records: Records, prior: NamesPrior) -> StandingRemainder:
    """What the model that the ``prior`` describes lacks on records, its parameters as they are; of channels without
    rows that is not known."""
    given = unfitted(prior)
    noise = (Autoregression.white(),) * len(model.channels)
    problem = LinearisedProblem(model, records, total_model(model, given))
    residual = problem.residual(problem.columns((), prior.terms), given)
    near: list[FloatArray] | None = None
    for _ in range(_WHITENINGS):
        near, lacks = problem.lacks(residual, problem.told, noise, near)
        left = residual - mean_of(problem.told, lacks)
        noise = _noise(left, problem.valid, records)
        problem = problem.with_floor(_typical_size(left, problem.valid))
    return StandingRemainder(
        joints=tuple(model.robot.joint_names),
        channels=tuple(channel.name for channel in model.channels),
        basis=problem.basis,
        means=tuple(lack.coefficients for lack in lacks),
        triangles=tuple(np.asarray(np.linalg.qr(lack.triangle, mode="r")) for lack in lacks),
    )


def _with_changed_link(task: _Task, analysis: Analysis) -> Analysis:
    """An analysis, or one of a robot of which a link has been changed since it was identified, if that is the better.
    What contradicts other recordings loosens all links at once, or is told as a payload, which cannot be negative, or
    as what else may stand in the place of a lighter link: so each link is tried with the names that are found beside
    its change, not those found without. Of links that explain it about as well each is searched to the end; one that
    carries a payload has been changed by that, unless it is lighter."""
    search, names = analysis.search, analysis.names
    if search.prior.known is None:
        return analysis
    unlikely = names.score + 2.0 * np.log(ODDS)
    tried = list[tuple[NamesPrior, float, bool]]()
    for link in task.links:
        prior = search.prior.with_changed(link)
        beside = Selection(search.design, prior, task.tried)
        best = beside.grow(beside.fit([]))
        loaded = link in names.bodies and best.inertias[link, 0] >= prior.inertias[10 * link]
        tried.append((prior, best.score, loaded))
    least = min((score for _, score, _ in tried), default=np.inf)
    likely = [prior for prior, score, loaded in tried if score < least + CLEARLY and not loaded]
    if least > unlikely or not likely:
        return analysis

    def with_changed(prior: NamesPrior) -> tuple[float, Analysis]:
        changed = _searched(task, prior, "searching with a link changed")
        return fit(search.design, prior, changed.names.chosen, changed.names).score, changed

    (score, changed), *others = sorted(map(with_changed, likely), key=lambda found: found[0])
    contested = float(sum(np.exp(0.5 * (score - other)) for other, _ in others))
    return replace(changed, contested=contested) if score < unlikely else analysis


def _ends(model: MeasurementModel, links: Sequence[int]) -> set[int]:
    """Those of some links that carry none of the others."""
    tree, names = model.robot.tree, model.body_names
    carrying = {joint.parent for link in links for joint in tree.joints_above(names[link])}
    return {link for link in links if names[link] not in carrying}


def _searched(task: _Task, prior: NamesPrior, stage: str) -> Analysis:
    """The names beside which the total model settles, and what speaks for each."""
    last = _last_round(task, prior, stage)
    supports = _supports(last.search, last.found, task.inner)
    task.progress(stage, 1.0)
    problem, search, names = last.problem, last.search, last.found
    design = search.design
    left = problem.residual(last.columns, names) - problem.remainder(design, names)
    rows = np.where(design.counts > 0.0, design.counts, np.nan)
    lacking = np.array([lack.freedom for lack in names.remainders(design)])
    freedom = np.maximum(rows - names.parameters_by_channel(design) - lacking, 1.0) / rows
    noise, _ = problem.told_floor(_root_mean_square(left, problem.valid) / np.sqrt(freedom))
    return Analysis(
        problem=problem,
        search=search,
        bare=search.fit([]),
        names=names,
        supports=supports,
        floor=noise_by_repeats(task.model, task.records).floor(noise),
    )


def _supports(search: NamesSearch, found: NamesFit, inner: Collection[int]) -> dict[Candidate, Support[Candidate]]:
    """What speaks for each name that is more likely than nothing in its place; of a payload on one of the ``inner``
    links that this is wrong is as likely. The others are told to nobody, and stay in the fit: without them the model
    would lack what they explain, for which all others would be doubted."""
    each = Supports(search, found)
    said = {candidate: each.of(candidate) for candidate in found.chosen if each.worth(candidate) > 0.0}
    for candidate, support in said.items():
        if candidate.payload in inner:
            said[candidate] = replace(support, probability=support.probability / (1.0 + support.probability))
    return said


@dataclass(frozen=True, eq=False)
class _Round:
    """A ``problem`` linearised at what the round before had found, with its ``columns``, the ``search`` for its noise,
    and what it ``found``."""

    problem: LinearisedProblem
    columns: Columns
    search: NamesSearch
    found: NamesFit


def _last_round(task: _Task, prior: NamesPrior, stage: str) -> _Round:
    """Search and linearisation in turn, until the total model settles. One that does not is fitted along what the last
    search has found, in the noise of that: it may have dropped names, with whose sizes all was linearised."""
    noise, total = _beginning(task, prior)
    floor: FloatArray | None = None
    before: NamesFit | None = None
    settling, variances = False, tuple[FloatArray, ...]()
    rounds: list[_Round] = []
    for attempt in range(_ROUNDS + _REFITS):
        task.progress(stage, min(1.0, attempt / _ROUNDS))
        problem = task.linearised(total, floor)
        rounds.clear()  # columns and their products are large, and go before others come
        last = _round(task, prior, problem, noise, before, variances=variances, attempt=attempt, settling=settling)
        rounds.append(last)
        found, variances = last.found, last.search.design.variances
        del last
        total = total_model(task.model, found)
        if settling and _same(before, found):
            break
        settling |= attempt >= _ROUNDS - 2 or _same(before, found)
        before = found
        if attempt < _ROUNDS - 1:
            residual = problem.residual(rounds[-1].columns, found)
            residual -= problem.remainder(rounds[-1].search.design, found)
            floor, told = problem.told_floor(_typical_size(residual, problem.valid))
            pairs = zip(told.tolist(), _noise(residual, problem.valid, task.records), noise, strict=True)
            noise = tuple(own if is_told else earlier for is_told, own, earlier in pairs)
    return rounds[-1]


def _beginning(task: _Task, prior: NamesPrior) -> tuple[tuple[Autoregression, ...], TotalModel]:
    """The first noise, and the total model without names."""
    problem = task.linearised(total_model(task.model, unfitted(prior)))
    columns = problem.columns(task.tried, prior.terms)
    bare: NamesFit = fit(problem.design(columns, (Autoregression.white(),) * len(task.model.channels)), prior, ())
    return _flexible_noise(problem, columns, bare, problem.valid), total_model(task.model, bare)


def _round(
    task: _Task,
    prior: NamesPrior,
    problem: LinearisedProblem,
    noise: tuple[Autoregression, ...],
    before: NamesFit | None,
    *,
    variances: Sequence[FloatArray],
    attempt: int,
    settling: bool,
) -> _Round:
    """A fit along what was found ``before``, and a search from there if the columns are good for that, with exchanges
    once it is ``settling``. The last attempt that searches does so to the end; those after it do not."""
    columns = problem.columns(task.tried, prior.terms)
    design = problem.design(columns, noise)
    search = Selection(design.given(variances) if variances else design, prior, task.tried)
    found = search.within_range(search.fit(before.chosen if before else ()))
    is_last = attempt == _ROUNDS - 1
    searches = is_last or (attempt < _ROUNDS and _near(total_model(task.model, found), problem.total))
    if searches:  # what has no name yet must not become a part of the remainder, in whose place none would be found
        found = search.grow(found, to_the_end=is_last)
    search = Selection(found.settled(design), prior, task.tried)
    found = search.within_range(search.fit(found.chosen, found))
    if searches:
        found = search.settle(found) if settling else search.grow(found, to_the_end=is_last)
    return _Round(problem, columns, search, found)


def _near(found: TotalModel, total: TotalModel) -> bool:
    """Whether columns for one are good for the other."""
    before = {(effect, place): coefficients for effect, place, coefficients in total.effects}
    after = {(effect, place): coefficients for effect, place, coefficients in found.effects}
    return all(
        bool(np.all(np.abs(after.get(key, 0.0) - before.get(key, np.zeros(1))) < key[0].far))
        for key in {**before, **after}
        if key[0].far
    )


def _same(before: NamesFit | None, found: NamesFit) -> bool:
    """Whether the same was found as in the round before, up to a share of the standard deviations."""
    if before is None or {c.group for c in before.chosen} != {c.group for c in found.chosen}:
        return False
    stds = np.sqrt(np.diag(found.covariance))
    shared = [term for term in found.terms if term in before.terms]
    return all(abs(before.value(term) - found.value(term)) < _SETTLED * stds[found.place(term)] for term in shared)


def _flexible_noise(
    problem: LinearisedProblem, columns: Columns, bare: NamesFit, valid: BoolArray
) -> tuple[Autoregression, ...]:
    """First noise: what the motions of each channel's own joint and the whole robot's effects leave of the residual.

    Of all their directions only so many are taken as rows can tell: of rows that are as few nothing but rounding errors
    would be left, and what they say of the noise.
    """
    residual = problem.residual(columns, bare)
    left = np.full(residual.shape, np.nan)
    for channel in range(residual.shape[1]):
        chosen = valid[:, channel]
        own = [by[channel] for by in columns.values() if channel in by]
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
