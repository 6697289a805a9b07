"""Readings: what the numbers of a recording may mean, and how probable each meaning is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.plausibility.evidence import Evidence, Products, evidence
from geomid_ros.plausibility.rows import GravityRows
from geomid_ros.types import BoolArray, FloatArray, IntArray

_ROUNDING = 1e-10
_FRICTION = 2.0  # standard deviations of a channel that friction may well explain
_OFFSET = 3.0
_ALIKE, _PART = 0.7, 0.5  # correlation of what links take, and share of what was measured


@dataclass(frozen=True, eq=False)
class Reading:
    """What the efforts of C joints may mean: joint c's is ``gains[c]`` times the measured number ``sources[c]``."""

    sources: IntArray
    gains: FloatArray


def as_it_is(channels: int) -> Reading:
    """Every number is what it says."""
    return Reading(np.arange(channels), np.ones(channels))


@dataclass(frozen=True, eq=False, kw_only=True)
class Efforts:
    """Efforts of C joints at N instants, and all that a model says of them.

    Attributes:
        measured: ``(N, C)``.
        spread: ``(C,)`` their standard deviations.
        rows: what they say of the links, by the part of gravity.
        friction: ``(N, C, 4)`` see :class:`GravityRows`.
        prior: ``(D,)`` the URDF's parameters.
        factor: ``(D, D)`` of the covariance of their errors.
    """

    measured: FloatArray
    spread: FloatArray
    still: FloatArray
    by_gravity: FloatArray
    friction: FloatArray
    prior: FloatArray
    factor: FloatArray

    @staticmethod
    def of(rows: GravityRows, joints: IntArray, prior: FloatArray, factor: FloatArray) -> Efforts:
        """The efforts of these joints, all of which are measured at all instants."""
        measured = rows.targets[:, joints]
        return Efforts(
            measured=measured,
            spread=np.std(measured, axis=0),
            still=rows.still[:, joints],
            by_gravity=rows.by_gravity[:, :, joints],
            friction=rows.friction[:, joints],
            prior=prior,
            factor=factor,
        )

    def fitted_gravity(self, parameters: FloatArray) -> FloatArray:
        """The gravity ``(3,)`` [m/s^2] under which links with these parameters ``(D,)`` explain efforts best."""
        left = (self.measured - self.still @ parameters) / self.spread
        gravity = (self.by_gravity @ parameters) / self.spread  # (3, N, C)
        both = np.concatenate([gravity, left[None]]).transpose(2, 1, 0)
        both = _without(self.friction, both)
        return np.asarray(np.linalg.lstsq(both[:, :, :3].reshape(-1, 3), both[:, :, 3].ravel(), rcond=1e-6)[0])


def _without(friction: FloatArray, columns: FloatArray) -> FloatArray:
    """Columns of each channel ``(C, N, k)`` without what its friction ``(N, C, 4)`` explains."""
    bases, _ = np.linalg.qr(friction.transpose(1, 0, 2))
    return np.asarray(columns - bases @ (bases.transpose(0, 2, 1) @ columns))


class World:
    """A robot under a gravity: judges readings of efforts."""

    def __init__(self, efforts: Efforts, gravity: FloatArray, *, weightless: bool = False) -> None:
        """
        Args:
            efforts: what was measured, and what the model says of it.
            gravity: ``(3,)`` [m/s^2].
            weightless: what the URDF's links weigh is not in the efforts, while their errors' weight is.
        """
        self.measured, self._friction = efforts.measured, efforts.friction
        self.spread = efforts.spread
        regressor = efforts.still + np.tensordot(gravity, efforts.by_gravity, 1)
        self.predicted = (efforts.still if weightless else regressor) @ efforts.prior
        """What the URDF predicts ``(N, C)``."""
        whitened = regressor @ efforts.factor
        scaled = whitened / self.spread[None, :, None]
        gram = np.tensordot(scaled, scaled, ((0, 1), (0, 1)))
        values, vectors = np.linalg.eigh(gram)
        self._basis = vectors[:, values > _ROUNDING * values[-1]]
        self._columns = np.concatenate([whitened @ self._basis, self._friction], axis=2)

    @property
    def columns(self) -> FloatArray:
        """What each channel's efforts may take beside the prediction ``(N, C, r + 4)``: of the links' errors, of unit
        variance, and of friction."""
        return self._columns

    @property
    def tolerated(self) -> FloatArray:
        """Standard deviations of friction's coefficients, see :func:`evidence` ``(C, 4)``."""
        return self._tolerated

    @cached_property
    def _unknowns(self) -> FloatArray:
        by_channel = self._columns.transpose(1, 2, 0)
        return np.asarray(by_channel @ by_channel.transpose(0, 2, 1))

    @cached_property
    def _crossed(self) -> FloatArray:
        """Columns of each channel times the measured efforts of all, and times its prediction ``(C, r + 4, C + 1)``."""
        channels = self.measured.shape[1]
        both = np.concatenate([np.repeat(self.measured[None], channels, 0), self.predicted.T[:, :, None]], axis=2)
        return np.asarray(self._columns.transpose(1, 2, 0) @ both)

    @cached_property
    def _tolerated(self) -> FloatArray:
        sizes = np.sqrt(np.mean(self._friction**2, axis=0))
        tolerated = _FRICTION / np.maximum(sizes, 1e-6)
        tolerated[:, 0] = _OFFSET
        return np.asarray(tolerated)

    def judge(self, reading: Reading) -> Evidence:
        """The evidence of a reading."""
        return evidence(self._products(reading), self._tolerated)

    def _products(self, reading: Reading) -> Products:
        channels = np.arange(len(reading.sources))
        spread = self.spread[reading.sources]
        sign, scale = np.sign(reading.gains) / spread, 1.0 / (np.abs(reading.gains) * spread)
        rank = self._columns.shape[2] - 4
        weights = np.concatenate([np.repeat(scale[:, None], rank, 1), np.ones((len(channels), 4))], axis=1)
        own = self.measured[:, reading.sources]
        crossed = sign[:, None] * self._crossed[channels, :, reading.sources] - scale[:, None] * self._crossed[:, :, -1]
        target = sign * own - scale * self.predicted
        return Products(
            counts=np.full(len(channels), float(len(own))),
            unknowns=weights[:, :, None] * self._unknowns * weights[:, None, :],
            crossed=weights * crossed,
            squares=np.sum(target**2, axis=0),
        )

    def fitted_slopes(self, found: Evidence) -> tuple[FloatArray, BoolArray]:
        """How many times as much the links that were found take as the URDF's, and whether that can be told: they
        explain a good part of what was measured, and do so as the URDF's do ``(C,)``."""
        rank = self._columns.shape[2] - 4
        own = self.predicted + self._columns[:, :, :rank] @ found.links
        own, nominal = own - np.mean(own, axis=0), self.predicted - np.mean(self.predicted, axis=0)
        crossed, size = np.sum(own * nominal, axis=0), np.maximum(np.sum(nominal**2, axis=0), 1e-30)
        alike = crossed > _ALIKE * np.sqrt(size * np.sum(own**2, axis=0))
        return crossed / size, alike & (np.std(own, axis=0) > _PART * self.spread)

    def links(self, found: FloatArray) -> FloatArray:
        """The links' errors ``(D,)`` in units of their covariance's factor, of those that evidence finds ``(r,)``."""
        return np.asarray(self._basis @ found)

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Of each channel the slope of what is measured over what the URDF predicts, and their squared correlation,
        both without what friction explains ``(C,)``."""
        both = _without(self._friction, np.stack([self.measured.T, self.predicted.T], axis=2))
        measured, predicted = both[:, :, 0], both[:, :, 1]
        crossed, own = np.sum(measured * predicted, axis=1), np.sum(predicted**2, axis=1)
        slopes = crossed / np.maximum(own, 1e-30)
        return slopes, crossed**2 / np.maximum(own * np.sum(measured**2, axis=1), 1e-30)
