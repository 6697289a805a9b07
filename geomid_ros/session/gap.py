"""The gap workflow for a session: from recordings, or from messages that the node remembers, to findings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.identifier import BEYOND_PRECISION
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.posterior import (
    POSTERIOR,
    check_matches_estimate,
    places_in,
    read_posterior,
    read_remainder,
)
from geomid_ros.gap.candidates import EffectsByPlace, library_columns
from geomid_ros.gap.features import KnownRemainder
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.workflow import CUTOFF, find_gap, remainder_of_model, residual_rms
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.inference.prior import OtherRecordings
from geomid_ros.model.effects import DEFAULT_CANDIDATES, DEFAULT_EFFECTS
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress, silent
from geomid_ros.resimulation.resimulate import CUTOFF as SHARP_CUTOFF
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import (
    HELD_OUT,
    Bags,
    Training,
    check_measured,
    read_samples,
    samples_of_messages,
    split_held_out,
)
from geomid_ros.session.session import Session, document
from geomid_ros.session.unloaded import Unloaded
from geomid_ros.signals.kernels import LOWEST_RATE_PER_CUTOFF
from geomid_ros.signals.messages import JOINT_STATES, AcceptedMessages, message_type, parse
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.unitree import STATES
from geomid_ros.types import FloatArray

_LENGTHS = 0.1  # largest relative difference in duration of two recordings of one motion
_MOTIONS = 0.5  # largest RMS difference in position / larger standard deviation: a simulation lags and droops
_LONGEST_SHIFT = 2.0  # [s] between the recordings' beginnings and those of the motion in them
_STEP = 0.02  # [s] of the grid on which positions are compared
MESSAGES_FOR_RATE = 64
"""Number of messages at the beginning from which the rate is computed."""


@dataclass(frozen=True, kw_only=True)
class GapSamples:
    """Samples for the gap workflow, one element per recording.

    Attributes:
        cutoff: low-pass of the samples [Hz].
        train: samples to fit.
        held_out: samples to evaluate on.
        simulated: samples from the user's simulator, if it was recorded.
    """

    cutoff: float
    train: Sequence[Samples]
    held_out: Sequence[Samples]
    simulated: Sequence[Samples] = ()


@dataclass(frozen=True, eq=False)
class Identified:
    """Robot as ``identify`` finds it in the recordings of the workflow: the ``estimate`` of a ``session``."""

    session: Session
    estimate: Estimate

    @property
    def effects(self) -> EffectsByPlace:
        """The effects that it found."""
        coefficients = self.session.model.coefficients
        values = self.estimate.parameters[self.session.model.dimension - len(coefficients) :]
        return {(c.effect.name, c.place): c.effect for c, value in zip(coefficients, values, strict=True) if value}

    @property
    def usual_masses(self) -> list[int]:
        """Links whose mass may be that of the description."""
        nominal = self.session.model.nominal_inertias[::10]
        pairs = zip(self.estimate.links, nominal, strict=True)
        return [index for index, (link, mass) in enumerate(pairs) if link.may_weigh(mass)]


def gap_session(urdf: str, configuration: Configuration, source: str) -> Session:
    """Create a session whose model has only the effects of the configured ``model``.

    Args:
        urdf: text of the robot description.
        configuration: parameters; its ``effects`` and ``candidates`` are ignored.
        source: origin of the description, for messages.

    Raises:
        InputError: these do not fit together.
    """
    return Session(urdf, configuration.with_values({"effects": [], "candidates": []}), source)


def identified_session(session: Session, estimate: Estimate) -> Session:
    """Like :func:`gap_session`, but the model is the session's present estimate.

    Raises:
        InputError: the estimate is not a valid model.
    """
    file = EstimateFile.of(document(session, estimate), "the estimate so far")
    loaded = replace(LoadedModel.of(file), posterior=estimate.posterior)
    return session.again({"effects": [], "candidates": [], "model": "", "prior": ""}, loaded)


def message_rate(stamps: Sequence[int]) -> float:
    """Messages per second, from the first stamps [ns]; infinite if these do not determine it."""
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return 1e9 / period if period > 0.0 else np.inf


def gap_cutoff(session: Session, rate: float) -> float:
    """Low-pass cutoff [Hz] for joint messages at this ``rate`` [Hz]: the configured one, or what the rate
    allows."""
    if "filter.cutoff" in session.configuration.given_values:
        return float(session.configuration["filter.cutoff"])
    return min(CUTOFF, rate / LOWEST_RATE_PER_CUTOFF)


def gap_pipeline(session: Session, cutoff: float) -> SignalPipeline:
    """Create a pipeline with a low-pass of ``cutoff`` [Hz] that makes samples for the gap workflow."""
    return session.new_pipeline(cutoff, library_columns(session.model))


def find_gap_in_samples(
    session: Session,
    recordings: GapSamples,
    known_remainder: KnownRemainder | None,
    identified: Identified | None,
    progress: Progress,
) -> GapResult:
    """Run :func:`~geomid_ros.gap.workflow.find_gap` with the session's model, the information on it, and its remainder
    in the recordings that it was identified from: ``known_remainder``; without a model, with what was ``identified`` in
    the recordings.

    Raises:
        InputError: the recordings are too short, without motion or without anything measured, their efforts are none
            of this robot, or it stands on its legs and the model has effects that depend on loads.
    """
    if session.model.legs and session.loaded.situational_effects:
        raise InputError(
            f"{session.loaded.not_predicted}. For a standing legged robot, gaps cannot be found if the model has "
            "load-dependent effects; leave them out of the model"
        )
    information, deviations = prior_information(session)
    try:
        return find_gap(
            session.model,
            recordings.train,
            recordings.held_out,
            recordings.cutoff,
            alike=session.settings.alike,
            nominal=session.prior,
            deviations=deviations,
            previous=information,
            other_effects=session.loaded.situational_effects,
            known_remainder=known_remainder,
            ordinary={} if identified is None else identified.effects,
            masses_held=() if identified is None else identified.usual_masses,
            simulated=recordings.simulated,
            progress=progress,
        )
    except np.linalg.LinAlgError as error:
        raise InputError(BEYOND_PRECISION) from error


def identified_in(session: Session, recordings: GapSamples, readers: Collection[str] = ()) -> Identified | None:
    """Identify the robot of a session that has no model from the recordings to fit, for ``readers`` of descriptions,
    too; None if it has one, or these do not suffice."""
    if session.prior is not None:
        return None
    usual = _usual_session(session, recordings.cutoff, readers)
    training = Training(usual)
    for samples in recordings.train:
        training.add(samples)
    try:
        return Identified(usual, usual.identifier.solve())
    except InputError:  # the workflow says better what is missing
        return None


def _usual_session(session: Session, cutoff: float, readers: Collection[str] = ()) -> Session:
    """Session of the same robot whose model has the default effects, as ``identify``'s."""
    effects = {"effects": list(DEFAULT_EFFECTS), "candidates": list(DEFAULT_CANDIDATES)}
    configuration = session.configuration.with_values({**effects, "filter.cutoff": cutoff})
    return Session(session.urdf, configuration, session.source, readers=readers)


def prior_information(session: Session) -> tuple[OtherRecordings | None, FloatArray]:
    """Information from the recordings of the session's model on its links, jointly with its effects if that was kept;
    and standard deviations ``(D,)`` apart from this information. All masses may be off by a common fraction."""
    model, loaded, prior, unknown_scales = session.model, session.loaded, session.prior, 1
    deviations = loaded.coefficient_stds(model)
    if prior is None or loaded.links_information is None:
        return None, deviations
    if (posterior := _posterior_of(session)) is not None:
        order, (rows, _) = places_in(posterior, model), posterior.evidence
        stds = np.abs(np.diag(posterior.jacobian)) * posterior.prior_stds  # apart from the data; of effects only
        deviations = np.where((order >= 0) & np.isfinite(stds[order]), stds[order], deviations)
        informative = np.where(order >= 0, rows[:, order], 0.0)
        known = OtherRecordings(informative, np.zeros(len(rows)), np.zeros(len(model.coefficients)))
    elif (information := loaded.information(model)) is not None:
        known, unknown_scales = OtherRecordings(information.rows, information.residuals), 2  # theirs, too
    else:
        return None, deviations
    if session.relative_mass_std:
        masses = pseudo_inertia.weights_of(prior[: known.links].reshape(-1, 10))
        scale = np.sqrt(unknown_scales) * session.relative_mass_std
        known, _ = known.marginalised(scale * known.rows[:, : known.links] @ masses.reshape(-1, 1))
    return known, deviations


def _posterior_of(session: Session) -> Posterior | None:
    """Joint posterior of the model's links and effects; None if there is none. Raises InputError if the file next to
    the model does not belong to it."""
    loaded, posterior = session.loaded, session.loaded.posterior
    path = Path(loaded.source).with_name(POSTERIOR)
    if posterior is None and path.is_file():
        posterior = read_posterior(path)
        check_matches_estimate(posterior, path, loaded.inertias or {}, loaded.source)
    return posterior if posterior is not None and {*session.model.body_names} <= {*posterior.links} else None


def known_remainder_of(session: Session) -> KnownRemainder | None:
    """Remainder of the session's identified model; None for a URDF, or, with a note in the review, if none fits."""
    source = session.loaded.source
    if session.loaded.links_information is None:
        return None
    path = Path(source).with_name(POSTERIOR)
    stored = read_remainder(path) if path.is_file() else None
    names = tuple(channel.name for channel in session.model.channels)
    without = "changes are evaluated without the stored remainder"
    if stored is None:
        reason = f"{path}: has no remainder" if path.is_file() else f"{source}: no {POSTERIOR} in the same folder"
        note = f"{reason}: {without}; identify again from bags to store it"
    elif (stored.joints, stored.channels) != (tuple(session.robot.joint_names), names):
        measured = f"its remainder is of {', '.join(stored.channels)}, here {', '.join(names)} are measured"
        note = f"{path}: {measured}; {without}"
    else:
        return stored
    session.review.settled.append(note)
    return None


def remainder_of(session: Session, bags: Bags, progress: Progress = silent) -> KnownRemainder | None:
    """Remainder of a session's model on the bags that it was identified from; None if they are not informative enough.

    Raises:
        InputError: a bag cannot be read.
    """
    reader, known = GapReader(session, bags, progress), session.loaded.situational_effects
    cutoff = gap_cutoff(session, reader.rate(bags.fitted))
    # Effects in addition to the model's coefficients need columns of the library.
    columns = library_columns(session.model) if known else session.model.columns
    recorded = (reader.samples(path, session.new_pipeline(cutoff, columns)) for path in bags.fitted)
    train = [split_held_out(samples, bags.held_out_fraction)[0] for samples in recorded]
    return remainder_of_model(session.model, train, cutoff, session.prior, known)


def rms_of_model(session: Session, samples: Sequence[Samples]) -> FloatArray:
    """RMS residual of each channel ``(channels,)`` over samples, in batches, by the session's model with all of its
    effects, including elastic gears and backlash."""
    parameters, beside = session.prior, session.loaded.situational_effects
    if parameters is None or not beside:
        return session.rms(samples, session.known_parameters)
    cutoff = float(session.configuration["filter.cutoff"])
    return residual_rms(session.model, [Samples.concatenate(list(samples))], cutoff, parameters, beside)


def find_in_messages(
    session: Session, messages: Sequence[AcceptedMessages], known_remainder: KnownRemainder | None, progress: Progress
) -> GapResult:
    """Like :func:`find_gap_in_samples`, on messages accepted by another pipeline; their last part is held out.

    Raises:
        InputError: too little was measured.
    """
    cutoff, samples = _samples_of(session, messages, progress)
    session.review.check.add(samples)
    session.review.judge()
    train, held_out = split_held_out(samples, HELD_OUT)
    recordings = GapSamples(cutoff=cutoff, train=[train], held_out=[held_out])
    identified = identified_in(session, recordings)
    return find_gap_in_samples(session, recordings, known_remainder, identified, progress)


def remainder_in_messages(
    session: Session, messages: Sequence[AcceptedMessages], progress: Progress = silent
) -> KnownRemainder | None:
    """Remainder of an :func:`identified_session`'s model in its messages; None if they are not informative enough."""
    try:
        cutoff, samples = _samples_of(session, messages, progress)
        return remainder_of_model(session.model, [samples], cutoff, session.prior, session.loaded.situational_effects)
    except (InputError, np.linalg.LinAlgError):  # the remainder is optional
        return None


def _samples_of(session: Session, messages: Sequence[AcceptedMessages], progress: Progress) -> tuple[float, Samples]:
    """Cutoff [Hz] and samples of messages accepted by another pipeline."""
    joint_stamps = [stamp for message in messages if message.topic == JOINT_STATES for stamp in message.stamps.tolist()]
    cutoff = gap_cutoff(session, message_rate(joint_stamps[:MESSAGES_FOR_RATE]))
    samples = samples_of_messages(gap_pipeline(session, cutoff), messages, "reading", progress)
    if samples is None:
        raise InputError(
            f"too short: no usable samples in {sum(map(len, messages))} messages, which are fewer than the filter's "
            "window takes or their topics do not overlap; half a minute of motion is needed"
        )
    return cutoff, samples


@dataclass(frozen=True)
class GapReader:
    """Reads bags for the gap workflow, with the settings of a session."""

    session: Session
    bags: Bags
    progress: Progress = silent

    def read(self, simulated: Sequence[Path]) -> GapSamples:
        """Read the samples to fit and those to evaluate on, without those with a payload that is carried for a while.

        Args:
            simulated: recordings of the user's simulator, one for each fitted bag, or none.

        Raises:
            InputError: a bag cannot be used; it is named.
        """
        fitted, validate = self.bags.fitted, self.bags.validate
        if simulated and len(simulated) != len(fitted):
            raise InputError(
                f"{len(simulated)} recordings of a simulator for {len(fitted)} bags: give --simulated once "
                "for each bag, in their order"
            )
        cutoff = gap_cutoff(self.session, self.rate([*self.bags.all, *simulated]))
        recorded = [self._whole(path, cutoff) for path in fitted]
        twins = [self._whole(path, cutoff) for path in simulated]
        unloaded = Unloaded(_usual_session(self.session, cutoff))
        kept = [unloaded.kept(path, samples) for path, samples in zip(fitted, recorded, strict=True)]
        for samples in kept:
            self.session.review.check.add(samples)
        self.session.review.judge()
        for pair in zip(simulated, twins, fitted, recorded, strict=False):
            _check_twin(self.session, *pair)
        parts = [split_held_out(samples, self.bags.held_out_fraction) for samples in kept]
        train, held_out = [early for early, _ in parts], [late for _, late in parts]
        held_out += [unloaded.kept(path, self._whole(path, cutoff)) for path in validate]
        self.session.review.left_out = tuple(unloaded.left_out)
        check_measured(self.session, train, fitted)
        if not any(map(len, held_out)):
            why = [part.sentence for part in unloaded.left_out] or [
                "hold out a part of the bags with --hold-out, or name others with --validate"
            ]
            raise InputError(f"no held-out data: {'; '.join(why)}")
        held_out = [samples for samples in held_out if len(samples)]
        return GapSamples(cutoff=cutoff, train=train, held_out=held_out, simulated=twins)

    def high_cutoff_samples(self, topic: str = "") -> list[Samples]:
        """Read the samples to evaluate on, one element per bag, with the highest cutoff that the rate allows; the
        longest part if some are left out.

        Args:
            topic: read the joints' set-points on this topic instead of the joint states.
        """
        cutoff, late = min(SHARP_CUTOFF, self.rate(self.bags.all) / LOWEST_RATE_PER_CUTOFF), list[Samples]()
        for path, share in self.bags.held_out_fractions:
            if share > 0.0:
                samples = self.samples(path, self.session.new_pipeline(cutoff), topic)
                held_out = split_held_out(samples, share)[1]
                holes = sorted(part.begin for part in self.bags.left_out if part.path == path)
                ends = [0, *np.searchsorted(held_out.stamps, holes), len(held_out)]
                begin, end = max(pairwise(ends), key=lambda ends: ends[1] - ends[0])
                # A copy, so that the whole recording is not kept in memory.
                late.append(Samples.concatenate([held_out.select(slice(begin, end)), held_out.select(slice(0))]))
        return late

    def _whole(self, path: Path, cutoff: float) -> Samples:
        return self.samples(path, gap_pipeline(self.session, cutoff))

    def samples(self, path: Path, pipeline: SignalPipeline, topic: str = "") -> Samples:
        """Samples of a whole bag."""
        topics = self.bags.topics
        topics = replace(topics, joint_states=topic, joint_option="--command") if topic else topics
        with Bag(path) as bag:
            recording = list(read_samples(bag, self.session, pipeline, topics, self.progress))
        return self.bags.kept(path, Samples.concatenate(recording))

    def rate(self, paths: Sequence[Path]) -> float:
        """Joint messages per second at the beginning of the slowest bag."""
        return min(message_rate(self._first_stamps(path)) for path in paths)

    def _first_stamps(self, path: Path) -> list[int]:
        with Bag(path) as bag:
            name, option = self.bags.topics.joint_states, "--joint-topic"
            topic = bag.find_topic(name, message_type(JOINT_STATES), option, STATES)
            if bag.topics[topic] in STATES:
                return [message.time for message in islice(bag.raw_messages([topic]), MESSAGES_FOR_RATE)]
            first = [parse(JOINT_STATES, raw) for _, _, raw in islice(bag.messages([topic]), MESSAGES_FOR_RATE)]
        # A driver may publish more often than it measures.
        stamps = {tuple(array.tobytes() for array in message.arrays): message.stamp for message in first[::-1]}
        return sorted(stamps.values() if len(stamps) > 1 else {message.stamp for message in first})


def _check_twin(session: Session, simulated: Path, twin: Samples, recorded: Path, measured: Samples) -> None:
    """Refuse a simulator's recording of another motion than the measured one, naming both and their difference."""
    check_measured(session, [twin], [simulated])
    if len(twin) == len(measured) and np.array_equal(twin.position, measured.position):
        raise InputError(
            f"{simulated}: the same positions as in {recorded}, to the last digit: no simulator made them. Record what "
            "yours does under the same commands"
        )
    lengths = [float(samples.stamps[-1] - samples.stamps[0]) * 1e-9 for samples in (twin, measured)]
    if abs(lengths[0] - lengths[1]) > _LENGTHS * max(lengths):
        raise InputError(
            f"{simulated}: {lengths[0]:.1f} s of simulation for the {lengths[1]:.1f} s of {recorded}. Record the "
            "simulator under the same commands, from their beginning to their end"
        )
    difference = _rms_differences(_resampled(twin), _resampled(measured))
    deviations = np.maximum(np.std(twin.position, axis=0), np.std(measured.position, axis=0))
    motion = np.maximum(deviations, session.configuration["still_distance"])
    worst = int(np.argmax(difference / motion))
    if difference[worst] > _MOTIONS * motion[worst]:
        raise InputError(
            f"{simulated}: joint '{session.robot.joint_names[worst]}' moves otherwise than in {recorded}, by "
            f"{difference[worst]:.2g} on average where it moves by {motion[worst]:.2g}. Record the simulator under the "
            "same commands, from the same pose"
        )


def _resampled(samples: Samples) -> FloatArray:
    """Positions ``(N, joints)`` every ``_STEP`` from the first sample on."""
    times = (samples.stamps - samples.stamps[0]) * 1e-9
    grid = np.arange(0.0, times[-1] + 1e-9, _STEP)
    return np.stack([np.interp(grid, times, np.unwrap(column)) for column in samples.position.T], axis=1)


def _rms_differences(a: FloatArray, b: FloatArray) -> FloatArray:
    """RMS difference of positions ``(joints,)`` at the time shift that minimises the total difference."""
    longest = round(_LONGEST_SHIFT / _STEP)
    shifts = [shift for shift in range(-longest, longest + 1) if abs(shift) < min(len(a), len(b))]
    pairs = [(a[max(shift, 0) :], b[max(-shift, 0) :]) for shift in shifts]
    squares = [np.mean((a[: len(b)] - b[: len(a)]) ** 2, axis=0) for a, b in pairs]
    return np.asarray(np.sqrt(min(squares, key=np.sum)))
