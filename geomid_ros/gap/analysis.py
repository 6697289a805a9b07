"""Alternating search and linearisation, until the total model settles."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import CLEARLY, EffectsByPlace
from geomid_ros.gap.features import KnownRemainder
from geomid_ros.gap.linearised_problem import Columns, LinearisedProblem, mean_of, total_model
from geomid_ros.gap.noise import Autoregression, noise_floor, runs_of
from geomid_ros.gap.records import FEWEST_ROWS, Records, TotalModel
from geomid_ros.inference.candidates import ODDS, Candidate, EffectTerm
from geomid_ros.inference.design import Design
from geomid_ros.inference.fit import JointFit, fit, fit_of_prior
from geomid_ros.inference.prior import Prior
from geomid_ros.inference.probability import Support, Supports
from geomid_ros.inference.selection import Selection
from geomid_ros.model.effects import joints_of
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.options import Progress
from geomid_ros.types import BoolArray, FloatArray

_ROUNDS = 6
_REFITS = 3  # more rounds, without a search
_SETTLED = 0.5  # standard deviations
_DIRECTIONS_PER_ROW = 0.25  # directions per row; leaves most of the noise unchanged
_MEDIAN_OF_GAUSSIAN = 0.6745
_WHITENINGS = 4  # rounds that whiten by the noise of the last remainder


@dataclass(frozen=True, eq=False, kw_only=True)
class Analysis:
    """Result of the search: the last ``problem`` and ``search``; the fit with the named ``effects`` and the one without
    (``inertias_only``); the evidence that ``supports`` each likely name; each channel's noise std, ``floor (C,)``, from
    repeats of a motion if any; ``ordinary`` effects, as given; ``contested``: the odds that a link other than the named
    one has changed."""

    problem: LinearisedProblem
    search: Selection
    inertias_only: JointFit
    effects: JointFit
    supports: dict[Candidate, Support]
    floor: FloatArray
    ordinary: EffectsByPlace = field(default_factory=dict)
    contested: float = 0.0

    def usual_load(self, candidate: Candidate) -> float:
        """Std of the rigid-body load [N m or N] that scales the grid constant of a candidate; 0 without one."""
        return self.problem.situation.typical_load(candidate.place) if candidate.effect.grid_value else 0.0

    @property
    def likely(self) -> JointFit:
        """Fit with only the likely named effects."""
        return self.search.without(self.effects, *(c for c in self.effects.chosen if c not in self.supports))


@dataclass(frozen=True, eq=False)
class _Task:
    """Input of the search: ``model``, ``records``, the candidates to be ``tried``, ``links`` that may have changed, the
    ``known_remainder``, the ``ordinary`` effects and a ``progress`` callback. The ``inner`` links of a URDF may be
    wrong as well as loaded."""

    model: MeasurementModel
    records: Records
    tried: Sequence[Candidate]
    links: Sequence[int]
    inner: Collection[int]
    known_remainder: KnownRemainder | None
    ordinary: EffectsByPlace
    progress: Progress

    def terms(self, prior: Prior) -> list[EffectTerm]:
        """Terms of the effects in the model, and of all candidates."""
        return [*prior.terms, *(term for candidate in self.tried for term in candidate.terms)]

    def linearised(self, total: TotalModel, floor: FloatArray | None = None) -> LinearisedProblem:
        """Return the problem linearised at a total model."""
        return LinearisedProblem(self.model, self.records, total, floor, self.known_remainder)


def analyse(
    model: MeasurementModel,
    records: Records,
    prior: Prior,
    progress: Progress,
    known_remainder: KnownRemainder | None = None,
    ordinary: EffectsByPlace = MappingProxyType({}),
) -> Analysis:
    """Find the set of named effects that explains the records best, and the changed links given these. Default effects
    among the ``ordinary`` ones have their constants.

    A payload hangs at the end of a limb, or lies on a moving base. A mass gained by another link of an identified model
    is reported as a changed link: a payload on the axis of a last joint would else fit the link before as well. On
    another link of a URDF it may as well be an error of the URDF.
    """
    candidates = _identifiable(
        library.candidates(model, prior.terms, unknown_joints=not prior.identified, ordinary=ordinary), records.moving
    )
    links = [c.payload for c in candidates if c.payload is not None]
    inner = {c.payload for c in candidates if c.payload is not None and c.joint is not None} - _ends(model, links)
    if prior.other_recordings is not None:
        candidates, inner = [c for c in candidates if c.payload not in inner], set()
    task = _Task(
        *(model, records, candidates, links),
        inner=inner,
        known_remainder=known_remainder,
        ordinary=ordinary,
        progress=progress,
    )
    last, contested = _with_changed_link(task, _searched(task, prior, "searching"))
    return _judged(task, last, contested)


def _identifiable(candidates: Sequence[Candidate], moving: BoolArray) -> list[Candidate]:
    """Candidates that the motion can identify: all their joints move at once in enough rows of ``moving (N, joints)``.
    Of links that move as one, only the first can carry the payload."""
    return [c for c in candidates if np.count_nonzero(np.all(moving[:, joints_of(c.place)], axis=1)) >= FEWEST_ROWS]


def known_remainder(model: MeasurementModel, records: Records, prior: Prior) -> KnownRemainder:
    """Return the remainder of the model that the ``prior`` describes, on records, with its parameters unchanged; it is
    not known for channels without rows."""
    prior_fit = fit_of_prior(prior)
    noise = (Autoregression.white(),) * len(model.channels)
    problem = LinearisedProblem.at(model, records, prior_fit)
    residual = problem.residual(prior_fit)
    near: list[FloatArray] | None = None
    for _ in range(_WHITENINGS):
        near, lacks = problem.fit_remainders(residual, problem.usable_features, noise, near)
        noise_residual = residual - mean_of(problem.usable_features, lacks)
        noise = _noise(noise_residual, problem.valid, records)
        problem = problem.with_floor(_typical_size(noise_residual, problem.valid))
    return KnownRemainder(
        joints=tuple(model.robot.joint_names),
        channels=tuple(channel.name for channel in model.channels),
        basis=problem.basis,
        means=tuple(lack.coefficients for lack in lacks),
        triangles=tuple(np.asarray(np.linalg.qr(lack.triangle, mode="r")) for lack in lacks),
    )


def _with_changed_link(task: _Task, last: _Round) -> tuple[_Round, float]:
    """Return the last round, or that of a better search with a link changed since the robot was identified, and the
    odds that it is another link. A contradiction with other recordings loosens all links at once; or it is explained by
    a payload, which cannot be negative, or by other effects that mimic a lighter link. So each link is tried with
    effects found given its change. All links that explain it about as well are searched to the end. A link with a
    payload is changed by that, unless it is lighter."""
    search, names = last.search, last.found
    if search.prior.other_recordings is None:
        return last, 0.0
    threshold = names.score + 2.0 * np.log(ODDS)
    trials = list[tuple[Prior, float, bool]]()
    for link in task.links:
        prior = search.prior.with_changed(link)
        selection = Selection(search.design, prior, task.tried)
        best = selection.grow(selection.fit([]))
        loaded = link in names.bodies and best.inertias[link, 0] >= prior.inertias[10 * link]
        trials.append((prior, best.score, loaded))
    least = min((score for _, score, _ in trials), default=np.inf)
    priors = [prior for prior, score, loaded in trials if score < least + CLEARLY and not loaded]
    if least > threshold or not priors:
        return last, 0.0

    def with_changed(prior: Prior) -> tuple[float, _Round]:
        changed = _searched(task, prior, "searching with a link changed")
        return fit(search.design, prior, changed.found.chosen, changed.found).score, changed

    (score, changed), *others = sorted(map(with_changed, priors), key=lambda scored: scored[0])
    contested = float(sum(np.exp(0.5 * (score - other)) for other, _ in others))
    return (changed, contested) if score < threshold else (last, 0.0)


def _ends(model: MeasurementModel, links: Sequence[int]) -> set[int]:
    """Links among ``links`` that support none of the others."""
    tree, names = model.robot.tree, model.body_names
    supporting = {joint.parent for link in links for joint in tree.joints_above(names[link])}
    return {link for link in links if names[link] not in supporting}


def _judged(task: _Task, last: _Round, contested: float) -> Analysis:
    """Return the likely effects of the last round with the evidence for each. Noise is what all effects that it found
    leave, likely or not."""
    problem, design, found = last.problem, last.search.design, last.found
    residual = problem.residual(found, last.columns) - problem.remainder(design, found)
    rows = np.where(design.counts > 0.0, design.counts, np.nan)
    remainder_parameters = np.array([lack.freedom for lack in found.remainders(design)])
    freedom = np.maximum(rows - found.parameters_by_channel(design) - remainder_parameters, 1.0) / rows
    noise, _ = problem.identifiable_floor(problem.valid_rms(residual) / np.sqrt(freedom))
    supports = Supports(last.search, found)
    if last.search.prior.identified:
        supports = _likely(supports)
    return Analysis(
        problem=problem,
        search=supports.selection,
        inertias_only=supports.selection.fit([]),
        effects=supports.found,
        supports=_evidence(supports, task.inner),
        floor=noise_floor(task.model, task.records, noise),
        ordinary=task.ordinary,
        contested=contested,
    )


def _likely(supports: Supports) -> Supports:
    """Supports without the changes that are no more likely than nothing in their place, nor those that are more likely
    only beside these. What such changes explain is part of the remainder, which is estimated anew, and puts the sizes
    of the others in doubt."""
    search, names = supports.selection, supports.found
    unlikely = [candidate for candidate in names.chosen if supports.adjusted_loss(candidate) <= 0.0]
    if not unlikely:
        return supports
    rest = search.without(names, *unlikely)
    search = Selection(rest.with_fitted_remainder(search.design), search.prior, search.hypotheses)
    return _likely(Supports(search, search.within_range(search.fit(rest.chosen, rest))))


def _evidence(supports: Supports, inner: Collection[int]) -> dict[Candidate, Support]:
    """Evidence for each named effect that is more likely than nothing in its place. For a payload on an ``inner`` link,
    an error of the link is as likely. Beside a URDF the others are not reported, but stay in the fit: any robot may
    have them, and the remainder would else contain what they explain, so that all other effects would be doubted."""
    evidence = {c: supports.of(c) for c in supports.found.chosen if supports.adjusted_loss(c) > 0.0}
    for candidate, support in evidence.items():
        if candidate.payload in inner:
            evidence[candidate] = replace(support, probability=support.probability / (1.0 + support.probability))
    return evidence


@dataclass(frozen=True, eq=False)
class _Round:
    """A ``problem`` linearised at the result of the previous round, with its ``columns``, the ``search`` for its noise,
    and the fit that it ``found``."""

    problem: LinearisedProblem
    columns: Columns
    search: Selection
    found: JointFit


def _searched(task: _Task, prior: Prior, stage: str) -> _Round:
    """Alternate search and linearisation until the total model settles; return the last round. A model that does not
    settle is fitted along the result of the last search, in the noise of that: this search may have dropped effects
    that the linearisation used."""
    noise, total = _beginning(task, prior)
    floor: FloatArray | None = None
    previous: JointFit | None = None
    settling, variances = False, tuple[FloatArray, ...]()
    attempt, last = 0, None
    while True:
        task.progress(stage, min(1.0, attempt / _ROUNDS))
        problem = task.linearised(total, floor)
        last = None  # free the large columns and products before the next ones
        last = _round(task, prior, problem, noise, previous, variances=variances, attempt=attempt, settling=settling)
        names, variances = last.found, last.search.design.variances
        total = total_model(task.model, names)
        if attempt == _ROUNDS + _REFITS - 1 or (settling and _same(previous, names)):
            task.progress(stage, 1.0)
            return last
        settling |= attempt >= _ROUNDS - 2 or _same(previous, names)
        previous = names
        if attempt < _ROUNDS - 1:
            residual = problem.residual(names, last.columns) - problem.remainder(last.search.design, names)
            floor, determined = problem.identifiable_floor(_typical_size(residual, problem.valid))
            pairs = zip(determined.tolist(), _noise(residual, problem.valid, task.records), noise, strict=True)
            noise = tuple(latest if is_determined else earlier for is_determined, latest, earlier in pairs)
        attempt += 1


def _beginning(task: _Task, prior: Prior) -> tuple[tuple[Autoregression, ...], TotalModel]:
    """Initial noise, and the total model without named effects."""
    problem = task.linearised(total_model(task.model, fit_of_prior(prior)))
    columns = problem.columns(task.terms(prior))
    bare: JointFit = fit(problem.design(columns, (Autoregression.white(),) * len(task.model.channels)), prior, ())
    return _flexible_noise(problem, columns, bare, problem.valid), total_model(task.model, bare)


def _round(
    task: _Task,
    prior: Prior,
    problem: LinearisedProblem,
    noise: tuple[Autoregression, ...],
    before: JointFit | None,
    *,
    variances: Sequence[FloatArray],
    attempt: int,
    settling: bool,
) -> _Round:
    """Fit along what was found ``before``, and search from there, with exchanges once it is ``settling``. The last
    attempt with a search runs it to the end; later attempts do not search."""
    columns = problem.columns(task.terms(prior))
    design = problem.design(columns, noise)
    search = Selection(design.given(variances) if variances else design, prior, task.tried)
    names = search.within_range(search.fit(before.chosen if before else ()))
    is_last, searches = attempt == _ROUNDS - 1, attempt < _ROUNDS
    if searches:  # the remainder must not absorb effects that are not named yet: they would never be found
        names = _grown(search, names, to_the_end=is_last)
    search = Selection(names.with_fitted_remainder(design), prior, task.tried)
    names = search.within_range(search.fit(names.chosen, names))
    if searches and settling:
        search, names = _exchanged(search, search.optimise(names))
    elif searches:
        names = search.grow(names, to_the_end=is_last)
    return _Round(problem, columns, search, names)


def _grown(search: Selection, names: JointFit, *, to_the_end: bool) -> JointFit:
    """Search from ``names``. What contradicts other recordings is explained by all of their errors at once, or by many
    changes of which each alone explains little, as when all joints are warm: so also search for what explains it if
    they are right."""
    others, found = search.prior.other_recordings, search.grow(names, to_the_end)
    if others is None or found.inflation == 1.0:
        return found
    trusting = Selection(
        search.design, replace(search.prior, other_recordings=replace(others, trusted=True)), search.hypotheses
    )
    changed = trusting.grow(trusting.fit(found.chosen), to_the_end)
    changed = search.grow(search.within_range(search.fit(changed.chosen, changed)), to_the_end)
    return min(found, changed, key=lambda one: one.score)


def _exchanged(search: Selection, names: JointFit) -> tuple[Selection, JointFit]:
    """Exchange a named effect for a rival if it is better with a remainder of its own: the present remainder was
    estimated beside the named effect, and favours it."""
    best, design = names, search.design
    for candidate in names.chosen:
        for rival in (r for r in search.rivals(names, candidate) if candidate not in r.chosen):
            differing = {*names.chosen} ^ {*rival.chosen}
            reached = {channel for c in differing for channel in search.design.affected_channels(c)}
            own, other = _with_own_remainder(search, rival, reached)
            if other.score < best.score and other.score < _with_own_remainder(search, names, reached)[1].score:
                best, design = other, own
    if best is names:
        return search, names
    search = Selection(design, search.prior, search.hypotheses)
    return search, search.optimise(search.fit(best.chosen, best))


def _with_own_remainder(search: Selection, found: JointFit, channels: Collection[int]) -> tuple[Design, JointFit]:
    """Estimate the remainder of some ``channels`` at a fit, and fit again."""
    design = found.with_fitted_remainder(search.design, channels)
    return design, fit(design, search.prior, found.chosen, found)


def _same(previous: JointFit | None, current: JointFit) -> bool:
    """True if the result equals that of the previous round, up to a fraction of the standard deviations."""
    if previous is None or {c.group for c in previous.chosen} != {c.group for c in current.chosen}:
        return False
    stds = np.sqrt(np.diag(current.covariance))
    shared = [term for term in current.terms if term in previous.terms]
    return all(
        abs(previous.value(term) - current.value(term)) < _SETTLED * stds[current.place(term)] for term in shared
    )


def _flexible_noise(
    problem: LinearisedProblem, columns: Columns, bare: JointFit, valid: BoolArray
) -> tuple[Autoregression, ...]:
    """Initial noise: the part of the residual outside the span of the columns of each channel's own joint and of the
    whole robot.

    Only as many of their directions are used as the rows can determine: with as few rows as directions, only rounding
    errors would remain, and noise estimated from these.
    """
    residual = problem.residual(bare, columns)
    noise_residual = np.full(residual.shape, np.nan)
    for channel in range(residual.shape[1]):
        chosen = valid[:, channel]
        joint = problem.model.channels[channel].joint
        own_columns = [
            by[channel] for term, by in columns.items() if channel in by and (joint in term.joints or not term.joints)
        ]
        matrix = np.column_stack(own_columns)[chosen] if own_columns else np.zeros((np.count_nonzero(chosen), 0))
        matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-12)
        directions, sizes, _ = np.linalg.svd(matrix, full_matrices=False)
        most = int(_DIRECTIONS_PER_ROW * len(matrix))
        directions = directions[:, :most][:, sizes[:most] > 1e-6 * np.max(sizes, initial=0.0)]
        rest = residual[chosen, channel]
        noise_residual[chosen, channel] = rest - directions @ (directions.T @ rest)
    return _noise(noise_residual, valid, problem.records)


def _noise(residual: FloatArray, valid: BoolArray, records: Records) -> tuple[Autoregression, ...]:
    usable = valid & np.isfinite(residual)
    channels = zip(residual.T, usable.T, strict=True)
    return tuple(Autoregression.fit(values, runs_of(mask, records.segment)) for values, mask in channels)


def _typical_size(residual: FloatArray, valid: BoolArray) -> FloatArray:
    """Standard deviation of each channel ``(C,)`` from the median absolute value, as if it were Gaussian."""
    channels = zip(np.abs(residual.T), valid.T, strict=True)
    medians = [np.median(values[used]) if np.any(used) else np.nan for values, used in channels]
    return np.array(medians) / _MEDIAN_OF_GAUSSIAN
