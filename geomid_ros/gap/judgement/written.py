"""The model that is written: the one that was given, with what is sure to be otherwise, and nothing else.

In a URDF and an MJCF friction that neither can say stands in those kinds that both can.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.estimation.starting_point import USUAL_SPREAD
from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.candidates import CLEARLY, Candidate, EffectTerm, NamesFit, NamesPrior
from geomid_ros.gap.evidence.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.evidence.record import Records, TotalModel
from geomid_ros.gap.judgement import sentences
from geomid_ros.gap.judgement.verdict import beside_remainder, probability_by_size, with_given_spreads
from geomid_ros.gap.result import LIKELY, Finding, LinkChange
from geomid_ros.geometry.definite import Packed
from geomid_ros.inference.design import Design
from geomid_ros.inference.fit import fit, scattered
from geomid_ros.inference.probability import probability_of_square
from geomid_ros.model.effects import (
    DEFAULT_EFFECTS,
    EFFECTS,
    KnownEffect,
    MotionEffect,
    ParameterForm,
    Quantity,
    effect_class,
    joints_of,
)
from geomid_ros.model.effects.effect import LoadEffect
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

_REFITS = 2  # the second along what the first one found
_UNCHANGED = 1e-3  # of its uncertainty: how much may move what is as it was
_ORDINARY = tuple(cls() for name, cls in EFFECTS.items() if name in DEFAULT_EFFECTS)


@dataclass(frozen=True, eq=False)
class Written:
    """The ``found`` fit; its ``inertias (links, 10)``, those of links that have not changed exactly as they were given;
    ``findings`` and ``links`` with the sizes that it has, without those in whose place there is rather nothing; and,
    where nothing was known of joints before, their ``ordinary`` effects, which need no name."""

    found: NamesFit
    inertias: FloatArray
    findings: tuple[Finding, ...]
    links: tuple[LinkChange, ...]
    ordinary: tuple[KnownEffect, ...]


def written(
    model: MeasurementModel,
    records: Records,
    analysis: Analysis,
    findings: Sequence[tuple[Candidate, Finding]],
    links: Sequence[LinkChange],
) -> Written:
    """Put back what has no sure name, and fit the rest anew.

    While names are looked for, all that the model has may drift a little, and names of which nobody is sure take what
    they can. In the file both would be changes that nobody is told of. So effects of the given model, and beside a
    model that was identified the links, are as they were given unless a sure finding says that they are not. A URDF
    alone says nothing of friction: there joints have what those of other robots have, as ``identify`` finds it.
    """
    changed = [model.body_names.index(link.link) for link in links if link.confidence == "confident"]
    sure = [candidate for candidate, finding in findings if finding.confidence == "confident"]
    refit = _Refit(model, records, analysis, changed)
    found = refit.found(sure)
    sized = list(_findings_as_written(model, analysis, found, findings))
    pairs = zip(findings, sized, strict=True)
    kept = [(c, before if before.confidence == after.confidence else after) for (c, before), after in pairs]
    sized_links = [_as_written(link, model, analysis, found) for link in links]
    pairs_of_links = zip(links, sized_links, strict=True)
    kept_links = [before if before.confidence == after.confidence else after for before, after in pairs_of_links]
    if (kept, kept_links) != (list(findings), list(links)):
        # What is no longer sure must not be in the file, on whose other sizes it bears.
        return written(model, records, analysis, kept, kept_links)
    ordinary = [c for c in found.chosen if c not in sure]
    return Written(
        found,
        np.where(refit.held[:, None], analysis.search.prior.inertias.reshape(-1, 10), found.inertias),
        tuple(finding for finding in sized if finding.is_likely),
        tuple(link for link in sized_links if link.probability >= LIKELY),
        tuple(_known(model, found, candidate) for candidate in ordinary),
    )


@dataclass(frozen=True, eq=False)
class _Refit:
    """Fits of what an ``analysis`` is sure of, the rest as it was; ``changed``: the links that are others now."""

    model: MeasurementModel
    records: Records
    analysis: Analysis
    changed: Collection[int]

    @property
    def held(self) -> BoolArray:
        """Which links are as they were given ``(links,)``: beside a model that was identified, all that have not
        changed."""
        links = len(self.analysis.names.spreads)
        return np.isin(np.arange(links), list(self.changed), invert=True) & self.analysis.search.prior.identified

    def found(self, sure: Sequence[Candidate]) -> NamesFit:
        """The fit of the ``sure`` names and of those ordinary effects that are there, without those that cannot be: on
        the rows alone, as a file predicts by its parameters alone."""
        named, ordinary, found = [*sure], self._ordinary_beside(sure), self.analysis.names
        total = self._without_unsure(sure)
        for _ in range(_REFITS):
            problem = LinearisedProblem(self.model, self.records, total, self.analysis.floor)
            columns = problem.columns([*named, *ordinary], self.analysis.search.prior.terms)
            design = problem.design_alone(columns)
            while True:
                found = self._fit(problem, design, named, ordinary, found)
                if (gone := self._untenable(found, ordinary)) is None:
                    break
                named, ordinary = ([c for c in own if c is not gone] for own in (named, ordinary))
            total = total_model(self.model, found)
        return found

    def _without_unsure(self, sure: Sequence[Candidate]) -> TotalModel:
        """What was found, without the names that are not sure: columns along a delay that is not there are others."""
        total = total_model(self.model, self.analysis.names)
        kept = {*self.analysis.search.prior.terms, *(term for candidate in sure for term in candidate.terms)}
        places = {(term.effect, term.place) for term in kept if isinstance(term, EffectTerm)}
        return replace(total, effects=tuple(own for own in total.effects if own[:2] in places))

    def _untenable(self, found: NamesFit, ordinary: Collection[Candidate]) -> Candidate | None:
        """One that cannot be; or else the least of the ordinary effects if it may as well be nothing; or else none."""
        absurd = [c for c in found.chosen if self.analysis.search.is_out_of_range(found, c)]
        if absurd or not ordinary:
            return min(absurd, key=lambda c: c not in ordinary, default=None)
        least = min(ordinary, key=lambda c: _evidence(found, c))
        return least if _evidence(found, least) < CLEARLY else None

    def _ordinary_beside(self, sure: Sequence[Candidate]) -> list[Candidate]:
        """The ordinary effects of all joints and sensors where nothing is known of them."""
        if self.analysis.search.prior.identified or self.analysis.search.prior.terms:
            return []
        ordinary = [Candidate.of(effect, place) for effect in _ORDINARY for place in self.model.places.of(effect)]
        return [c for c in ordinary if not any(c.excludes(other) for other in sure)]

    def _fit(
        self,
        problem: LinearisedProblem,
        design: Design,
        named: Sequence[Candidate],
        ordinary: Sequence[Candidate],
        start: NamesFit,
    ) -> NamesFit:
        names, spreads = self.analysis.names, self.analysis.search.prior.link_spreads
        prior = _with_ordinary(_as_given(self.analysis.search.prior, named), problem, named, ordinary)
        if not self.analysis.search.prior.identified:
            found = scattered(design, fit(design, prior, named, start, spreads))
            return replace(found, chosen=(*named, *ordinary))
        held = self.held
        firm = np.where(held, _UNCHANGED * prior.spread, names.spreads)
        found = scattered(design, fit(design, with_given_spreads(prior, names.inflation), named, start, firm))
        free = fit(design, with_given_spreads(prior, 1.0), named, found, np.where(held, spreads, names.spreads))
        return _as_unsure(found, free)


def _as_unsure(found: NamesFit, free: NamesFit) -> NamesFit:
    """A fit with standard deviations at least as large as those of one in which the links are as unsure as what other
    recordings say of them."""
    factors = np.sqrt(np.maximum(np.diag(free.inverse) / np.diag(found.inverse), 1.0))
    return replace(found, packed=Packed.of(found.information / np.outer(factors, factors)))


def _evidence(found: NamesFit, candidate: Candidate) -> float:
    """By how much the score would be worse without it, to second order: its squared deviations from nothing."""
    values = np.array([found.value(term) for term in candidate.terms])
    return float(values @ np.linalg.solve(found.covariance_of(candidate.terms), values))


def _with_ordinary(
    prior: NamesPrior, problem: LinearisedProblem, named: Sequence[Candidate], ordinary: Sequence[Candidate]
) -> NamesPrior:
    """A prior by which ordinary effects are a part of what is measured, as ``identify`` has it: a free offset would
    stand in for gravity."""
    said = {term for candidate in named for term in candidate.terms}
    terms = tuple(term for candidate in ordinary for term in candidate.terms if term not in said)
    sizes = problem.usual_sizes(terms)
    spreads = USUAL_SPREAD * np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0)  # of nothing: any
    return replace(
        prior,
        terms=(*prior.terms, *terms),
        values=np.append(prior.values, np.zeros(len(terms))),
        spreads=np.append(prior.spreads, spreads),
    )


def _known(model: MeasurementModel, found: NamesFit, candidate: Candidate) -> KnownEffect:
    """An effect as files have it."""
    parameters = sentences.parameters(model, found, candidate)
    return KnownEffect(candidate.name, model.places.name(candidate.place), "", parameters)


def _as_given(prior: NamesPrior, sure: Sequence[Candidate]) -> NamesPrior:
    """A prior by which only effects with a ``sure`` name may be others than they were."""
    named = {term for candidate in sure for term in candidate.terms}
    factors = np.array([1.0 if term in named else _UNCHANGED for term in prior.terms])
    return replace(prior, spreads=factors * prior.spreads)


def _findings_as_written(
    model: MeasurementModel, analysis: Analysis, found: NamesFit, findings: Sequence[tuple[Candidate, Finding]]
) -> Iterator[Finding]:
    """A sure name that is impossible without the unsure ones is no surer than the likeliest of these, and none is sure
    of which the size that is written may be nothing."""
    unsure = max((f.probability for _, f in findings if f.confidence != "confident"), default=0.0)
    for candidate, finding in findings:
        if finding.confidence != "confident":
            yield finding
        elif candidate in found.chosen:
            load = analysis.problem.situation.usual_load(candidate.place) if candidate.effect.scanned else 0.0
            parameters = sentences.parameters(model, found, candidate, usual_load=load)
            unsure_too = beside_remainder(analysis, candidate, parameters, finding.was)
            sized = {**finding.parameters, **candidate.effect.sizes(unsure_too)}
            told = analysis.search.prior.identified and finding.moment  # of a drawing the links' are as unsure
            moment = sentences.first_moment(found, candidate) if told else {}
            probability = min(finding.probability, probability_by_size(candidate, moment or parameters, finding.was))
            yield _said_again(replace(finding, parameters=sized, moment=moment, probability=probability))
        else:
            yield _said_again(replace(finding, probability=finding.probability * unsure))


def _said_again(finding: Finding) -> Finding:
    effect = effect_class(finding.effect)()
    sizes = finding.parameters, finding.was, finding.confidence
    said = sentences.sentence(effect, finding.joint, finding.link, *sizes, moment=finding.moment)
    return replace(finding, sentence=said)


def _as_written(link: LinkChange, model: MeasurementModel, analysis: Analysis, found: NamesFit) -> LinkChange:
    """A changed link with the size that was fitted, and no surer than that is told; one that is not sure keeps that
    which it seemed to have."""
    if link.confidence != "confident":
        return link
    place = model.body_names.index(link.link)
    change: FloatArray = found.inertias[place] - analysis.search.prior.inertias.reshape(-1, 10)[place]
    sized = replace(
        link,
        mass=_moved(link.mass, float(change[0])),
        moment=_all_moved(link.moment, change[1:4]),
        centre=_all_moved(link.centre, change[1:4] / change[0]),
    )
    return replace(sized, probability=min(link.probability, probability_of_square(sized.told)))


def _all_moved(quantities: Mapping[str, Quantity], values: FloatArray) -> dict[str, Quantity]:
    return {name: _moved(q, value) for (name, q), value in zip(quantities.items(), values.tolist(), strict=False)}


def _moved(quantity: Quantity, value: float) -> Quantity:
    """A quantity with another value, and a deviation that reaches the one that it had."""
    return replace(quantity, value=value, std=max(quantity.std, abs(value - quantity.value)))


def folded(problem: LinearisedProblem, found: NamesFit) -> dict[tuple[str, str], float]:
    """By how much a joint's attributes, as ``dynamics/damping``, differ in a file that says nothing else of friction.

    Linear friction that was found beside a quadratic one is wrong without it. So the file has the least-squares fit of
    what it can say to all that was found, over the motion that was fitted; all else is as it was found.
    """
    terms = [term for term in found.terms if isinstance(term, EffectTerm) and _is_of_one_joint(term)]
    corrections: dict[tuple[str, str], float] = {}
    for joint, name in enumerate(problem.model.robot.joint_names):
        own = [term for term in terms if joints_of(term.place) == (joint,)]
        said, unsaid = [t for t in own if _form(t).urdf], [t for t in own if _is_unsaid(t)]
        if said and unsaid:
            changes = _changes(problem, found, joint, said, unsaid)
            corrections |= {(name, _form(term).urdf): change for term, change in zip(said, changes, strict=True)}
    return corrections


def _changes(
    problem: LinearisedProblem, found: NamesFit, joint: int, said: Sequence[EffectTerm], unsaid: Sequence[EffectTerm]
) -> list[float]:
    from scipy.optimize import nnls  # noqa: PLC0415 seldom needed

    columns = problem.columns((), [*said, *unsaid])
    values = np.array([found.value(term) for term in (*said, *unsaid)])
    stacked = np.stack([columns[term].get(joint, np.zeros(len(problem.records.samples))) for term in columns], axis=1)
    least, _ = nnls(stacked[:, : len(said)], stacked @ values)
    changes: list[float] = (least - values[: len(said)]).tolist()
    return changes


def _is_of_one_joint(term: EffectTerm) -> bool:
    return isinstance(term.effect, MotionEffect | LoadEffect) and len(joints_of(term.place)) == 1


def _form(term: EffectTerm) -> ParameterForm:
    return term.effect.own[term.index]


def _is_unsaid(term: EffectTerm) -> bool:
    """Whether neither file says it, and it is no error of the sensor."""
    form = _form(term)
    return not (form.urdf or form.mjcf or term.effect.effort_shift({form.name: 1.0}))
