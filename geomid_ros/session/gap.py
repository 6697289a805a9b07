"""The gap workflow for a session: from recordings, or from what the node remembers, to what is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.posterior import POSTERIOR, check_of, places_in, read_posterior, read_remainder
from geomid_ros.gap.candidates import library_columns
from geomid_ros.gap.evidence.features import StandingRemainder
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.workflow import CUTOFF, find_gap, lacking, left_by_model
from geomid_ros.inference.prior import OtherRecordings
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress, silent
from geomid_ros.resimulation.resimulate import CUTOFF as SHARP_CUTOFF
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import HELD_OUT, Bags, divided, read_samples, samples_of_messages
from geomid_ros.session.session import Session, document
from geomid_ros.session.training import check_measured
from geomid_ros.signals.kernels import LOWEST_RATE_PER_CUTOFF
from geomid_ros.signals.messages import JOINT_STATES, Accepted, message_type, parse
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.signals.unitree import LOW_STATE
from geomid_ros.types import FloatArray

_LENGTHS = 0.1  # relative difference of two recordings of one motion
_MOTIONS = 0.5  # of the larger one's standard deviation: a simulation lags and droops, but does the same
_STILL = 0.02  # [rad, m] standard deviation of a joint that does not move
_LONGEST_SHIFT = 2.0  # [s] between the beginnings of the two recordings and of the motion in them
_STEP = 0.02  # [s]
MESSAGES_FOR_RATE = 64
"""The rate is that of so many messages at the beginning."""


@dataclass(frozen=True, kw_only=True)
class Recordings:
    """Samples for the gap workflow, one element per recording.

    Attributes:
        cutoff: low-pass of the samples [Hz].
        train: what is fitted.
        held_out: what is judged on.
        simulated: what the user's simulator did, if it was recorded.
    """

    cutoff: float
    train: Sequence[Samples]
    held_out: Sequence[Samples]
    simulated: Sequence[Samples] = ()


def gap_session(urdf: str, configuration: Configuration, source: str) -> Session:
    """A session whose model has the effects of the configured ``model`` and no others.

    Args:
        urdf: text of the robot description.
        configuration: parameters; ``effects`` and ``candidates`` of it do not count.
        source: where the description is from, for messages.

    Raises:
        InputError: these do not fit together.
    """
    return Session(urdf, configuration.with_values({"effects": [], "candidates": []}), source)


def identified_session(session: Session, estimate: Estimate) -> Session:
    """As :func:`gap_session`, but the model is what a session has identified so far.

    Raises:
        InputError: it cannot be a model.
    """
    file = EstimateFile.of(document(session, estimate), "the estimate so far")
    known = replace(LoadedModel.of(file), posterior=estimate.posterior)
    values = {"effects": [], "candidates": [], "model": "", "prior": ""}
    return Session(session.urdf, session.configuration.with_values(values), "robot_description", loaded=known)


def rate(stamps: Sequence[int]) -> float:
    """Messages per second, from the first ones' stamps [ns]; infinite if they do not tell."""
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return 1e9 / period if period > 0.0 else np.inf


def gap_cutoff(session: Session, rate: float) -> float:
    """The low-pass [Hz] of recordings with ``rate`` joint messages per second: the configured one, or what the rate
    allows."""
    if "filter.cutoff" in session.configuration.given:
        return float(session.configuration["filter.cutoff"])
    return min(CUTOFF, rate / LOWEST_RATE_PER_CUTOFF)


def gap_pipeline(session: Session, cutoff: float) -> SignalPipeline:
    """A pipeline with a low-pass of ``cutoff`` [Hz] that makes samples for the gap workflow."""
    return session.new_pipeline(_filtered_at(session, cutoff), library_columns(session.model))


def _filtered_at(session: Session, cutoff: float) -> SignalSettings:
    return replace(session.configuration.signals(session.robot.joint_names), cutoff=cutoff)


def find(session: Session, recordings: Recordings, standing: StandingRemainder | None, progress: Progress) -> GapResult:
    """Run :func:`~geomid_ros.gap.workflow.find_gap` with the session's model, what is known of it, and what it lacked
    where it was identified: ``standing``.

    Raises:
        InputError: the recordings are too short, without motion or without anything measured, or the robot stands on
            its legs and the model has effects that depend on loads.
    """
    if session.model.legs and session.loaded.beside_coefficients:
        raise InputError(
            f"{session.loaded.not_predicted}. On legs that stand, the ground loads the joints, too, and gaps cannot be "
            "found beside such effects; leave them out of the model"
        )
    known, deviations = known_of(session)
    return find_gap(
        session.model,
        recordings.train,
        recordings.held_out,
        recordings.cutoff,
        alike=session.alike,
        nominal=session.prior,
        deviations=deviations,
        known=known,
        beside=session.loaded.beside_coefficients,
        standing=standing,
        simulated=recordings.simulated,
        progress=progress,
    )


def known_of(session: Session) -> tuple[OtherRecordings | None, FloatArray]:
    """What the recordings of the session's model say of its links and, as far as that was kept, of its effects
    together; all masses may be off by a common share. And the standard deviations ``(D,)`` of what they do not say."""
    model, loaded, prior = session.model, session.loaded, session.prior
    deviations = loaded.deviations(model)
    if prior is None or loaded.known is None:
        return None, deviations
    if (posterior := _posterior_of(session)) is not None:
        known, unsaid = _of_posterior(posterior, model)
        deviations = np.where(np.isfinite(unsaid), unsaid, deviations)
    elif (links := loaded.information(model)) is not None:
        known = OtherRecordings(links.rows, links.residuals)
    else:
        return None, deviations
    if session.share_of_mass:
        masses = prior[: known.links].reshape(-1, 10) * ([1.0] * 4 + [0.0] * 6)  # gravity's
        known, _ = known.beside(session.share_of_mass * known.rows[:, : known.links] @ masses.reshape(-1, 1))
    return known, deviations


def _posterior_of(session: Session) -> Posterior | None:
    """What is known of the links of the session's model and its effects together. Raises InputError if the file beside
    the model is not of it."""
    loaded, posterior = session.loaded, session.loaded.posterior
    path = Path(loaded.source).with_name(POSTERIOR)
    if posterior is None and path.is_file():
        posterior = read_posterior(path)
        check_of(posterior, path, loaded.inertias or {}, loaded.source)
    return posterior if posterior is not None and {*session.model.body_names} <= {*posterior.links} else None


def _of_posterior(posterior: Posterior, model: MeasurementModel) -> tuple[OtherRecordings, FloatArray]:
    """What the data of a posterior say of the parameters of a model, off its estimate; and the standard deviations
    ``(D,)`` that effects had without them, NaN of those that it has not."""
    order, (rows, _) = places_in(posterior, model), posterior.evidence
    unsaid = np.abs(np.diag(posterior.jacobian)) * posterior.prior_spreads
    known = OtherRecordings(
        np.where(order >= 0, rows[:, order], 0.0), np.zeros(len(rows)), np.zeros(len(model.coefficients))
    )
    return known, np.where(order >= 0, unsaid[order], np.nan)


def standing_of(session: Session) -> StandingRemainder | None:
    """What the session's model lacked where it was identified; that this is not known is told."""
    source = session.loaded.source
    if session.loaded.known is None:
        return None
    path = Path(source).with_name(POSTERIOR)
    found = read_remainder(path) if path.is_file() else None
    if found is None:
        without = f"{path}: has no remainder" if path.is_file() else f"{source}: no {POSTERIOR} beside it"
        session.review.settled.append(f"{without}: changes are judged without it; identify again from bags to have it")
        return None
    names = tuple(channel.name for channel in session.model.channels)
    if (found.joints, found.channels) != (tuple(session.robot.joint_names), names):
        session.review.settled.append(
            f"{path}: its remainder is of {', '.join(found.channels)}, here {', '.join(names)} are measured; changes "
            "are judged without it"
        )
        return None
    return found


def remainder_of(session: Session, bags: Bags, progress: Progress = silent) -> StandingRemainder | None:
    """What a session's model lacks on the bags that it was identified from; None if they tell too little.

    Raises:
        InputError: a bag cannot be read.
    """
    cutoff, train = GapReader(session, bags, progress).train()
    return lacking(session.model, train, cutoff, session.prior, session.loaded.beside_coefficients)


def rms_of_model(session: Session, samples: Sequence[Samples]) -> FloatArray:
    """RMS residual of each channel ``(channels,)`` over samples, in batches, by the session's model with all of its
    effects, elastic gears and play included."""
    parameters, beside = session.prior, session.loaded.beside_coefficients
    if parameters is None or not beside:
        return session.rms(samples, session.known_parameters)
    cutoff = float(session.configuration["filter.cutoff"])
    return left_by_model(session.model, [Samples.concatenate(list(samples))], cutoff, parameters, beside)


def find_in_messages(
    session: Session, messages: Sequence[Accepted], standing: StandingRemainder | None, progress: Progress
) -> GapResult:
    """As :func:`find`, on messages that another pipeline has accepted; the last part of them is judged on.

    Raises:
        InputError: too little was measured.
    """
    cutoff, samples = _samples_of(session, messages, progress)
    session.review.check.add(samples)
    session.review.judge()
    ((train, held_out),) = divided([samples], HELD_OUT)
    return find(session, Recordings(cutoff=cutoff, train=[train], held_out=[held_out]), standing, progress)


def lacking_in_messages(
    session: Session, messages: Sequence[Accepted], progress: Progress = silent
) -> StandingRemainder | None:
    """What the model of an :func:`identified_session` lacks in messages that it is from; None if they tell too
    little."""
    try:
        cutoff, samples = _samples_of(session, messages, progress)
        return lacking(session.model, [samples], cutoff, session.prior, session.loaded.beside_coefficients)
    except (InputError, np.linalg.LinAlgError):  # what was found is worth having without it
        return None


def _samples_of(session: Session, messages: Sequence[Accepted], progress: Progress) -> tuple[float, Samples]:
    """The cutoff [Hz] and the samples of messages that another pipeline has accepted."""
    joint_stamps = [stamp for each in messages if each.topic == JOINT_STATES for stamp in each.stamps.tolist()]
    cutoff = gap_cutoff(session, rate(joint_stamps[:MESSAGES_FOR_RATE]))
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

    def read(self, simulated: Sequence[Path]) -> Recordings:
        """Read what is fitted and what is judged on.

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
        cutoff = gap_cutoff(self.session, self._rate([*fitted, *validate, *simulated]))
        whole = [self._whole(path, cutoff) for path in fitted]
        twins = [self._whole(path, cutoff) for path in simulated]
        for samples in whole:
            self.session.review.check.add(samples)
        self.session.review.judge()
        for pair in zip(simulated, twins, fitted, whole, strict=False):
            _check_twin(self.session, *pair)
        parts = [part for samples in whole for part in divided([samples], self.bags.share)]
        train, held_out = [early for early, _ in parts], [late for _, late in parts]
        held_out += [self._whole(path, cutoff) for path in validate]
        check_measured(self.session, train, fitted)
        if not any(map(len, held_out)):
            raise InputError(
                "nothing to judge on: hold out a part of the bags with --hold-out, or name others with --validate"
            )
        held_out = [samples for samples in held_out if len(samples)]
        return Recordings(cutoff=cutoff, train=train, held_out=held_out, simulated=twins)

    def train(self) -> tuple[float, list[Samples]]:
        """Read what is fitted, for the model as it is: the cutoff of its samples [Hz], and these, one element per bag.

        Raises:
            InputError: a bag cannot be used; it is named.
        """
        session, cutoff = self.session, gap_cutoff(self.session, self._rate(self.bags.fitted))
        # Effects beside the model's coefficients are of the library.
        columns = library_columns(session.model) if session.loaded.beside_coefficients else session.model.columns
        pipelines = [session.new_pipeline(_filtered_at(session, cutoff), columns) for _ in self.bags.fitted]
        whole = map(self._samples, self.bags.fitted, pipelines)
        return cutoff, [divided([samples], self.bags.share)[0][0] for samples in whole]

    def sharp(self, topic: str = "") -> list[Samples]:
        """Read what is judged on, one element per bag, with as high a cutoff as its rate allows.

        Args:
            topic: read the joints' set-points on this topic instead of the joint states.
        """
        shares = [(path, share) for path, share in self.bags.shares if share > 0.0]
        cutoff = min(SHARP_CUTOFF, self._rate([*self.bags.fitted, *self.bags.validate]) / LOWEST_RATE_PER_CUTOFF)
        return [self._late(path, share, cutoff, topic) for path, share in shares]

    def _late(self, path: Path, share: float, cutoff: float, topic: str) -> Samples:
        pipeline = self.session.new_pipeline(_filtered_at(self.session, cutoff))
        ((_, late),) = divided([self._samples(path, pipeline, topic)], share)
        return Samples.concatenate([late])  # a copy, which does not keep the whole recording

    def _whole(self, path: Path, cutoff: float) -> Samples:
        return self._samples(path, gap_pipeline(self.session, cutoff))

    def _samples(self, path: Path, pipeline: SignalPipeline, topic: str = "") -> Samples:
        topics = self.bags.topics
        topics = replace(topics, joint_states=topic, joint_option="--command") if topic else topics
        with Bag(path) as bag:
            return Samples.concatenate(list(read_samples(bag, self.session, pipeline, topics, self.progress)))

    def _rate(self, paths: Sequence[Path]) -> float:
        """Joint messages per second at the beginning of the slowest bag."""
        return min(rate(self._first_stamps(path)) for path in paths)

    def _first_stamps(self, path: Path) -> list[int]:
        with Bag(path) as bag:
            name, option = self.bags.topics.joint_states, "--joint-topic"
            topic = bag.find_topic(name, message_type(JOINT_STATES), option, LOW_STATE)
            if bag.topics[topic] == LOW_STATE:
                return [time for _, time, _ in islice(bag.raw_messages([topic]), MESSAGES_FOR_RATE)]
            first = [parse(JOINT_STATES, m) for _, _, m in islice(bag.messages([topic]), MESSAGES_FOR_RATE)]
        # A driver may publish more often than it measures.
        new = {tuple(array.tobytes() for array in each.arrays): each.stamp for each in first[::-1]}
        return sorted(new.values() if len(new) > 1 else {each.stamp for each in first})


def _check_twin(session: Session, simulated: Path, twin: Samples, recorded: Path, measured: Samples) -> None:
    """Refuse a simulator's recording of another motion than the measured one, naming both and what differs."""
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
    difference = _differences(_on_a_grid(twin), _on_a_grid(measured))
    spread = np.maximum(np.maximum(np.std(twin.position, axis=0), np.std(measured.position, axis=0)), _STILL)
    worst = int(np.argmax(difference / spread))
    if difference[worst] > _MOTIONS * spread[worst]:
        raise InputError(
            f"{simulated}: joint '{session.robot.joint_names[worst]}' moves otherwise than in {recorded}, by "
            f"{difference[worst]:.2g} on average where it moves by {spread[worst]:.2g}. Record the simulator under the "
            "same commands, from the same pose"
        )


def _on_a_grid(samples: Samples) -> FloatArray:
    """Positions ``(N, joints)`` every ``_STEP`` from the first sample on."""
    times = (samples.stamps - samples.stamps[0]) * 1e-9
    grid = np.arange(0.0, times[-1] + 1e-9, _STEP)
    return np.stack([np.interp(grid, times, np.unwrap(column)) for column in samples.position.T], axis=1)


def _differences(a: FloatArray, b: FloatArray) -> FloatArray:
    """Root mean square difference of positions ``(joints,)`` at the shift at which all are most alike."""
    most = round(_LONGEST_SHIFT / _STEP)
    shifts = [shift for shift in range(-most, most + 1) if abs(shift) < min(len(a), len(b))]
    found = [_rms(a[max(shift, 0) :], b[max(-shift, 0) :]) for shift in shifts]
    return found[int(np.argmin([np.sum(rms**2) for rms in found]))]


def _rms(a: FloatArray, b: FloatArray) -> FloatArray:
    count = min(len(a), len(b))
    rms: FloatArray = np.sqrt(np.mean((a[:count] - b[:count]) ** 2, axis=0))
    return rms
