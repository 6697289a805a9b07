"""The most that links, friction and curves of each joint's own motion explain, beside which anything else is fitted.

Curves are what springs, cables and frictions of other laws add: what they explain is no evidence of a fault.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.checks.evidence import SPREAD, Evidence, evidence
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.model.samples import STILL
from geomid_ros.types import BoolArray, FloatArray

_SLOW = 0.05  # of a joint's largest speed: below it stiction holds whatever it likes


@dataclass(frozen=True, eq=False, kw_only=True)
class Gain:
    """What more columns explain.

    Attributes:
        per_instant: gain of log evidence [nats].
        ratios: ``(C,)`` of what is left, over what is left without the columns.
        coefficients, deviations: ``(k,)`` of the columns.
        rigid: ``(N, C)`` what the links take beside them.
    """

    per_instant: float
    ratios: FloatArray
    coefficients: FloatArray
    deviations: FloatArray
    rigid: FloatArray

    def beyond(self, other: Gain) -> Gain:
        """What these columns explain more than others do."""
        return replace(self, per_instant=self.per_instant - other.per_instant, ratios=self.ratios / other.ratios)


class FlexibleFit:
    """Links, friction and curves fitted to the efforts of C joints at the instants at which each of them moves."""

    def __init__(
        self,
        *,
        measured: FloatArray,
        predicted: FloatArray,
        links: FloatArray,
        friction: FloatArray,
        tolerated: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
    ) -> None:
        """
        Args:
            measured, predicted: ``(N, C)`` the efforts, and those of the URDF's links.
            links: ``(N, C, r)`` columns of the links' errors.
            friction: ``(N, C, 4)`` those of friction.
            tolerated: ``(C, 4)`` standard deviations of friction's coefficients.
            position, velocity: ``(N, C)`` of the joints.
        """
        self.measured, self._predicted, self._tolerated = measured, predicted, tolerated
        self.spread = np.std(measured, axis=0)
        self._rank = links.shape[2]
        self._moving = moving(velocity).astype(np.float64)
        self._counts = np.maximum(np.sum(self._moving, axis=0), 1.0)
        self.instants = float(np.mean(self._counts))
        """How many instants there are, on average over channels."""
        curves = by_channel(_curves(position, friction, predicted) * self.spread[:, None])
        self._columns = np.concatenate([links, curves], axis=2)
        self._friction = friction
        self.nominal = self._evidence(self._columns)
        """The evidence of nothing else."""
        self.links = self.nominal.links[: self._rank]
        """The links' errors ``(r,)`` that are found."""
        self.rigid = self._rigid(self.links)
        """What the fitted links take ``(N, C)``."""
        self._weights = self._moving / (self.spread * self.nominal.sigmas)
        self._screen()

    def promise(self, columns: FloatArray) -> float:
        """About the least that :meth:`gain` finds, at the noise that is left without the columns [nats per instant].

        Args:
            columns: ``(N, C, k)`` in units of the efforts, per standard deviation of their coefficients.
        """
        rows = (columns * self._weights[:, :, None]).reshape(-1, columns.shape[2])
        coupling = self._known.T @ rows
        sizes, axes = np.linalg.eigh(rows.T @ rows - coupling.T @ coupling)
        precisions = 1.0 + np.maximum(sizes, 0.0)  # of efforts next to nothing rounding leaves sizes below zero
        pull = rows.T @ self._left
        quadratic = float(np.sum((axes.T @ pull) ** 2 / precisions))
        return 0.5 * (quadratic - float(np.sum(np.log(precisions)))) / self.instants

    def gain(self, columns: FloatArray) -> Gain:
        """What columns explain, as :meth:`promise` takes them."""
        found = self._evidence(np.concatenate([self._columns, columns], axis=2))
        return Gain(
            per_instant=(found.log - self.nominal.log) / self.instants,
            ratios=found.sigmas / self.nominal.sigmas,
            coefficients=found.links[self._columns.shape[2] :],
            deviations=found.deviations()[self._columns.shape[2] :],
            rigid=self._rigid(found.links[: self._rank]),
        )

    def _rigid(self, links: FloatArray) -> FloatArray:
        return np.asarray(self._predicted + self._columns[:, :, : self._rank] @ links)

    def _evidence(self, columns: FloatArray) -> Evidence:
        """The evidence of columns ``(N, C, k)`` whose coefficients have unit variance, and friction."""
        target = (self.measured - self._predicted) / self.spread
        scaled = columns / self.spread[:, None]
        return evidence(target, scaled, self._friction, self._tolerated, counted=self._moving)

    def _screen(self) -> None:
        """Linearise at what was found, with the friction that may have either sign: the constants alone are."""
        offsets = by_channel(np.broadcast_to(self.spread[None, :, None], (*self.measured.shape, 1)))
        friction = by_channel(self._friction[:, :, 1:] * (self._tolerated[:, 1:] * self.spread[:, None]))
        known = np.concatenate([self._columns, offsets, friction], axis=2)
        known = (known * self._weights[:, :, None]).reshape(-1, known.shape[2])
        # By QR, not from products of the columns, which rounding may leave indefinite: efforts may be next to nothing.
        basis, _ = np.linalg.qr(np.concatenate([np.eye(known.shape[1]), known]))
        self._known = basis[known.shape[1] :]
        target = ((self.measured - self._predicted) * self._weights).ravel()
        self._left = target - self._known @ (self._known.T @ target)


def moving(velocity: FloatArray) -> BoolArray:
    """Whether joints move, so that stiction does not hold whatever it likes ``(N, C)``."""
    speed = np.abs(velocity)
    return np.asarray(speed > np.maximum(STILL, _SLOW * np.max(speed, axis=0)))


def by_channel(columns: FloatArray) -> FloatArray:
    """Columns ``(N, C, k)`` that each channel has for itself, as columns ``(N, C, C k)`` of all."""
    instants, channels, count = columns.shape
    spread = np.zeros((instants, channels, channels, count))
    each = np.arange(channels)
    spread[:, each, each] = columns
    return spread.reshape(instants, channels, channels * count)


def _curves(position: FloatArray, friction: FloatArray, predicted: FloatArray) -> FloatArray:
    """What springs, cables and frictions of other laws may add, in standard deviations ``(N, C, 6)``."""
    place = _standardised(position - np.mean(position, axis=0))
    speed = _standardised(friction[:, :, 1])
    sign = friction[:, :, 2]
    load = np.abs(_standardised(predicted - np.mean(predicted, axis=0)))
    bent, cubic = place**2 - 1.0, place**3 - 3.0 * place
    creeping = sign * np.exp(-(speed**2))
    return SPREAD * np.stack([place, bent, cubic, speed * np.abs(speed), creeping, load * sign], axis=2)


def _standardised(values: FloatArray) -> FloatArray:
    """Values ``(N, C)`` in their standard deviations; nothing where they are always the same but for rounding."""
    deviations = np.std(values, axis=0)
    varied = deviations > ROUNDING * (1.0 + np.max(np.abs(values), axis=0, initial=0.0))
    return np.asarray(np.where(varied, values, 0.0) / np.where(varied, deviations, 1.0))
