"""Features of a model's remainder, by channel: curves of one variable, waves, drifts and other joints of its chain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.gap.records import Records
from geomid_ros.model.effects import Situation
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray, IntArray

_SLOW_WAVES, _FAST_WAVES = range(2, 11), range(11, 33)  # per radian (or metre): cogging, ripple of gears
TIME = "time"
"""Variable of the features on which other recordings give no information."""
LARGEST_SCALE = 1e3
"""Largest factor on a column: rounding errors, as of a joint at rest, are not scaled up to a motion."""
_STRIBECK_SPEEDS = (0.02, 0.05, 0.12)  # [rad/s or m/s]


@dataclass(frozen=True, eq=False)
class Basis:
    """Knots of the features of a robot's remainder, for each joint's position, velocity and load ``(joints, 3, 2)``,
    and the factors on the columns of each channel: ``scales (m,)``."""

    knots: FloatArray
    scales: tuple[FloatArray, ...]

    @staticmethod
    def of(model: MeasurementModel, records: Records, situation: Situation) -> Basis:
        """Create from the measurement: knots at the ends of each range; mean square 1 for blocks of several units."""
        samples = records.samples
        variables = samples.position, samples.velocity, situation.predicted
        ends = np.array([[knots(col) for col in joint] for joint in zip(*(v.T for v in variables), strict=False)])
        scales = []
        for channel in range(len(model.channels)):
            blocks = _blocks(model, records, situation, channel, ends)
            scales.append(np.concatenate([_scales(col) if unit else np.ones(col.shape[1]) for _, col, unit in blocks]))
        return Basis(ends, tuple(scales))


@dataclass(frozen=True, eq=False)
class Features:
    """Columns ``(N, m)`` of a channel, in their ``block (m,)``, and the variable that each block ``depends_on``; from
    other recordings, the ``mean (m,)`` of their coefficients and its covariance, ``covariance (m, m)``."""

    columns: FloatArray
    block: IntArray
    depends_on: tuple[str, ...]
    mean: FloatArray | None = None
    covariance: FloatArray | None = None

    @property
    def expected_remainder(self) -> FloatArray:
        """Remainder expected from other recordings ``(N,)``."""
        return np.zeros(len(self.columns)) if self.mean is None else self.columns @ self.mean

    @property
    def expected_variance(self) -> FloatArray:
        """Variance of the expected remainder ``(N,)``."""
        spread = 0.0 * self.columns if self.covariance is None else self.columns @ self.covariance
        return np.asarray(np.sum(spread * self.columns, axis=1))


@dataclass(frozen=True, eq=False, kw_only=True)
class KnownRemainder:
    """Remainder of a model, as Gaussian coefficients of features.

    Attributes:
        joints, channels: their names, in the order of the model.
        basis: of the features.
        means: of the coefficients of each channel ``(m,)`` [N m, N]; ``(0,)`` for an uninformative one.
        triangles: upper triangular T ``(m, m)``; ``T'T`` is their covariance.
    """

    joints: tuple[str, ...]
    channels: tuple[str, ...]
    basis: Basis
    means: tuple[FloatArray, ...]
    triangles: tuple[FloatArray, ...]

    def with_prior(self, features: Sequence[Features]) -> list[Features]:
        """Return the features with these coefficients, unless they depend on time or their channel is uninformative."""
        result = []
        for channel, mean, triangle in zip(features, self.means, self.triangles, strict=True):
            if not len(mean):
                result.append(channel)
                continue
            lasting = np.array([name != TIME for name in channel.depends_on])[channel.block]
            unsure = triangle * lasting
            result.append(replace(channel, mean=lasting * mean, covariance=unsure.T @ unsure))
        return result


def features(model: MeasurementModel, records: Records, situation: Situation, channel: int, basis: Basis) -> Features:
    """Features of a channel's remainder; for a channel of a wrench only of time and the joints.

    Raises InputError for a basis of other features.
    """
    names, columns, _ = zip(*_blocks(model, records, situation, channel, basis.knots), strict=True)
    block = np.repeat(np.arange(len(names)), [values.shape[1] for values in columns])
    if len(basis.scales[channel]) != len(block):
        raise InputError(
            f"the remainder in the model's posterior.npz has {len(basis.scales[channel])} features at "
            f"{model.channels[channel].name}, this version has {len(block)}; identify again"
        )
    return Features(np.concatenate(columns, axis=1) * basis.scales[channel], block, names)


_Block = tuple[str, FloatArray, bool]  # variable, columns, True if these have several units


def _blocks(
    model: MeasurementModel, records: Records, situation: Situation, channel: int, ends: FloatArray
) -> Iterator[_Block]:
    if model.channels[channel].joint is not None:
        yield from _joint_blocks(records, situation, channel, ends[channel])
    yield from _other_blocks(model, records, situation, channel)


def _joint_blocks(records: Records, situation: Situation, joint: int, ends: FloatArray) -> Iterator[_Block]:
    samples = records.samples
    q, v, a = (values[:, joint] for values in (samples.position, samples.velocity, samples.acceleration))
    sign, load = situation.sign[:, joint, None], situation.predicted[:, joint]
    yield "velocity", hats(v, ends[1], 8), False
    for name, values, curves in (("position", q, ends[0]), ("load", load, ends[2])):
        yield name, hats(values, curves, 8), False
        yield name, sign * hats(values, curves, 5), False
    for waves in (_SLOW_WAVES, _FAST_WAVES):
        yield "position", np.stack([wave(k * q) for k in waves for wave in (np.sin, np.cos)], axis=1), False
    yield TIME, time_of(records)[:, None] * np.column_stack([v, sign]), True
    yield "acceleration", np.stack([situation.load_rate[:, joint], a, a * np.abs(v)], axis=1), True
    yield "reversals", sign * np.stack([np.exp(-((v / speed) ** 2)) for speed in _STRIBECK_SPEEDS], axis=1), False


def _other_blocks(model: MeasurementModel, records: Records, situation: Situation, channel: int) -> Iterator[_Block]:
    samples = records.samples
    yield TIME, hats(time_of(records), (-1.0, 1.0), 5), False
    joint = model.channels[channel].joint
    others = range(len(model.robot.joints)) if joint is None else model.robot.chain(joint)
    for other in others:
        q = samples.position[:, other]
        columns = [samples.velocity[:, other], situation.sign[:, other], np.sin(q), np.cos(q)]
        if joint is not None:
            position = samples.position[:, joint]
            columns += [np.sin(q + position), np.cos(q + position), np.sin(q - position), np.cos(q - position)]
        yield model.robot.joint_names[other], np.stack(columns, axis=1), True


def _scales(columns: FloatArray) -> FloatArray:
    """Factors ``(m,)`` that give columns ``(N, m)`` a mean square of 1; bounded for almost zero ones."""
    return np.asarray(1.0 / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1.0 / LARGEST_SCALE))


def time_of(records: Records) -> FloatArray:
    """Time of the samples ``(N,)``, scaled to -1 to 1."""
    stamps = records.samples.stamps.astype(np.float64)
    return np.asarray(2.0 * (stamps - stamps[0]) / max(stamps[-1] - stamps[0], 1.0) - 1.0)


def knots(values: FloatArray) -> tuple[float, float]:
    """First and last knot of curves of a variable with these ``values (N,)``."""
    low, high = np.quantile(values, [0.005, 0.995])
    return float(low), float(high)


def hats(values: FloatArray, ends: tuple[float, float], count: int) -> FloatArray:
    """Piecewise linear functions ``(N, count)`` of a variable, with knots between two ends, which add up to 1."""
    low, high = ends
    place = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0) * (count - 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(count))))
