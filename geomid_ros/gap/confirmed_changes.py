"""The written model: the given one with all changes that are certain, and nothing else.

Friction that neither a URDF nor an MJCF can represent is approximated there by the kinds that both can.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import TypeAlias

import numpy as np

from geomid_ros.estimation.starting_point import DEFAULT_PRIOR_STD
from geomid_ros.gap import candidates as library
from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.candidates import CLEARLY
from geomid_ros.gap.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.records import Records, TotalModel
from geomid_ros.gap.result import LIKELY, Finding, LinkChange
from geomid_ros.gap.verdict import moment_without_mass, probability_by_size, widened_by_remainder, with_given_stds
from geomid_ros.geometry import spd
from geomid_ros.geometry.spd import Packed
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.design import Design
from geomid_ros.inference.fit import JointFit, fit, scattered
from geomid_ros.inference.prior import Prior
from geomid_ros.inference.probability import probability_of_square
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.effects import (
    DEFAULT_EFFECTS,
    KnownEffect,
    MotionEffect,
    ParameterForm,
    Quantity,
    identified_effect,
)
from geomid_ros.model.effects.effect import LoadEffect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

_REFITS = 2  # the second linearised at the result of the first
_UNCHANGED = 1e-3  # of its uncertainty: so little may a fixed parameter move
_DEFAULT = tuple(map(identified_effect, DEFAULT_EFFECTS))
_Ordinary: TypeAlias = tuple[Coefficient, ...]  # of one effect at one place


@dataclass(frozen=True, eq=False)
class ConfirmedChanges:
    """The ``found`` fit of the written model; its ``inertias (links, 10)``, of unchanged links exactly as given;
    ``findings`` and ``links`` with their sizes, without those that are less likely than nothing; and, where nothing was
    known of joints before, all ``effects`` of the written model, with or without a finding."""

    found: JointFit
    inertias: FloatArray
    findings: tuple[Finding, ...]
    links: tuple[LinkChange, ...]
    effects: tuple[KnownEffect, ...]


def confirmed_changes(
    model: MeasurementModel,
    records: Records,
    analysis: Analysis,
    findings: Sequence[tuple[Candidate, Finding]],
    links: Sequence[LinkChange],
    masses_held: Sequence[int] = (),
) -> ConfirmedChanges:
    """Undo the changes that have no sure name, and fit the rest again.

    During the search, all that the model has may drift a little, and unsure named effects absorb what they can. In a
    file, both would be unreported changes. So effects of the given model, and the links of an identified one, are as
    given unless a sure finding contradicts. A URDF has no friction: sizes are those beside the default effects of all
    joints. The written model has all that ``identify`` finds, too, which predicts better, though no cause may be sure.
    """
    changed = [model.body_names.index(link.link) for link in links if link.confidence == "confident"]
    sure = [candidate for candidate, finding in findings if finding.confidence == "confident"]
    refit = _Refit(model, records, analysis, changed)
    refitted, full, *_ = refit.found(sure)
    whole = refit.found([candidate for candidate, _ in findings])[0] if len(sure) < len(findings) else refitted
    sized = list(_findings_as_written(model, analysis, refitted, full, whole, findings))
    pairs = zip(findings, sized, strict=True)
    kept = [(c, before if before.confidence == after.confidence else after) for (c, before), after in pairs]
    sized_links = [_as_written(link, model, analysis, refitted, full) for link in links]
    pairs_of_links = zip(links, sized_links, strict=True)
    kept_links = [before if before.confidence == after.confidence else after for before, after in pairs_of_links]
    if (kept, kept_links) != (list(findings), list(links)):
        # A change that is no longer sure must not be in the file, and it affects all other sizes.
        return confirmed_changes(model, records, analysis, kept, kept_links, masses_held)
    likely = tuple(finding for finding in sized if finding.is_likely)
    likely_links = tuple(link for link in sized_links if link.probability >= LIKELY)
    prior = analysis.search.prior
    if prior.identified or prior.terms:
        inertias = np.where(refit.held[:, None], prior.inertias.reshape(-1, 10), refitted.inertias)
        return ConfirmedChanges(refitted, inertias, likely, likely_links, ())
    written, full, named, ordinary = replace(refit, as_identified=True, masses_held=masses_held).found(sure)
    effects = *(_named(model, written, full, each) for each in named), *(_known(written, full, e) for e in ordinary)
    return ConfirmedChanges(written, written.inertias, likely, likely_links, effects)


@dataclass(frozen=True, eq=False)
class _Refit:
    """Fits of the sure changes of an ``analysis``, the rest fixed; ``changed``: links that differ now.
    ``as_identified``: for a written model instead of sizes, with all effects that ``identify`` finds, to all samples,
    and links with prior stds of their own."""

    model: MeasurementModel
    records: Records
    analysis: Analysis
    changed: Collection[int]
    as_identified: bool = False
    masses_held: Sequence[int] = ()

    @property
    def held(self) -> BoolArray:
        """True for links that are as given ``(links,)``: in an identified model all that have not changed."""
        links = len(self.analysis.effects.prior_stds)
        return np.isin(np.arange(links), list(self.changed), invert=True) & self.analysis.search.prior.identified

    def found(self, sure: Sequence[Candidate]) -> tuple[JointFit, JointFit, list[Candidate], list[_Ordinary]]:
        """Fit the ``sure`` effects and significant ordinary effects, without those out of range, on the rows alone, as
        a file predicts from its parameters alone. Return the fit; the last one with all ordinary effects: what is not
        significant may be there all the same, and sizes are as unsure; and both kinds of effects in the fit."""
        every = self._ordinary_beside(sure)
        named, ordinary, found = [*sure], [*every], self.analysis.effects
        full = found
        total, floor = self._without_uncertain(sure), None if self.as_identified else self.analysis.floor
        for _ in range(_REFITS):
            problem = LinearisedProblem(self.model, self.records, total, floor)
            chosen = (term for candidate in named for term in candidate.terms)
            columns = problem.columns([*self.analysis.search.prior.terms, *chosen, *chain(*map(_terms, ordinary))])
            design = problem.design_alone(columns)
            while True:
                found = self._fit(problem, design, named, ordinary, found)
                full = found if len(ordinary) == len(every) else full
                if unclear := [each for each in ordinary if _evidence(found, each) < CLEARLY]:
                    ordinary.remove(min(unclear, key=partial(_evidence, found)))
                elif out_of_range := [c for c in named if self.analysis.search.is_out_of_range(found, c)]:
                    named.remove(out_of_range[0])
                else:
                    break
            total = total_model(self.model, found)
        return found, full, named, ordinary

    def _without_uncertain(self, sure: Sequence[Candidate]) -> TotalModel:
        """Total model without unsure effects: columns linearised at a delay that does not exist are wrong."""
        total = total_model(self.model, self.analysis.effects)
        kept = {*self.analysis.search.prior.terms, *(term for candidate in sure for term in candidate.terms)}
        places = {(term.effect, term.place) for term in kept}
        return replace(total, effects=tuple(item for item in total.effects if item[:2] in places))

    def _ordinary_beside(self, sure: Sequence[Candidate]) -> list[_Ordinary]:
        """Ordinary effects, if nothing is known of joints and sensors: default ones in the shapes that ``identify``
        finds; for a written model all that it finds."""
        if self.analysis.search.prior.identified or self.analysis.search.prior.terms:
            return []
        places, given = self.model.places, dict(self.analysis.ordinary)
        default = {(effect.name, place): effect for effect in _DEFAULT for place in places.of(effect)}
        shaped = {key: given.get(key, effect) for key, effect in default.items()}
        return [
            tuple(places.coefficients_at(effect, place))
            for (_, place), effect in (shaped | given if self.as_identified else shaped).items()
            if not any(other.includes(Candidate.of(effect, place)) for other in sure)
        ]

    def _fit(
        self,
        problem: LinearisedProblem,
        design: Design,
        named: Sequence[Candidate],
        ordinary: Sequence[_Ordinary],
        start: JointFit,
    ) -> JointFit:
        names = self.analysis.effects
        prior = _with_ordinary(_as_given(self.analysis.search.prior, named), problem, named, ordinary)
        prior = replace(prior, masses_held=self.masses_held)
        if not self.analysis.search.prior.identified:
            default_stds = None if self.as_identified else self.analysis.search.prior.link_prior_stds
            return scattered(design, fit(design, prior, named, start, default_stds))
        held = self.held
        tight = np.where(held, _UNCHANGED * prior.prior_std, names.prior_stds)
        result = scattered(design, fit(design, with_given_stds(prior, names.inflation), named, start, tight))
        default_stds = self.analysis.search.prior.link_prior_stds
        free = fit(design, with_given_stds(prior, 1.0), named, result, np.where(held, default_stds, names.prior_stds))
        return _as_uncertain(result, free)


def _as_uncertain(joint_fit: JointFit, free: JointFit) -> JointFit:
    """Give a fit the covariance of the parameters of one whose links are as uncertain as in other recordings. Sums that
    are known stay known: a payload's first moment without its mass. No standard deviation becomes smaller."""
    (from_blocks, from_diagonal), (blocks, diagonal) = (f.manifold.jacobian(f.point) for f in (free, joint_fit))
    change = np.asarray(np.linalg.solve(from_blocks, blocks), dtype=np.float64), diagonal / from_diagonal
    half = free.manifold.by_blocks(free.information, *change)
    information = free.manifold.by_blocks(half.T, *change)
    factors = np.sqrt(np.maximum(np.diag(joint_fit.inverse) / np.diag(spd.inverse(information)), 1.0))
    return replace(joint_fit, packed=Packed.of(information / np.outer(factors, factors)))


def _terms(ordinary: _Ordinary) -> list[EffectTerm]:
    return [EffectTerm.of(coefficient) for coefficient in ordinary]


def _evidence(joint_fit: JointFit, ordinary: _Ordinary) -> float:
    """Second-order loss of score without an effect: its squared deviation from zero in standard deviations; 0 if a
    coefficient has an impossible sign."""
    values = np.array([joint_fit.value(term) for term in _terms(ordinary)])
    if any(coefficient.positive and value <= 0.0 for coefficient, value in zip(ordinary, values, strict=True)):
        return 0.0
    return float(values @ np.linalg.solve(joint_fit.covariance_of(_terms(ordinary)), values))


def _with_ordinary(
    prior: Prior, problem: LinearisedProblem, named: Sequence[Candidate], ordinary: Sequence[_Ordinary]
) -> Prior:
    """Return a prior in which ordinary effects are a fraction of the measurement, as in ``identify``: a free offset
    would absorb gravity."""
    named_terms = {term for candidate in named for term in candidate.terms}
    terms = tuple(term for term in chain(*map(_terms, ordinary)) if term not in named_terms)
    sizes = problem.typical_sizes(terms)
    fractions = np.array([term.effect.prior_std_fraction or DEFAULT_PRIOR_STD for term in terms])
    prior_stds = fractions * np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0)  # any, if zero
    return replace(
        prior,
        terms=(*prior.terms, *terms),
        values=np.append(prior.values, np.zeros(len(terms))),
        prior_stds=np.append(prior.prior_stds, prior_stds),
    )


def _named(model: MeasurementModel, joint_fit: JointFit, full: JointFit, candidate: Candidate) -> KnownEffect:
    """Effect with a name in the form of files."""
    places, parameters = model.places, _as_unsure(model, joint_fit, full, candidate)
    sizes = {name: candidate.effect.between_motions(size) for name, size in candidate.effect.sizes(parameters).items()}
    return KnownEffect(candidate.name, places.name(candidate.place), places.link(candidate.place), parameters | sizes)


def _known(joint_fit: JointFit, full: JointFit, ordinary: _Ordinary) -> KnownEffect:
    """Effect in the form of files."""
    terms = _terms(ordinary)
    stds = np.sqrt(np.maximum(*(np.diag(found.covariance_of(terms)) for found in (joint_fit, full)))).tolist()
    parameters = dict[str, Quantity]()
    for coefficient, term, std in zip(ordinary, terms, stds, strict=True):
        value = joint_fit.value(term)
        parameters |= coefficient.parameters(value, float(np.hypot(std, coefficient.effect.drift * value)))
    return KnownEffect(ordinary[0].effect.name, ordinary[0].place_name, "", parameters)


def _as_unsure(
    model: MeasurementModel, joint_fit: JointFit, full: JointFit, candidate: Candidate, usual_load: float = 0.0
) -> dict[str, Quantity]:
    """Parameters of a candidate in a fit, with the standard deviations that they have in the ``full`` one if these are
    larger."""
    fits = joint_fit, full
    own, beside = (library.parameters(model, found, candidate, usual_load=usual_load) for found in fits)
    return {name: replace(q, std=max(q.std, beside[name].std)) for name, q in own.items()}


def _as_given(prior: Prior, sure: Sequence[Candidate]) -> Prior:
    """Return a prior in which only effects with a ``sure`` finding may change."""
    named = {term for candidate in sure for term in candidate.terms}
    factors = np.array([1.0 if term in named else _UNCHANGED for term in prior.terms])
    return replace(prior, prior_stds=factors * prior.prior_stds)


def _findings_as_written(
    model: MeasurementModel,
    analysis: Analysis,
    joint_fit: JointFit,
    full: JointFit,
    whole: JointFit,
    findings: Sequence[tuple[Candidate, Finding]],
) -> Iterator[Finding]:
    """Yield the findings with the written sizes. A sure effect that is impossible without the unsure ones is no surer
    than the likeliest of these. None is sure if its written size may be nothing, be it because unsure effects, which
    are in the ``whole`` fit, change it."""
    unsure = max((f.probability for _, f in findings if f.confidence != "confident"), default=0.0)
    for candidate, finding in findings:
        if finding.confidence != "confident":
            yield finding
        elif candidate in joint_fit.chosen:
            load = analysis.usual_load(candidate)
            parameters = _as_unsure(model, joint_fit, full, candidate, load)
            if candidate in whole.chosen:
                beside = library.parameters(model, whole, candidate, usual_load=load)
                parameters = {n: _including(q, beside[n].value) for n, q in parameters.items()}
            widened = widened_by_remainder(analysis, candidate, parameters, finding.was, finding.separability)
            sized = {**finding.parameters, **candidate.effect.sizes(widened)}
            identified = analysis.search.prior.identified  # moments of a URDF's links are as uncertain
            moment = moment_without_mass(joint_fit, candidate, sized) if identified else {}
            probability = min(finding.probability, probability_by_size(candidate, moment or parameters, finding.was))
            yield replace(finding, parameters=sized, moment=moment, probability=probability)
        else:
            yield replace(finding, probability=finding.probability * unsure)


def _as_written(
    link: LinkChange, model: MeasurementModel, analysis: Analysis, joint_fit: JointFit, full: JointFit
) -> LinkChange:
    """Return a changed link with the fitted size, and no surer than this size; an unsure link keeps its size."""
    if link.confidence != "confident":
        return link
    place = model.body_names.index(link.link)
    change: FloatArray = joint_fit.inertias[place] - analysis.search.prior.inertias.reshape(-1, 10)[place]
    mass, moment = _moved(link.mass, float(change[0])), _all_moved(link.moment, change[1:4])
    if not analysis.search.prior.identified:
        stds = np.sqrt(np.diag(full.body_covariance(place)))[:4].tolist()
        mass = replace(mass, std=max(mass.std, stds[0]))
        moment = {n: replace(q, std=max(q.std, s)) for (n, q), s in zip(moment.items(), stds[1:], strict=False)}
    sized = replace(link, mass=mass, moment=moment, centre=_all_moved(link.centre, change[1:4] / change[0]))
    return replace(sized, probability=min(link.probability, probability_of_square(sized.squared_significance)))


def _all_moved(sizes: Mapping[str, Quantity], values: FloatArray) -> dict[str, Quantity]:
    return {name: _moved(q, value) for (name, q), value in zip(sizes.items(), values.tolist(), strict=False)}


def _moved(quantity: Quantity, value: float) -> Quantity:
    """Replace a quantity's value, and widen its standard deviation to include the former value."""
    return _including(replace(quantity, value=value), quantity.value)


def _including(quantity: Quantity, former: float) -> Quantity:
    """Widen the standard deviation of a quantity to include its ``former`` value."""
    return replace(quantity, std=max(quantity.std, abs(quantity.value - former)))


def folded(problem: LinearisedProblem, found: JointFit) -> dict[tuple[str, str], float]:
    """Return the changes of joint attributes, as ``dynamics/damping``, in a file that represents no other friction.

    Linear friction that was found together with quadratic friction is wrong without it. So the file has the
    least-squares fit of its kinds to all friction that was found, over the fitted motion; all else is as found.
    """
    terms = [term for term in found.terms if isinstance(term.effect, MotionEffect | LoadEffect)]
    corrections: dict[tuple[str, str], float] = {}
    for joint, name in enumerate(problem.model.robot.joint_names):
        of_joint = [term for term in terms if term.joints == (joint,)]
        stored, others = [t for t in of_joint if _form(t).urdf], [t for t in of_joint if _is_unrepresentable(t)]
        if stored and others:
            changes = _changes(problem, found, joint, stored, others)
            corrections |= {(name, _form(term).urdf): change for term, change in zip(stored, changes, strict=True)}
    return corrections


def _changes(
    problem: LinearisedProblem,
    fitted: JointFit,
    joint: int,
    stored: Sequence[EffectTerm],
    others: Sequence[EffectTerm],
) -> list[float]:
    from scipy.optimize import nnls  # noqa: PLC0415 seldom needed

    columns = problem.columns([*stored, *others])
    values = np.array([fitted.value(term) for term in (*stored, *others)])
    stacked = np.stack([columns[term].get(joint, np.zeros(len(problem.records.samples))) for term in columns], axis=1)
    least, _ = nnls(stacked[:, : len(stored)], stacked @ values)
    changes: list[float] = (least - values[: len(stored)]).tolist()
    return changes


def _form(term: EffectTerm) -> ParameterForm:
    return term.effect.column_parameters[term.index]


def _is_unrepresentable(term: EffectTerm) -> bool:
    """True if neither file can represent it and it is no sensor error."""
    form = _form(term)
    return not (form.urdf or form.mjcf or term.effect.effort_shift({form.name: 1.0}))
