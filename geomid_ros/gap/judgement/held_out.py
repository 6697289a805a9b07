"""Residuals of the fits on unseen data, and the fraction of them that a smooth curve of each variable explains."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.candidates import EffectsFit
from geomid_ros.gap.evidence.features import hats, knots
from geomid_ros.gap.evidence.linearised_problem import LinearisedProblem, root_mean_square
from geomid_ros.gap.evidence.records import Records
from geomid_ros.gap.result import GapErrors, ResidualDependence, Trace
from geomid_ros.inference.fit import fit_of_prior
from geomid_ros.inference.remainder import DEFAULT_VARIANCE
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

GAP_ABOVE = 1.15
"""In noise floors: a larger remainder is a gap, a smaller one has reached the floor."""
_KNOTS = 12  # per curve that explains a remainder


class HeldOut:
    """Residuals of an ``analysis``'s fits on held-out ``records``, at samples at which the last fit may be blamed."""

    def __init__(self, model: MeasurementModel, records: Records, analysis: Analysis) -> None:
        self._model, self._records, self._analysis = model, records, analysis
        self._last = self._problem(analysis.effects)

    def _problem(self, fit: EffectsFit) -> LinearisedProblem:
        known_remainder = self._analysis.problem.known_remainder
        return LinearisedProblem.at(self._model, self._records, fit, self._analysis.floor, known_remainder)

    @cached_property
    def _residuals(self) -> list[FloatArray]:
        """Residuals ``(N, C)`` of the given model, of the one with fitted inertias only, and of the last fit."""
        names = self._analysis.effects
        fits = (fit_of_prior(self._analysis.search.prior), self._analysis.inertias_only)
        return [*(self._problem(fit).residual(fit) for fit in fits), self._last.residual(names)]

    @cached_property
    def gap(self) -> GapErrors:
        """Residuals of all channels, in units of the floor, at the samples used for evaluation.

        The known remainder of the model is uncertain, most where its recordings did not move; and it may differ now by
        the default std. Neither is a gap.
        """
        uncertainty = self._times_floor(np.sqrt(self._last.variance(self._analysis.effects)))
        before, bare, after = map(self._times_floor, self._residuals)
        blocks = (len(rows.depends_on) if rows.mean is not None else 0 for rows in self._analysis.problem.features)
        return GapErrors(before, bare, after, np.sqrt(1.0 + uncertainty**2 + DEFAULT_VARIANCE * np.array([*blocks])))

    @cached_property
    def on_all(self) -> GapErrors:
        """Residuals at all samples, those at rest and near reversals included, in units of the floor."""
        before, bare, after = (root_mean_square(residual) / self._analysis.floor for residual in self._residuals)
        return GapErrors(before, bare, after, self.gap.expected)

    @property
    def fitted_gap(self) -> FloatArray:
        """RMS residual ``(C,)`` of the last fit on the data that were fitted, in units of the floor."""
        problem = self._analysis.problem
        return problem.valid_rms(problem.residual(self._analysis.effects)) / self._analysis.floor

    @cached_property
    def is_open(self) -> BoolArray:
        """True for the channels ``(C,)`` whose gap exceeds noise and the uncertainty of the fit, both with the known
        remainder and without: it may not hold for another motion."""
        # A standard deviation from n values is itself uncertain by 1 / sqrt(2 n), relative.
        counts = np.maximum(np.count_nonzero(self._last.valid, axis=0), 1)
        limit = GAP_ABOVE * (1.0 + 2.0 / np.sqrt(2.0 * counts)) * self.gap.expected
        without_standing = self._times_floor(self._residuals[-1] - self._last.expected_remainder)
        after = np.minimum(self.gap.after, without_standing)
        return np.asarray(np.nan_to_num(after) >= np.nan_to_num(limit, nan=np.inf))

    @cached_property
    def unjudged(self) -> BoolArray:
        """True for channels ``(C,)`` that are measured in motion, but at no sample at which the model can be blamed."""
        measured = np.any(self._last.records.usable(self._model, self._last.rows.targets), axis=0)
        return np.asarray(measured & np.isnan(self.gap.after))

    @cached_property
    def trace(self) -> Trace:
        """Measured values and predictions."""
        samples, measured = self._records.samples, self._records.rows(self._model).targets
        before, middle, after = (measured - residual for residual in self._residuals)
        return Trace(
            stamps=samples.stamps,
            position=samples.position,
            velocity=samples.velocity,
            load=np.abs(after),
            measured=measured,
            before=before,
            inertias_only=middle,
            after=after,
        )

    @cached_property
    def residual_dependences(self) -> tuple[ResidualDependence, ...]:
        """Variables that explain each channel's remainder."""
        residual = np.where(self._last.valid, self._residuals[-1], np.nan)
        return locate_residuals(self._model, self._records, residual, self.trace.load)

    def _times_floor(self, residual: FloatArray) -> FloatArray:
        """RMS of a ``residual (N, C)`` in units of the floor ``(C,)``; NaN where nothing is measured."""
        return self._last.valid_rms(residual) / self._analysis.floor


def locate_residuals(
    model: MeasurementModel, records: Records, residual: FloatArray, load: FloatArray
) -> tuple[ResidualDependence, ...]:
    """Locate the ``residual (N, C)`` of each channel; a wrench channel has no joint, only load and time."""
    samples = records.samples
    result = []
    for index, channel in enumerate(model.channels):
        values = residual[:, index]
        has_joint = channel.joint is not None
        velocity = samples.velocity[:, index] if has_joint else np.zeros(len(values))
        position = samples.position[:, index] if has_joint else np.zeros(len(values))
        reversals = np.tanh(velocity / max(0.05 * float(np.std(velocity)), 1e-9))
        variables = (velocity, position, load[:, index], samples.seconds, reversals)
        result.append(ResidualDependence(channel.name, *(share(values, variable) for variable in variables)))
    return tuple(result)


def strongest(found: ResidualDependence) -> str:
    """Variable that explains most of a channel's remainder, ``unknown`` if none explains any of it."""
    shares = {name: float(getattr(found, name)) for name in ("velocity", "position", "load", "time", "reversals")}
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] > 0.0 else "unknown"


def share(values: FloatArray, variable: FloatArray) -> float:
    """Fraction of the mean square of ``values (N,)``, 0 to 1, that a piecewise linear curve of a variable explains,
    less what it would explain of noise."""
    usable = np.isfinite(values)
    values, variable = values[usable], variable[usable]
    if len(values) <= _KNOTS or np.ptp(variable) == 0.0:
        return 0.0
    curves = hats(variable, knots(variable), _KNOTS)
    solution, _, rank, _ = np.linalg.lstsq(curves, values, rcond=1e-9)
    variance = float(np.sum((values - curves @ solution) ** 2)) / (len(values) - int(rank))
    return float(np.clip(1.0 - variance / max(float(np.mean(values**2)), 1e-300), 0.0, 1.0))
