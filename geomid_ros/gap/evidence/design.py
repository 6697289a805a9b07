"""Columns of the names, and whitened rows of every channel."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from geomid_ros.gap.candidates import EffectTerm
from geomid_ros.gap.evidence.features import Features
from geomid_ros.gap.evidence.noise import Autoregression, runs_of
from geomid_ros.gap.evidence.record import Records
from geomid_ros.inference.design import ChannelRows, Design
from geomid_ros.model.effects import MotionEffect, SensorEffect, Situation, SituationEffect
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.types import BoolArray, FloatArray

Columns = Mapping[EffectTerm, Mapping[int, FloatArray]]  # of each term, by channel: (N,)


def term_columns(
    model: MeasurementModel, records: Records, terms: Sequence[EffectTerm], situation: Callable[[], Situation]
) -> dict[EffectTerm, dict[int, FloatArray]]:
    """Columns of effects' terms at the chosen rows, by the channels that they reach; ``situation``, which takes
    long, is asked for only when a term needs it."""
    found: dict[EffectTerm, dict[int, FloatArray]] = {}
    for term in terms:
        if isinstance(term.effect, SituationEffect):
            columns = term.effect.columns(situation(), term.place)[:, :, term.index]
            found[term] = {channel: column for channel, column in enumerate(columns.T) if np.any(column)}
        elif isinstance(term.effect, MotionEffect | SensorEffect):
            found[term] = model.columns_of(records.samples, term.effect, term.place, term.index)
    return found


def design_of(
    rows: Rows,
    valid: BoolArray,
    columns: Columns,
    features: Sequence[Features],
    noise: Sequence[Autoregression],
    records: Records,
) -> Design:
    """From rows, which of them are ``valid (N, C)``, columns, features and noise of the channels."""
    channels = []
    for channel in range(rows.targets.shape[1]):
        terms = [term for term, by_channel in columns.items() if channel in by_channel]
        own = [columns[term][channel] for term in terms]
        inertial, target, remainder = rows.coefficients[:, channel], rows.targets[:, channel], features[channel]
        stacked = np.column_stack([inertial, *own, target, remainder.columns])
        white = noise[channel].whiten(stacked, runs_of(valid[:, channel], records.segment))
        place = {term: inertial.shape[1] + index for index, term in enumerate(terms)}
        first = inertial.shape[1] + len(own) + 1
        channels.append(ChannelRows.of(white[:, :first], white[:, first:], remainder.block, place))
    return Design.of(channels, rows.coefficients.shape[2])
