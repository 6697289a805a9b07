"""Features of what a model may lack: curves of one variable, waves, drifts and the other joints of its chain, for each
channel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.gap.evidence.record import Records
from geomid_ros.model.effects import Situation
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray, IntArray

_SLOW_WAVES, _FAST_WAVES = range(2, 11), range(11, 33)  # per radian (or metre): cogging, ripple of gears
TIME = "time"
"""What features depend on that no other recording tells of."""
LARGEST_SCALE = 1e3
"""A column of rounding errors, as of a joint that stands still, is not made as large as one of a motion."""
_STRIBECK_SPEEDS = (0.02, 0.05, 0.12)  # [rad/s or m/s]


@dataclass(frozen=True, eq=False)
class Basis:
    """Where the features of a robot's remainder have their knots, for each joint's position, velocity and load
    ``(joints, 3, 2)``, and what the columns of each channel are multiplied by: ``scales (m,)``."""

    knots: FloatArray
    scales: tuple[FloatArray, ...]

    @staticmethod
    def of(model: MeasurementModel, records: Records, situation: Situation) -> Basis:
        """For what is measured: knots at the ends of each range; columns of other units than the channel's, each with a
        mean square of 1."""
        samples = records.samples
        variables = samples.position, samples.velocity, situation.predicted
        ends = np.array([[knots(own) for own in joint] for joint in zip(*(v.T for v in variables), strict=False)])
        scales = []
        for channel in range(len(model.channels)):
            blocks = _blocks(model, records, situation, channel, ends)
            scales.append(np.concatenate([_alike(own) if unit else np.ones(own.shape[1]) for _, own, unit in blocks]))
        return Basis(ends, tuple(scales))


@dataclass(frozen=True, eq=False)
class Features:
    """Columns ``(N, m)`` of a channel, in their ``block (m,)``, and the variable that each block ``depends_on``; the
    ``mean (m,)`` of their coefficients and its covariance, ``unsure (m, m)``, of which other recordings tell."""

    columns: FloatArray
    block: IntArray
    depends_on: tuple[str, ...]
    mean: FloatArray | None = None
    unsure: FloatArray | None = None

    @property
    def known(self) -> FloatArray:
        """What other recordings make one expect ``(N,)``."""
        return np.zeros(len(self.columns)) if self.mean is None else self.columns @ self.mean


@dataclass(frozen=True, eq=False, kw_only=True)
class StandingRemainder:
    """The remainder of a model, whose features' coefficients are Gaussian.

    Attributes:
        joints, channels: their names, in the order of the model.
        basis: of the features.
        means: of the coefficients of each channel ``(m,)`` [N m, N]; of one that told nothing ``(0,)``.
        triangles: upper ones ``(m, m)``, the T of which ``T'T`` is their covariance.
    """

    joints: tuple[str, ...]
    channels: tuple[str, ...]
    basis: Basis
    means: tuple[FloatArray, ...]
    triangles: tuple[FloatArray, ...]

    def beside(self, features: Sequence[Features]) -> list[Features]:
        """Features of all channels with what is known of them: of what depends on time, and of channels that told
        nothing, nothing."""
        known = []
        for own, mean, triangle in zip(features, self.means, self.triangles, strict=True):
            if not len(mean):
                known.append(own)
                continue
            lasting = np.array([name != TIME for name in own.depends_on])[own.block]
            unsure = triangle * lasting
            known.append(replace(own, mean=lasting * mean, unsure=unsure.T @ unsure))
        return known


def features(model: MeasurementModel, records: Records, situation: Situation, channel: int, basis: Basis) -> Features:
    """What the remainder of a channel may consist of: of a wrench's, of time and the joints alone.

    Raises InputError for a basis of other features.
    """
    names, columns, _ = zip(*_blocks(model, records, situation, channel, basis.knots), strict=True)
    block = np.repeat(np.arange(len(names)), [own.shape[1] for own in columns])
    if len(basis.scales[channel]) != len(block):
        raise InputError(
            f"the model's posterior.npz has {len(basis.scales[channel])} features of what it lacks at "
            f"{model.channels[channel].name}, this version has {len(block)}; identify again"
        )
    return Features(np.concatenate(columns, axis=1) * basis.scales[channel], block, names)


_Block = tuple[str, FloatArray, bool]  # what it depends on, its columns, and whether they are of several units


def _blocks(
    model: MeasurementModel, records: Records, situation: Situation, channel: int, ends: FloatArray
) -> Iterator[_Block]:
    if model.channels[channel].joint is not None:
        yield from _of_joint(records, situation, channel, ends[channel])
    yield from _of_others(model, records, situation, channel)


def _of_joint(records: Records, situation: Situation, joint: int, ends: FloatArray) -> Iterator[_Block]:
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


def _of_others(model: MeasurementModel, records: Records, situation: Situation, channel: int) -> Iterator[_Block]:
    samples = records.samples
    yield TIME, hats(time_of(records), (-1.0, 1.0), 5), False
    joint = model.channels[channel].joint
    others = range(len(model.robot.joints)) if joint is None else model.robot.chain(joint)
    for other in others:
        q = samples.position[:, other]
        columns = [samples.velocity[:, other], situation.sign[:, other], np.sin(q), np.cos(q)]
        if joint is not None:
            own = samples.position[:, joint]
            columns += [np.sin(q + own), np.cos(q + own), np.sin(q - own), np.cos(q - own)]
        yield model.robot.joint_names[other], np.stack(columns, axis=1), True


def _alike(columns: FloatArray) -> FloatArray:
    """Factors ``(m,)`` by which columns ``(N, m)`` have a mean square of 1, unless they are next to nothing."""
    return np.asarray(1.0 / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1.0 / LARGEST_SCALE))


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
