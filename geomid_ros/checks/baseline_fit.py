"""Fit of links, friction and curves of each joint's motion, given which anything else is fitted.

Curves stand for springs, cables and other friction laws: what they explain is no evidence of a fault.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.checks.evidence import PRIOR_STD, Evidence, Unknowns, evidence
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.model.samples import REST_SPEED
from geomid_ros.types import BoolArray, FloatArray

_SLOW = 0.05  # fraction of a joint's largest speed, below which stiction is arbitrary


@dataclass(frozen=True, eq=False, kw_only=True)
class EvidenceGain:
    """Improvement by additional columns.

    Attributes:
        per_instant: gain of log evidence per sample [nats].
        ratios: ``(C,)`` residual over that without the columns.
        coefficients, deviations: ``(k,)`` of the columns.
        link_efforts: ``(N, C)`` efforts of the links given these columns.
    """

    per_instant: float
    ratios: FloatArray
    coefficients: FloatArray
    deviations: FloatArray
    link_efforts: FloatArray

    def beyond(self, other: EvidenceGain) -> EvidenceGain:
        """Return the improvement by these columns over that by others."""
        return replace(self, per_instant=self.per_instant - other.per_instant, ratios=self.ratios / other.ratios)


class BaselineFit:
    """Links, friction and curves fitted to the efforts of C joints at the samples at which each of them moves."""

    def __init__(
        self,
        *,
        measured: FloatArray,
        predicted: FloatArray,
        links: Unknowns,
        friction: FloatArray,
        tolerated: FloatArray,
        position: FloatArray,
    ) -> None:
        """
        Args:
            measured, predicted: ``(N, C)`` the efforts, and those of the URDF's links.
            links: columns of the links' errors.
            friction: ``(N, C, 5)`` columns of friction; the second one is the velocity.
            tolerated: ``(C, 5)`` prior standard deviations of friction's coefficients.
            position: ``(N, C)`` of the joints.
        """
        self.measured, self._predicted = measured, predicted
        self.measured_std = np.std(measured, axis=0)
        self._moving = moving(friction[:, :, 1]).astype(np.float64)
        self.instants = float(np.mean(np.maximum(np.sum(self._moving, axis=0), 1.0)))
        """Mean number of samples per channel."""
        own = np.concatenate([_curves(position, friction, predicted), friction], axis=2)
        self._tolerated = np.ones(own.shape[1:])
        self._tolerated[:, -tolerated.shape[1] :] = tolerated
        self._unknowns = links.with_separate(own)
        self.nominal = self._evidence(self._unknowns)
        """Evidence without further columns."""
        self.link_errors = self.nominal.link_errors
        """Fitted errors of the links ``(r,)``."""
        self.link_efforts = self._rigid(self.link_errors)
        """Efforts of the fitted links ``(N, C)``."""

    def gain(self, columns: FloatArray) -> EvidenceGain:
        """Fit additional ``columns (N, C, k)`` of the efforts, per standard deviation of their coefficients."""
        fitted, rank = self._evidence(self._unknowns.with_errors(columns)), self._unknowns.links
        return EvidenceGain(
            per_instant=(fitted.log_evidence - self.nominal.log_evidence) / self.instants,
            ratios=fitted.sigmas / self.nominal.sigmas,
            coefficients=fitted.link_errors[rank:],
            deviations=fitted.deviations()[rank:],
            link_efforts=self._rigid(fitted.link_errors[:rank]),
        )

    def _rigid(self, links: FloatArray) -> FloatArray:
        return np.asarray(self._predicted + self._unknowns.link_efforts(links))

    def _evidence(self, unknowns: Unknowns) -> Evidence:
        """Evidence of unknowns of unit variance, curves and friction."""
        target = (self.measured - self._predicted) / self.measured_std
        return evidence(target, unknowns, self._tolerated, units=self.measured_std, counted=self._moving)


def moving(velocity: FloatArray) -> BoolArray:
    """True where joints move, so that stiction is not arbitrary ``(N, C)``."""
    speed = np.abs(velocity)
    return np.asarray(speed > np.maximum(REST_SPEED, _SLOW * np.max(speed, axis=0)))


def by_channel(columns: FloatArray) -> FloatArray:
    """Columns ``(N, C, k)`` that are separate for each channel, as columns ``(N, C, C k)`` of all channels."""
    instants, channels, count = columns.shape
    expanded = np.zeros((instants, channels, channels, count))
    diagonal = np.arange(channels)
    expanded[:, diagonal, diagonal] = columns
    return expanded.reshape(instants, channels, channels * count)


def _curves(position: FloatArray, friction: FloatArray, predicted: FloatArray) -> FloatArray:
    """Columns of springs, cables and other friction laws, per prior standard deviation ``(N, C, 6)``."""
    place = _standardised(position - np.mean(position, axis=0))
    speed = _standardised(friction[:, :, 1])
    sign = friction[:, :, 2]
    load = np.abs(_standardised(predicted - np.mean(predicted, axis=0)))
    bent, cubic = place**2 - 1.0, place**3 - 3.0 * place
    creeping = sign * np.exp(-(speed**2))
    return PRIOR_STD * np.stack([place, bent, cubic, speed * np.abs(speed), creeping, load * sign], axis=2)


def _standardised(values: FloatArray) -> FloatArray:
    """Divide values ``(N, C)`` by their standard deviations; zero where they are constant up to rounding."""
    deviations = np.std(values, axis=0)
    varied = deviations > ROUNDING * (1.0 + np.max(np.abs(values), axis=0, initial=0.0))
    return np.asarray(np.where(varied, values, 0.0) / np.where(varied, deviations, 1.0))
