"""Readings: what the numbers of a recording may mean, and how probable each meaning is."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.checks.evidence import Evidence, Products, deviations_of_links, evidence
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
    """Efforts of C joints at N instants, and what is known of them without the motion of links.

    Attributes:
        measured: ``(N, C)``.
        spread: ``(C,)`` standard deviations of the numbers that were measured.
        friction: ``(N, C, 4)`` see :class:`EffortRows`.
        prior: ``(D,)`` the URDF's parameters.
        factor: ``(D, D)`` of the covariance of their errors.
    """

    measured: FloatArray
    spread: FloatArray
    friction: FloatArray
    prior: FloatArray
    factor: FloatArray

    def fitted_gravity(self, still: FloatArray, by_gravity: FloatArray, parameters: FloatArray) -> FloatArray:
        """The gravity ``(3,)`` [m/s^2] under which links with these parameters ``(D,)`` explain efforts best.

        Args:
            still: ``(N, C, D)`` rows without gravity.
            by_gravity: ``(3, N, C, D)`` rows per unit of gravity along each axis.
            parameters: of the links.
        """
        left = (self.measured - still @ parameters) / self.spread
        gravity = (by_gravity @ parameters) / self.spread  # (3, N, C)
        both = np.concatenate([gravity, left[None]]).transpose(2, 1, 0)
        both = _without(self.friction, both)
        return np.asarray(np.linalg.lstsq(both[:, :, :3].reshape(-1, 3), both[:, :, 3].ravel(), rcond=1e-6)[0])


def _without(friction: FloatArray, columns: FloatArray) -> FloatArray:
    """Columns of each channel ``(C, N, k)`` without what its friction ``(N, C, 4)`` explains."""
    bases, _ = np.linalg.qr(friction.transpose(1, 0, 2))
    return np.asarray(columns - bases @ (bases.transpose(0, 2, 1) @ columns))


class World:
    """A robot in motion under gravity: judges readings of efforts."""

    def __init__(self, efforts: Efforts, regressor: FloatArray, predicted: FloatArray | None = None) -> None:
        """
        Args:
            efforts: what was measured.
            regressor: ``(N, C, D)`` of the efforts over the links' parameters.
            predicted: ``(N, C)`` what the URDF predicts; that of the regressor unless given.
        """
        self.measured, self._friction = efforts.measured, efforts.friction
        self.spread = efforts.spread
        self.predicted = regressor @ efforts.prior if predicted is None else predicted
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

    def with_unknown(self, column: FloatArray, centre: float) -> World:
        """The same with another unknown, which is normal with unit variance.

        Args:
            column: ``(N, C)`` what one of it adds to the efforts.
            centre: its most probable value, as seen from the one that this world has.
        """
        world = copy(self)
        rank = self._columns.shape[2] - 4
        world.predicted = self.predicted + centre * column
        world._columns = np.insert(self._columns, rank, column, axis=2)  # noqa: SLF001 its own
        for name in ("_unknowns", "_crossed"):
            world.__dict__.pop(name, None)
        return world

    def with_measured(self, measured: FloatArray) -> World:
        """The same of other efforts ``(N, C)``."""
        world = copy(self)
        world.measured, world.spread = measured, np.std(measured, axis=0)
        world.__dict__.pop("_crossed", None)
        return world

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

    def judge(self, reading: Reading, *, either_sign: bool = False) -> Evidence:
        """The evidence of a reading; with friction of either sign if wanted."""
        return evidence(self._products(reading), self._tolerated, either_sign=either_sign)

    def deviations_of_links(self, reading: Reading) -> FloatArray:
        """Standard deviations of the links' errors ``(r,)``, of what a reading finds."""
        return deviations_of_links(self._products(reading), self._tolerated)

    def friction(self, found: Evidence) -> FloatArray:
        """What viscous and dry friction take, as they were found, in standard deviations ``(N, C)``."""
        return np.asarray(np.einsum("nck,ck->nc", self._friction[:, :, 1:3], found.friction[:, 1:3]))

    def explained(self, found: Evidence) -> FloatArray:
        """What efforts as they are are explained by, in standard deviations ``(N, C)``."""
        rank = self._columns.shape[2] - 4
        links = self.predicted + self._columns[:, :, :rank] @ found.links
        return np.asarray(links / self.spread + np.einsum("nck,ck->nc", self._friction, found.friction))

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
        slopes, alike = self._compared(found)
        return slopes, alike > _ALIKE

    def opposite(self, found: Evidence) -> BoolArray:
        """Whether the links that were found take the opposite of what the URDF's do ``(C,)``: as if of mass below zero,
        which is what shows efforts with the wrong sign where links explain a good part of them."""
        return self._compared(found)[1] < -_ALIKE

    def _compared(self, found: Evidence) -> tuple[FloatArray, FloatArray]:
        """The slopes of what links take that were found over what the URDF's do, and their correlations, which are zero
        where they explain little of what was measured ``(C,)``."""
        rank = self._columns.shape[2] - 4
        own = self.predicted + self._columns[:, :, :rank] @ found.links
        own, nominal = own - np.mean(own, axis=0), self.predicted - np.mean(self.predicted, axis=0)
        crossed, size = np.sum(own * nominal, axis=0), np.maximum(np.sum(nominal**2, axis=0), 1e-30)
        alike = crossed / np.maximum(np.sqrt(size * np.sum(own**2, axis=0)), 1e-30)
        return crossed / size, np.where(np.std(own, axis=0) > _PART * self.spread, alike, 0.0)

    def links(self, found: FloatArray) -> FloatArray:
        """The links' errors ``(D,)`` in units of their covariance's factor, of those that evidence finds ``(r,)``."""
        return np.asarray(self._basis @ found[: self._basis.shape[1]])

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Of each channel the slope of what is measured over what the URDF predicts, and their squared correlation,
        both without what friction explains ``(C,)``."""
        both = _without(self._friction, np.stack([self.measured.T, self.predicted.T], axis=2))
        measured, predicted = both[:, :, 0], both[:, :, 1]
        crossed, own = np.sum(measured * predicted, axis=1), np.sum(predicted**2, axis=1)
        slopes = crossed / np.maximum(own, 1e-30)
        return slopes, crossed**2 / np.maximum(own * np.sum(measured**2, axis=1), 1e-30)
