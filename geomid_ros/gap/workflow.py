"""The gap workflow: from samples to a finding."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import chain
from time import perf_counter

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.fit import CERTAINTY
from geomid_ros.estimation.starting_point import USUAL_SPREAD
from geomid_ros.gap.analysis import analyse, standing_remainder
from geomid_ros.gap.candidates import Candidate, EffectTerm, NamesPrior, not_driving
from geomid_ros.gap.evidence.features import StandingRemainder
from geomid_ros.gap.evidence.linearised_problem import LinearisedProblem, root_mean_square, total_model
from geomid_ros.gap.evidence.record import FEWEST_ROWS, Records
from geomid_ros.gap.judgement.held_out import HeldOut, located
from geomid_ros.gap.judgement.verdict import changed_links, findings, ranking, unexplained, verdict
from geomid_ros.gap.judgement.written import folded, written
from geomid_ros.gap.result import GapResult
from geomid_ros.inference.fit import unfitted
from geomid_ros.inference.prior import OtherRecordings, Prior
from geomid_ros.model.alike_parts import AlikeParts
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.effects import KnownEffect, effect_class, values_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import REST, Samples
from geomid_ros.types import FloatArray

CUTOFF = 8.0
"""Low-pass of the samples that the workflow is given [Hz], where the recording's rate allows it."""


_SPREAD_OF_IDENTIFIED = 0.05  # of a link's inertia: in place of USUAL_SPREAD, which is that of a drawing
_SPREAD_OF_EFFECTS = 0.02  # of the coefficients that the model already has, relative
_LEAST_SHARE = 0.01  # of what is measured: what was found so small was found no better than this
_CERTAINTY_OF_IDENTIFIED = 100.0  # what was identified is hardly ever as wrong as a drawing
_LEAST_SPREAD = 1e-3


def find_gap(
    model: MeasurementModel,
    train: Sequence[Samples],
    held_out: Sequence[Samples],
    cutoff: float = CUTOFF,
    *,
    alike: Sequence[AlikeParts] = (),
    nominal: FloatArray | None = None,
    deviations: FloatArray | None = None,
    known: OtherRecordings | None = None,
    beside: Sequence[KnownEffect] = (),
    standing: StandingRemainder | None = None,
    simulated: Sequence[Samples] = (),
    progress: Callable[[str, float], None] | None = None,
) -> GapResult:
    """Find where a model and a measurement disagree, which effect that is, and what is left on unseen data.

    The samples come from a pipeline made for the purpose, with a cutoff that the recordings' rate allows::

        SignalPipeline(
            robot.joint_names, ..., effect_columns=geomid_ros.gap.candidates.library_columns(model),
            settings=replace(signals, cutoff=cutoff),
        )

    Args:
        model: the robot, its wrench sensors, and the effects that are already part of the model (none for a bare URDF).
        train: what is fitted, one element per recording, or per part of one without a pause, in the order of time: all
            samples of a stretch in ONE :class:`Samples`, not batches. Several motions alike (repeats in one bag or in
            several) give the noise floor without a model.
        held_out: what is judged on, in the same form: the last 30 % of a bag, or other bags.
        cutoff: of that pipeline [Hz].
        alike: links whose errors in the URDF are mostly the same ones, if the model has the URDF's inertias.
        nominal: the model's parameters ``(D,)``, NaN where they are not known: those of an ``estimate.json``. The
            URDF's inertias and no effects unless given.
        deviations: standard deviations ``(D,)`` of what ``known`` does not say of them, NaN where they are not known.
        known: what other recordings than ``train``, from which they were identified, say of the links, or of these and
            all of the model's coefficients.
        beside: the effects that the model has beside its coefficients, as they depend on what it says of a motion.
        standing: what the model lacked there, see :func:`lacking`; it is not counted as a change.
        simulated: recordings of the user's simulator under the same commands, in the same form; what they show as well
            as ``train`` is no gap.
        progress: called with what is being done and the finished share, 0 to 1.

    Returns:
        the findings, and all that tables, pictures and files need of them.

    Raises:
        InputError: the data, or those held out, are too short, without motion, or nothing is measured that the model
            predicts.
    """
    started = perf_counter()
    report = progress or _silent
    bare = model.without_effects()
    records = Records.make(train, cutoff)
    held = Records.make(held_out or train, cutoff)
    _check(bare, records)
    _check_held_out(bare, held)
    prior = replace(_prior(model, nominal, deviations, known), alike=alike)
    prior, own = _with_beside(bare, records, prior, beside)
    prior = _with_least_spreads(bare, records, prior)
    if simulated:
        prior, standing = _as_simulated(bare, Records.make(simulated, cutoff), prior, report), None
    analysis = analyse(bare, records, prior, report, standing)
    report("judging", 0.0)
    links = changed_links(bare, analysis)
    named = findings(bare, analysis)
    kept = written(bare, records, analysis, named, links)
    files = HeldOut(bare, held, replace(analysis, names=kept.found))
    # The inertias of drawings are wrong on any robot; those of a model that was identified, or simulates, are not.
    is_named = bool(kept.findings or (kept.links and (prior.identified or simulated)))
    report("judging", 1.0)
    said = {term for candidate in kept.found.chosen for term in candidate.terms}
    untouched = unfitted(prior)
    problem = LinearisedProblem(bare, records, total_model(bare, untouched))
    first = problem.residual(problem.columns((), prior.terms), untouched)
    sure = {finding.joint for finding in kept.findings if finding.confidence == "confident"}
    before = folded(problem, untouched)
    after = folded(LinearisedProblem(bare, records, total_model(bare, kept.found)), kept.found)
    changes = {key: after.get(key, 0.0) - before.get(key, 0.0) for key in before.keys() | after}
    return GapResult(
        verdict=verdict(analysis, files, named=is_named),
        findings=kept.findings,
        links=kept.links,
        unexplained=unexplained(bare, analysis, files),
        unjudged=tuple(bare.channels[place].name for place in np.flatnonzero(files.unjudged)),
        channels=tuple(channel.name for channel in bare.channels),
        units=tuple(channel.unit for channel in bare.channels),
        floor=analysis.floor,
        cutoff=cutoff,
        gap=files.on_all,
        moving=files.gap.after,
        located=located(bare, records, first, np.abs(_measured(bare, records) - first)),
        ranking=ranking(bare, analysis, named),
        trace=files.trace,
        bodies=bare.body_names,
        inertias=kept.inertias,
        coefficients=_coefficients(model, prior, said),
        beside=tuple(known for candidate, known in own if not said.issuperset(candidate.terms)),
        ordinary=kept.ordinary,
        folded=after,
        newly_folded={key: change for key, change in changes.items() if key[0] in sure},
        seconds=perf_counter() - started,
    )


def lacking(
    model: MeasurementModel,
    train: Sequence[Samples],
    cutoff: float,
    nominal: FloatArray | None,
    beside: Sequence[KnownEffect],
) -> StandingRemainder | None:
    """What an identified model lacks on the recordings that it is from, which is no change where others show it, too.

    Args:
        model: the robot, its wrench sensors, and the effects that are part of the model.
        train: what it was identified from, as in :func:`find_gap`, of a pipeline with this ``cutoff`` [Hz].
        cutoff: of their low-pass [Hz].
        nominal: the model's parameters ``(D,)``, as in :func:`find_gap`.
        beside: the effects that it has beside these.

    Returns:
        None if there is too little motion to tell, or no channel tells enough.
    """
    bare, records = model.without_effects(), Records.make(train, cutoff)
    try:
        _check(bare, records)
    except InputError:
        return None
    prior, _ = _with_beside(bare, records, _prior(model, nominal), beside)
    found = standing_remainder(bare, records, prior)
    return found if any(map(len, found.means)) else None


def left_by_model(
    model: MeasurementModel,
    samples: Sequence[Samples],
    cutoff: float,
    nominal: FloatArray | None,
    beside: Sequence[KnownEffect],
) -> FloatArray:
    """RMS ``(C,)`` of what a model leaves of samples, predicted as :func:`find_gap` does before it fits anything.

    Args:
        model: the robot, its wrench sensors, and the effects that are part of the model.
        samples: one element per recording, of a pipeline with this ``cutoff`` [Hz].
        cutoff: of their low-pass [Hz].
        nominal: the model's parameters ``(D,)``, as in :func:`find_gap`.
        beside: the effects that it has beside these, which depend on what it says of a motion: elastic gears, play.
    """
    bare, records = model.without_effects(), Records.make(samples, cutoff)
    prior = _prior(model, nominal)
    prior, _ = _with_beside(bare, records, prior, beside)
    untouched = unfitted(prior)
    problem = LinearisedProblem(bare, records, total_model(bare, untouched))
    return root_mean_square(problem.residual(problem.columns((), prior.terms), untouched))


def _silent(_: str, __: float) -> None:
    """No progress is shown."""


def _measured(model: MeasurementModel, records: Records) -> FloatArray:
    """What is measured at each channel ``(N, C)``."""
    return model.predict(records.samples, model.nominal_parameters)[0]


def _check(model: MeasurementModel, records: Records) -> None:
    """Refuse data of which nothing can be said."""
    if not records.dense or len(records.samples) < FEWEST_ROWS:
        raise InputError(
            f"too short: {len(records.samples) if records.dense else 0} independent instants at the filter's cutoff, "
            f"at least {FEWEST_ROWS} are needed; record half a minute of motion"
        )
    if not np.any(np.isfinite(_measured(model, records))):
        names = ", ".join(channel.name for channel in model.channels)
        raise InputError(f"no effort or wrench is measured: at least one of these channels is needed: {names}")
    if np.all(records.samples.column(REST) > 0.5):
        raise InputError("no joint moves: record a motion that takes all joints through their ranges")


def _check_held_out(model: MeasurementModel, held: Records) -> None:
    """Refuse held-out data that judge nothing."""
    if not held.dense or not np.any(held.usable(model, _measured(model, held))):
        raise InputError(
            "nothing to judge on: in the data that are held out no joint whose effort is measured moves, and no wrench "
            "is measured, or they are too short; hold out more (--hold-out), or a recording in motion (--validate)"
        )


def _prior(
    model: MeasurementModel,
    nominal: FloatArray | None,
    deviations: FloatArray | None = None,
    known: OtherRecordings | None = None,
) -> NamesPrior:
    size, unknown = len(model.nominal_inertias), np.full(model.dimension, np.nan)
    values = unknown if nominal is None else nominal
    unsure = np.nan_to_num((unknown if deviations is None else deviations)[size:])
    inertias = np.where(np.isfinite(values[:size]), values[:size], model.nominal_inertias)
    coefficients = np.nan_to_num(values[size:])
    own = np.flatnonzero(coefficients)
    strengths = coefficients[own]
    changes = np.maximum(_SPREAD_OF_EFFECTS * np.abs(strengths), _LEAST_SPREAD)
    if known is not None and len(known.changes):
        known = known.of_coefficients(own, changes)
    terms = tuple(_term(model.coefficients[place]) for place in own)
    identified = bool(np.any(np.isfinite(values[:size])))
    return Prior(
        inertias=inertias,
        spread=_SPREAD_OF_IDENTIFIED if identified else USUAL_SPREAD,
        terms=terms,
        values=strengths,
        spreads=np.maximum(changes, unsure[own]),
        certainty=_CERTAINTY_OF_IDENTIFIED if identified else CERTAINTY,
        identified=identified,
        known=known if identified else None,
        held=not_driving,
    )


def _term(coefficient: Coefficient) -> EffectTerm:
    """The term of an effect that the model already has."""
    return EffectTerm(coefficient.effect, coefficient.place, coefficient.index)


def _with_beside(
    model: MeasurementModel, records: Records, prior: NamesPrior, beside: Sequence[KnownEffect]
) -> tuple[NamesPrior, list[tuple[Candidate, KnownEffect]]]:
    """The prior with the effects ``beside`` the model's coefficients, and each of these with its candidate."""
    if not beside:
        return prior, []
    situation = LinearisedProblem(model, records, total_model(model, unfitted(prior))).situation
    own, values, spreads = [], list(prior.values), list(prior.spreads)
    for known in beside:
        cls, numbers = effect_class(known.effect), values_of(known)
        place = model.places.named(cls(), known.joint)
        load = situation.usual_load(place)
        candidate, coefficients = Candidate.of(cls.from_values(numbers, load), place), cls.coefficients(numbers, load)
        own.append((candidate, known))
        found = [coefficients[term.effect][term.index] for term in candidate.terms]
        values += found
        spreads += [max(_SPREAD_OF_EFFECTS, _unsure_share(candidate, known)) * abs(value) for value in found]
    terms = chain.from_iterable(candidate.terms for candidate, _ in own)
    extended = replace(prior, terms=(*prior.terms, *terms), values=np.array(values), spreads=np.array(spreads))
    return extended, own


def _unsure_share(candidate: Candidate, known: KnownEffect) -> float:
    """Standard deviation that a file says of an effect, relative."""
    effect = candidate.effect
    sizes = effect.sizes(known.parameters).values()
    known_sizes = (size for size in sizes if size.value and np.isfinite(size.std))
    return max((effect.within_motion(size) / abs(size.value) for size in known_sizes), default=0.0)


def _with_least_spreads(model: MeasurementModel, records: Records, prior: NamesPrior) -> NamesPrior:
    """The prior with coefficients that may change by a small share of the measurement, if they are no larger: beside a
    spring an offset near zero is no better known than the spring's rest. The change of a larger one is to be named."""
    problem = LinearisedProblem(model, records, total_model(model, unfitted(prior)))
    least = _LEAST_SHARE * problem.usual_sizes(prior.terms)
    small = (np.abs(prior.values) < least) & np.isfinite(least)  # where nothing is measured nothing is small
    least = np.where(small, least, 0.0)
    known = prior.known
    if known is not None:
        known = replace(known, changes=np.maximum(known.changes, least[: len(known.changes)]))
    return replace(prior, spreads=np.maximum(prior.spreads, least), known=known)


def _as_simulated(
    model: MeasurementModel, records: Records, prior: NamesPrior, report: Callable[[str, float], None]
) -> NamesPrior:
    """What the user's simulator shows: its inertias with their payloads, and its effects, in place of the model's."""
    _check(model, records)
    found = analyse(model, records, prior.by_itself, report).likely
    inertias = total_model(model, found).inertias[list(model.identified)].ravel()
    values = np.array([found.value(term) for term in found.terms])
    spreads = np.maximum(_SPREAD_OF_EFFECTS * np.abs(values), _LEAST_SPREAD)
    return replace(prior, inertias=inertias, terms=found.terms, values=values, spreads=spreads, known=None, alike=())


def _coefficients(model: MeasurementModel, prior: NamesPrior, said: Collection[EffectTerm]) -> FloatArray:
    """The model's own coefficients as they were given ``(coefficients,)``, NaN where it had none or a name has ``said``
    it."""
    terms = [_term(coefficient) for coefficient in model.coefficients]
    own = [term in prior.terms and term not in said for term in terms]
    return np.array([prior.value(term) if kept else np.nan for term, kept in zip(terms, own, strict=True)])
