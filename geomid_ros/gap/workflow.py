"""The gap workflow: from samples to findings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import chain
from time import perf_counter
from types import MappingProxyType

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.fit import CERTAINTY
from geomid_ros.estimation.starting_point import DEFAULT_PRIOR_STD
from geomid_ros.gap.analysis import analyse, known_remainder
from geomid_ros.gap.candidates import EffectsByPlace
from geomid_ros.gap.confirmed_changes import confirmed_changes, folded
from geomid_ros.gap.features import KnownRemainder
from geomid_ros.gap.linearised_problem import LinearisedProblem, root_mean_square, total_model
from geomid_ros.gap.records import FEWEST_ROWS, Records
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.verdict import HeldOut, changed_links, findings, locate_residuals, ranking, unexplained, verdict
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.fit import fit_of_prior
from geomid_ros.inference.prior import OtherRecordings, Prior
from geomid_ros.model.alike_parts import AlikeParts
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REST, Samples
from geomid_ros.options import Progress, silent
from geomid_ros.types import FloatArray

CUTOFF = 8.0
"""Cutoff of the low-pass on the workflow's samples [Hz], where the recording's rate allows it."""


_STD_OF_IDENTIFIED = 0.05  # of a link's inertia: replaces DEFAULT_PRIOR_STD, which is that of a URDF
_STD_OF_EFFECTS = 0.02  # of the coefficients that the model already has, relative
_LEAST_SHARE = 0.01  # fraction of the measurement: smaller coefficients are not known more accurately
_CERTAINTY_OF_IDENTIFIED = 100.0  # an identified model is hardly ever as wrong as a URDF


def find_gap(
    model: MeasurementModel,
    train: Sequence[Samples],
    held_out: Sequence[Samples],
    cutoff: float = CUTOFF,
    *,
    alike: Sequence[AlikeParts] = (),
    nominal: FloatArray | None = None,
    deviations: FloatArray | None = None,
    previous: OtherRecordings | None = None,
    other_effects: Sequence[KnownEffect] = (),
    known_remainder: KnownRemainder | None = None,
    ordinary: EffectsByPlace = MappingProxyType({}),
    masses_held: Sequence[int] = (),
    simulated: Sequence[Samples] = (),
    progress: Progress = silent,
) -> GapResult:
    """Find where a model and a measurement disagree, which effect causes it, and the residual on unseen data.

    The samples come from a pipeline made for the purpose, with a cutoff that the recordings' rate allows::

        SignalPipeline(
            robot.joint_names, ..., effect_columns=geomid_ros.gap.candidates.library_columns(model),
            settings=replace(signals, cutoff=cutoff),
        )

    Args:
        model: the robot, its wrench sensors, and the effects that are already part of the model (none for a bare URDF).
        train: data to fit, one element per recording, or per part of one without a pause, in the order of time: all
            samples of a stretch in ONE :class:`Samples`, not batches. Repeats of a motion (in one bag or in several)
            give the noise floor without a model.
        held_out: data to evaluate on, in the same form: the last 30 % of a bag, or other bags.
        cutoff: of that pipeline [Hz].
        alike: links that have most of their errors in the URDF in common, if the model has the URDF's inertias.
        nominal: the model's parameters ``(D,)``, NaN where they are not known: those of an ``estimate.json``. The
            URDF's inertias and no effects unless given.
        deviations: their standard deviations ``(D,)`` where ``previous`` does not give them, NaN where not known.
        previous: information of other recordings than ``train``, from which they were identified, on the links, or on
            these and all of the model's coefficients.
        other_effects: the model's effects that are not coefficients, because they depend on its prediction of a motion.
        known_remainder: the model's remainder on its own data, which is no change; see :func:`remainder_of_model`.
        ordinary: effects that ``identify`` finds, from rest and reversals, too: joints of this robot may well have
            them, so the written model has them unless a sure finding excludes them.
        masses_held: links that may leave their prior in the written model, but not with their mass: ``identify`` finds
            no other.
        simulated: recordings of the user's simulator under the same commands, in the same form; what they show as well
            as ``train`` is no gap.
        progress: called with the present stage and the finished fraction, 0 to 1.

    Returns:
        The findings, and all that tables, pictures and files need of them.

    Raises:
        InputError: the training or held-out data are too short or without motion, or contain nothing that the model
            predicts.
    """
    started = perf_counter()
    bare = model.without_effects()
    records = Records.make(train, cutoff)
    unseen = Records.make(held_out or train, cutoff)
    _check(bare, records)
    _check_held_out(bare, unseen)
    prior = replace(_prior(model, nominal, deviations, previous), alike=alike)
    prior, placed_effects = _with_other_effects(bare, records, prior, other_effects)
    if simulated:
        prior, known_remainder = _as_simulated(bare, Records.make(simulated, cutoff), prior, progress), None
    prior = _with_least_stds(bare, records, prior)
    analysis = analyse(bare, records, prior, progress, known_remainder, ordinary)
    progress("judging", 0.0)
    links = changed_links(bare, analysis)
    named = findings(bare, analysis)
    result = confirmed_changes(bare, records, analysis, named, links, masses_held)
    files = HeldOut(bare, unseen, replace(analysis, effects=result.found))
    # The inertias of a URDF are wrong on any robot; those of an identified or simulated model are not.
    is_named = bool(result.findings or (result.links and (prior.identified or simulated)))
    progress("judging", 1.0)
    named_terms = {term for candidate in result.found.chosen for term in candidate.terms}
    untouched = fit_of_prior(prior)
    problem = LinearisedProblem.at(bare, records, untouched)
    first = problem.residual(untouched)
    sure_joints = {finding.joint for finding in result.findings if finding.confidence == "confident"}
    before = folded(problem, untouched)
    after = folded(LinearisedProblem.at(bare, records, result.found), result.found)
    changes = {key: after.get(key, 0.0) - before.get(key, 0.0) for key in before.keys() | after}
    return GapResult(
        verdict=verdict(analysis, files, named=is_named),
        findings=result.findings,
        links=result.links,
        unexplained=unexplained(bare, analysis, files),
        unjudged=tuple(bare.channels[place].name for place in np.flatnonzero(files.unjudged)),
        channels=tuple(channel.name for channel in bare.channels),
        units=tuple(channel.unit for channel in bare.channels),
        floor=analysis.floor,
        cutoff=cutoff,
        gap=files.on_all,
        moving=files.gap.after,
        located=locate_residuals(bare, records, first, np.abs(records.rows(bare).targets - first)),
        ranking=ranking(bare, analysis, named, result.findings),
        trace=files.trace,
        bodies=bare.body_names,
        inertias=result.inertias,
        coefficients=_coefficients(model, prior, named_terms),
        beside=tuple(known for candidate, known in placed_effects if not named_terms.issuperset(candidate.terms)),
        ordinary=result.effects,
        folded=after,
        newly_folded={key: change for key, change in changes.items() if key[0] in sure_joints},
        seconds=perf_counter() - started,
    )


def remainder_of_model(
    model: MeasurementModel,
    train: Sequence[Samples],
    cutoff: float,
    nominal: FloatArray | None,
    other_effects: Sequence[KnownEffect],
) -> KnownRemainder | None:
    """Return the remainder of an identified model on its training data; elsewhere the same remainder is no change.

    Args:
        model: the robot, its wrench sensors, and the effects that are part of the model.
        train: data from which it was identified, as in :func:`find_gap`, of a pipeline with this ``cutoff`` [Hz].
        cutoff: of their low-pass [Hz].
        nominal: the model's parameters ``(D,)``, as in :func:`find_gap`.
        other_effects: the effects that it has in addition to these.

    Returns:
        None if there is too little motion, or no channel is informative.
    """
    bare, records = model.without_effects(), Records.make(train, cutoff)
    try:
        _check(bare, records)
    except InputError:
        return None
    prior, _ = _with_other_effects(bare, records, _prior(model, nominal), other_effects)
    remainder = known_remainder(bare, records, prior)
    return remainder if any(map(len, remainder.means)) else None


def residual_rms(
    model: MeasurementModel,
    samples: Sequence[Samples],
    cutoff: float,
    nominal: FloatArray | None,
    other_effects: Sequence[KnownEffect],
) -> FloatArray:
    """Return a model's residual RMS ``(C,)`` on samples, predicted as by :func:`find_gap` before it fits anything.

    Args:
        model: the robot, its wrench sensors, and the effects that are part of the model.
        samples: one element per recording, of a pipeline with this ``cutoff`` [Hz].
        cutoff: of their low-pass [Hz].
        nominal: the model's parameters ``(D,)``, as in :func:`find_gap`.
        other_effects: its other effects, which depend on its prediction of a motion: elastic gears, play.
    """
    bare, records = model.without_effects(), Records.make(samples, cutoff)
    prior, _ = _with_other_effects(bare, records, _prior(model, nominal), other_effects)
    untouched = fit_of_prior(prior)
    return root_mean_square(LinearisedProblem.at(bare, records, untouched).residual(untouched))


def _check(model: MeasurementModel, records: Records) -> None:
    """Refuse data from which nothing can be concluded."""
    if not records.dense or len(records.samples) < FEWEST_ROWS:
        raise InputError(
            f"too short: {len(records.samples) if records.dense else 0} independent instants at the filter's cutoff, "
            f"at least {FEWEST_ROWS} are needed; record half a minute of motion"
        )
    if not np.any(np.isfinite(records.rows(model).targets)):
        names = ", ".join(channel.name for channel in model.channels)
        raise InputError(f"no effort or wrench is measured: at least one of these channels is needed: {names}")
    if np.all(records.samples.column(REST) > 0.5):
        raise InputError("no joint moves: record a motion that takes all joints through their ranges")


def _check_held_out(model: MeasurementModel, unseen: Records) -> None:
    """Refuse held-out data on which nothing can be evaluated."""
    if not unseen.dense or not np.any(unseen.usable(model, unseen.rows(model).targets)):
        raise InputError(
            "no usable held-out data: no joint with measured effort moves, and no wrench is measured, or the data are "
            "too short; hold out more (--hold-out), or a recording in motion (--validate)"
        )


def _prior(
    model: MeasurementModel,
    nominal: FloatArray | None,
    deviations: FloatArray | None = None,
    known: OtherRecordings | None = None,
) -> Prior:
    size, unknown = len(model.nominal_inertias), np.full(model.dimension, np.nan)
    values = unknown if nominal is None else nominal
    stds = np.nan_to_num((unknown if deviations is None else deviations)[size:])
    inertias = np.where(np.isfinite(values[:size]), values[:size], model.nominal_inertias)
    coefficients = np.nan_to_num(values[size:])
    present = np.flatnonzero(coefficients)
    strengths = coefficients[present]
    changes = _STD_OF_EFFECTS * np.abs(strengths)
    if known is not None and len(known.changes):
        known = known.of_coefficients(present, changes)
    terms = tuple(EffectTerm.of(model.coefficients[place]) for place in present)
    identified = bool(np.any(np.isfinite(values[:size])))
    return Prior(
        inertias=inertias,
        prior_std=_STD_OF_IDENTIFIED if identified else DEFAULT_PRIOR_STD,
        terms=terms,
        values=strengths,
        prior_stds=np.maximum(changes, stds[present]),
        certainty=_CERTAINTY_OF_IDENTIFIED if identified else CERTAINTY,
        identified=identified,
        other_recordings=known if identified else None,
    )


def _with_other_effects(
    model: MeasurementModel, records: Records, prior: Prior, others: Sequence[KnownEffect]
) -> tuple[Prior, list[tuple[Candidate, KnownEffect]]]:
    """Return the prior with these effects in addition to the coefficients, and each effect with its candidate."""
    if not others:
        return prior, []
    situation = LinearisedProblem.at(model, records, fit_of_prior(prior)).situation
    candidates, values, prior_stds = [], list(prior.values), list(prior.prior_stds)
    for effect in others:
        cls, numbers = effect.cls, effect.values
        place = model.places.named(cls(), effect.joint)
        load = situation.typical_load(place)
        candidate, coefficients = Candidate.of(cls.from_values(numbers, load), place), cls.coefficients(numbers, load)
        candidates.append((candidate, effect))
        sizes = [coefficients[term.effect][term.index] for term in candidate.terms]
        values += sizes
        prior_stds += [max(_STD_OF_EFFECTS, _relative_std(candidate, effect)) * abs(value) for value in sizes]
    terms = chain.from_iterable(candidate.terms for candidate, _ in candidates)
    extended = replace(prior, terms=(*prior.terms, *terms), values=np.array(values), prior_stds=np.array(prior_stds))
    return extended, candidates


def _relative_std(candidate: Candidate, known_effect: KnownEffect) -> float:
    """Relative standard deviation of an effect in a file."""
    effect = candidate.effect
    sizes = effect.sizes(known_effect.parameters).values()
    known_sizes = (size for size in sizes if size.value and np.isfinite(size.std))
    return max((effect.within_motion(size) / abs(size.value) for size in known_sizes), default=0.0)


def _with_least_stds(model: MeasurementModel, records: Records, prior: Prior) -> Prior:
    """Let coefficients change by a small fraction of the measurement, unless they are larger than that. Next to a
    spring, an offset near zero is known no better than the spring's rest. Changes of larger ones must be named."""
    problem = LinearisedProblem.at(model, records, fit_of_prior(prior))
    least = _LEAST_SHARE * problem.typical_sizes(prior.terms)
    small = (np.abs(prior.values) < least) & np.isfinite(least)  # infinite where nothing is measured
    least = np.where(small, least, 0.0)
    known = prior.other_recordings
    if known is not None:
        known = replace(known, changes=np.maximum(known.changes, least[: len(known.changes)]))
    return replace(prior, prior_stds=np.maximum(prior.prior_stds, least), other_recordings=known)


def _as_simulated(model: MeasurementModel, records: Records, prior: Prior, progress: Progress) -> Prior:
    """Return the prior of the user's simulator: its inertias with payloads, and its effects, instead of the model's."""
    _check(model, records)
    likely = analyse(model, records, prior.without_other_recordings, progress).likely
    inertias = total_model(model, likely).inertias[list(model.identified)].ravel()
    values = np.array([likely.value(term) for term in likely.terms])
    return replace(
        prior,
        inertias=inertias,
        terms=likely.terms,
        values=values,
        prior_stds=_STD_OF_EFFECTS * np.abs(values),
        other_recordings=None,
        alike=(),
    )


def _coefficients(model: MeasurementModel, prior: Prior, named_terms: Collection[EffectTerm]) -> FloatArray:
    """The model's coefficients as given ``(coefficients,)``; NaN where absent or in ``named_terms``."""
    terms = [EffectTerm.of(coefficient) for coefficient in model.coefficients]
    is_kept = [term in prior.terms and term not in named_terms for term in terms]
    return np.array([prior.value(term) if kept else np.nan for term, kept in zip(terms, is_kept, strict=True)])
