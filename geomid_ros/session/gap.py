"""What the node and ``geomid gap`` share: from a session to samples for the gap workflow, and to what it finds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.models.results import read_estimate
from geomid_ros.gap.candidates import effect_columns
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.settings import CUTOFF, GapSettings
from geomid_ros.gap.workflow import find_gap
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, Accepted
from geomid_ros.signals.pipeline import SignalPipeline

HELD_OUT = 0.3
"""Share of a recording's time, at the end, that is judged on."""
CUTOFF_PER_RATE = 0.4
"""The highest cutoff, as a share of the messages' rate."""
MESSAGES_FOR_RATE = 64
"""So many at the beginning tell the rate."""


def effects_of(model: Path | None) -> list[str]:
    """The effects that a model has already; of the others it is to be found out whether they are missing."""
    if model is None:
        return []
    return list(dict.fromkeys(str(entry["name"]) for entry in read_estimate(model)["effects"]))


def gap_session(urdf: str, configuration: Configuration, source: str) -> Session:
    """A session whose model has the effects of the configured ``model`` and no others."""
    model = configuration["model"]
    return Session(urdf, configuration.with_values({"effects": effects_of(Path(model) if model else None)}), source)


def rate(stamps: Sequence[int]) -> float:
    """Messages per second, from the first ones' stamps [ns]; infinite if they do not tell."""
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return 1e9 / period if period > 0.0 else np.inf


def gap_cutoff(session: Session, rate: float) -> float:
    """The low-pass [Hz] of recordings with ``rate`` joint messages per second: the configured one, or what that
    allows."""
    if "filter.cutoff" in session.configuration.given:
        return float(session.configuration["filter.cutoff"])
    return min(CUTOFF, CUTOFF_PER_RATE * rate)


def gap_pipeline(session: Session, cutoff: float) -> SignalPipeline:
    """A pipeline that makes samples for the gap workflow."""
    settings = replace(session.configuration.signals(session.robot.joint_names), cutoff=cutoff)
    return session.new_pipeline(settings, effect_columns)


def divided(samples: Samples, share: float) -> tuple[Samples, Samples]:
    """The samples before the last ``share`` of their time, and those in it."""
    end = int(samples.stamps[-1]) + 1
    early = samples.stamps < end - round(share * (end - int(samples.stamps[0])))
    return samples.select(early), samples.select(~early)


def find(
    session: Session,
    train: Sequence[Samples],
    held_out: Sequence[Samples],
    cutoff: float,
    progress: Callable[[str, float], None],
    simulated: Sequence[Samples] = (),
) -> GapResult:
    """What :func:`~geomid_ros.gap.workflow.find_gap` finds with the session's model."""
    settings = GapSettings(cutoff=cutoff)
    return find_gap(
        session.model,
        train,
        held_out,
        settings,
        nominal=session.prior,
        deviations=session.loaded.deviations(session.model),
        known=session.loaded.information(session.model),
        simulated=simulated,
        progress=progress,
    )


def find_in_messages(
    session: Session, messages: Sequence[Accepted], progress: Callable[[str, float], None]
) -> GapResult:
    """The same in what another pipeline has accepted, the last part of which is judged on.

    Raises InputError when too little was measured.
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
    train, held_out = divided(samples, HELD_OUT)
    return find(session, [train], [held_out], cutoff, progress)
