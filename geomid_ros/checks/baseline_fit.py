"""Fit of links, friction and curves of each joint's motion, given which anything else is fitted.

Curves stand for springs, cables and other friction laws: what they explain is no evidence of a fault.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from geomid_ros.checks.evidence import PRIOR_STD, Evidence, Unknowns, evidence
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.geometry import spd
from geomid_ros.model.samples import REST_SPEED
from geomid_ros.types import BoolArray, FloatArray, IntArray

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
        self._own = np.concatenate([_curves(position, friction, predicted), friction], axis=2)
        self._tolerated = np.ones(self._own.shape[1:])
        self._tolerated[:, -tolerated.shape[1] :] = tolerated
        self._unknowns = links.with_separate(self._own)
        self.nominal = self._evidence(self._unknowns)
        """Evidence without further columns."""
        self.link_errors = self.nominal.link_errors
        """Fitted errors of the links ``(r,)``."""
        self.link_efforts = self._rigid(self.link_errors)
        """Efforts of the fitted links ``(N, C)``."""
        self._linearise()

    def predicted_gains(
        self, columns: FloatArray, begins: IntArray | None = None, *, before: bool = False
    ) -> FloatArray:
        """Return an approximate lower bound of ``gain(columns).per_instant``, at the noise without the columns [nats].

        Args:
            columns: ``(N, C, k)`` in units of the efforts, per standard deviation of their coefficients.
            begins: ``(n,)`` increasing indices of samples; the columns are zero before each, or from it on if
                ``before``. By default they begin at the first sample.

        Returns:
            For each beginning ``(n,)``.
        """
        ends = np.append(0 if begins is None else begins, len(columns))
        if before:
            ends = np.append(0, ends[:-1])
        parts = np.array([self._crossed(columns, slice(*part)) for part in pairwise(ends)])
        sums = np.cumsum(parts, axis=0) if before else np.cumsum(parts[::-1], axis=0)[::-1]
        return np.array([self._promise(total) for total in sums])

    def _crossed(self, columns: FloatArray, part: slice) -> FloatArray:
        """Products ``(K + k + 1, k)`` of the known columns, the columns and the target with the columns, over some
        samples, all in units of the noise."""
        count, size = columns.shape[2], len(self._whitener)
        sums = np.zeros((size + count + 1, count))
        for channel, (places, known) in enumerate(zip(self._known.places, self._known.columns, strict=True)):
            nonzero = np.flatnonzero(np.any(columns[part, channel], axis=0))
            rows = self._weights[part, channel, None] * columns[part, channel, nonzero]
            at = np.concatenate([places, size + nonzero, [size + count]])
            sums[at[:, None], nonzero] += np.column_stack([known[part], rows, self._target[part, channel]]).T @ rows
        return sums

    def _promise(self, crossed: FloatArray) -> float:
        with_known, squared, target = np.split(crossed, [len(self._whitener), len(crossed) - 1])
        coupling = self._whitener @ with_known
        sizes, axes = np.linalg.eigh(squared - coupling.T @ coupling)
        precisions = 1.0 + np.maximum(sizes, 0.0)  # rounding makes sizes of tiny efforts negative
        quadratic = float(np.sum((axes.T @ (target[0] - self._explained @ coupling)) ** 2 / precisions))
        return 0.5 * (quadratic - float(np.sum(np.log(precisions)))) / self.instants

    def gain(self, columns: FloatArray) -> EvidenceGain:
        """Fit additional columns, in the form of :meth:`predicted_gains`."""
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

    def _linearise(self) -> None:
        """Linearise at the fit, with friction of either sign."""
        self._weights = self._moving / (self.measured_std * self.nominal.sigmas)
        scaled = self._own * self._tolerated * self.measured_std[:, None]
        self._known = self._unknowns.with_separate(scaled).times(self._weights)
        self._target = self._weights * (self.measured - self._predicted)
        sums = self._known.with_target(self._target, np.ones(self._target.shape[1]))
        products = sums.weighed(np.ones(len(sums)))
        self._whitener = spd.whitener(products[:-1, :-1] + np.eye(len(products) - 1))
        self._explained = self._whitener @ products[:-1, -1]


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
