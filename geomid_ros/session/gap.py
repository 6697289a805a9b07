"""The gap workflow for a session: from recordings, or from what the node remembers, to what is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.models.results import read_estimate
from geomid_ros.gap.candidates import library_columns
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.workflow import CUTOFF, GapSettings, find_gap
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import HELD_OUT, Progress, divided
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, Accepted
from geomid_ros.signals.pipeline import SignalPipeline

CUTOFF_PER_RATE = 0.4
"""The highest cutoff, as a share of the messages' rate."""
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


def effects_of(model: Path | None) -> list[str]:
    """Names of the effects that a model has already: the workflow looks for the others."""
    if model is None:
        return []
    return list(dict.fromkeys(str(entry["name"]) for entry in read_estimate(model)["effects"]))


def gap_session(urdf: str, configuration: Configuration, source: str) -> Session:
    """A session whose model has the effects of the configured ``model`` and no others.

    Args:
        urdf: text of the robot description.
        configuration: parameters; ``effects`` of it are replaced.
        source: where the description is from, for messages.

    Raises:
        InputError: these do not fit together.
    """
    model = configuration["model"]
    return Session(urdf, configuration.with_values({"effects": effects_of(Path(model) if model else None)}), source)


def rate(stamps: Sequence[int]) -> float:
    """Messages per second, from the first ones' stamps [ns]; infinite if they do not tell."""
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return 1e9 / period if period > 0.0 else np.inf


def gap_cutoff(session: Session, rate: float) -> float:
    """The low-pass [Hz] of recordings with ``rate`` joint messages per second: the configured one, or what the rate
    allows."""
    if "filter.cutoff" in session.configuration.given:
        return float(session.configuration["filter.cutoff"])
    return min(CUTOFF, CUTOFF_PER_RATE * rate)


def gap_pipeline(session: Session, cutoff: float) -> SignalPipeline:
    """A pipeline with a low-pass of ``cutoff`` [Hz] that makes samples for the gap workflow."""
    settings = replace(session.configuration.signals(session.robot.joint_names), cutoff=cutoff)
    return session.new_pipeline(settings, library_columns(session.model))


def find(session: Session, recordings: Recordings, progress: Progress) -> GapResult:
    """Run :func:`~geomid_ros.gap.workflow.find_gap` with the session's model and what is known of it.

    Raises:
        InputError: the recordings are too short, without motion or without anything measured.
    """
    return find_gap(
        session.model,
        recordings.train,
        recordings.held_out,
        GapSettings(cutoff=recordings.cutoff),
        nominal=session.prior,
        deviations=session.loaded.deviations(session.model),
        known=session.loaded.information(session.model),
        beside=session.loaded.beside_coefficients,
        simulated=recordings.simulated,
        progress=progress,
    )


def find_in_messages(session: Session, messages: Sequence[Accepted], progress: Progress) -> GapResult:
    """Run the workflow on messages that another pipeline has accepted; the last part of them is judged on.

    Raises:
        InputError: too little was measured.
    """
    first = [message.stamp for message in messages if message.topic == JOINT_STATES][:MESSAGES_FOR_RATE]
    cutoff = gap_cutoff(session, rate(first))
    pipeline = gap_pipeline(session, cutoff)
    for index, message in enumerate(messages):
        progress("reading", index / len(messages))
        pipeline.push_accepted(message)
    samples = pipeline.collect()
    if samples is None:
        raise InputError(
            f"too short: no usable samples in {len(messages)} messages, which are fewer than the filter's window takes "
            "or their topics do not overlap; half a minute of motion is needed"
        )
    ((train, held_out),) = divided([samples], HELD_OUT)
    return find(session, Recordings(cutoff=cutoff, train=[train], held_out=[held_out]), progress)
