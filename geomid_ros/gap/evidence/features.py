"""Features of what a model may lack: curves of one variable, waves, drifts and the other joints, for each channel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geomid_ros.gap.evidence.record import Records
from geomid_ros.model.effects import Situation
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray, IntArray

_SLOW_WAVES, _FAST_WAVES = range(2, 11), range(11, 33)  # per radian (or metre): cogging, ripple of gears
_STRIBECK_SPEEDS = (0.02, 0.05, 0.12)  # [rad/s or m/s]


@dataclass(frozen=True, eq=False)
class Features:
    """Columns ``(N, m)`` of a channel, in their ``block (m,)``, and the variable that each block ``depends_on``."""

    columns: FloatArray
    block: IntArray
    depends_on: tuple[str, ...]


def features(model: MeasurementModel, records: Records, situation: Situation, channel: int) -> Features:
    """What the remainder of a channel may consist of: of a wrench's, of time and the joints alone."""
    own = model.channels[channel].joint is not None
    blocks = [*(_of_joint(records, situation, channel) if own else ()), *_of_others(model, records, situation, channel)]
    block = np.repeat(np.arange(len(blocks)), [columns.shape[1] for _, columns in blocks])
    names, columns = zip(*blocks, strict=True)
    return Features(np.concatenate(columns, axis=1), block, names)


def _of_joint(records: Records, situation: Situation, joint: int) -> Iterator[tuple[str, FloatArray]]:
    samples = records.samples
    q, v, a = (values[:, joint] for values in (samples.position, samples.velocity, samples.acceleration))
    sign, load = situation.sign[:, joint, None], situation.predicted[:, joint]
    yield "velocity", hats(v, knots(v), 8)
    for name, values in (("position", q), ("load", load)):
        curves = knots(values)
        yield name, hats(values, curves, 8)
        yield name, sign * hats(values, curves, 5)
    for waves in (_SLOW_WAVES, _FAST_WAVES):
        yield "position", np.stack([wave(k * q) for k in waves for wave in (np.sin, np.cos)], axis=1)
    yield "time", _alike(time_of(records)[:, None] * np.column_stack([v, sign]))
    yield "acceleration", _alike(np.stack([situation.load_rate[:, joint], a, a * np.abs(v)], axis=1))
    yield "reversals", sign * np.stack([np.exp(-((v / speed) ** 2)) for speed in _STRIBECK_SPEEDS], axis=1)


def _of_others(
    model: MeasurementModel, records: Records, situation: Situation, channel: int
) -> Iterator[tuple[str, FloatArray]]:
    samples = records.samples
    time = time_of(records)
    yield "time", hats(time, (-1.0, 1.0), 5)
    own = samples.position[:, channel] if model.channels[channel].joint is not None else None
    for other, name in enumerate(model.robot.joint_names):
        if own is None or other != channel:
            q = samples.position[:, other]
            columns = [samples.velocity[:, other], situation.sign[:, other], np.sin(q), np.cos(q)]
            if own is not None:
                columns += [np.sin(q + own), np.cos(q + own), np.sin(q - own), np.cos(q - own)]
            yield name, _alike(np.stack(columns, axis=1))


def _alike(columns: FloatArray) -> FloatArray:
    """Columns ``(N, m)`` of different units, each with a mean square of 1."""
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    return columns / np.where(sizes > 0.0, sizes, 1.0)


def time_of(records: Records) -> FloatArray:
    """Time of the samples ``(N,)``, from -1 to 1."""
    stamps = records.samples.stamps.astype(np.float64)
    return np.asarray(2.0 * (stamps - stamps[0]) / max(stamps[-1] - stamps[0], 1.0) - 1.0)


def knots(values: FloatArray) -> tuple[float, float]:
    """Where the first and the last knot of curves of a variable lie, with these ``values (N,)``."""
    low, high = np.quantile(values, [0.005, 0.995])
    return float(low), float(high)


def hats(values: FloatArray, ends: tuple[float, float], count: int) -> FloatArray:
    """Piecewise linear functions of a variable with knots between two ends, which add up to 1, ``(N, count)``."""
    low, high = ends
    place = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0) * (count - 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(count))))
