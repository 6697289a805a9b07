"""Fits on data that they have not seen."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.candidates import NamesFit
from geomid_ros.gap.evidence.linearised_problem import LinearisedProblem, root_mean_square, total_model
from geomid_ros.gap.evidence.record import Records
from geomid_ros.gap.judgement.locate import located
from geomid_ros.gap.result import GapErrors, Located, Trace
from geomid_ros.inference.fit import unfitted
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

REACHED = 1.15
"""A channel whose remainder is below this times the floor has reached it."""


class HeldOut:
    """What the fits of an ``analysis`` leave of held-out ``records``, at the instants at which the last one may be
    blamed."""

    def __init__(self, model: MeasurementModel, records: Records, analysis: Analysis) -> None:
        self._model = model
        self._records = records
        self._prior = analysis.search.prior
        self._analysis = analysis
        self._last = self._problem(analysis.names)
        self._untouched = unfitted(analysis.search.prior)
        self._residuals: dict[NamesFit, FloatArray] = {}

    @cached_property
    def gap(self) -> GapErrors:
        """Of all channels, in units of the floor, at the instants that are judged on."""
        names = self._analysis.names
        variance = self._last.variance(self._last.columns(names.chosen, self._prior.terms), names)
        unsure = self._times_floor(np.sqrt(variance))
        fits = (self._untouched, self._analysis.bare, names)
        before, bare, after = (self.times_floor(found) for found in fits)
        return GapErrors(before, bare, after, np.sqrt(1.0 + unsure**2))

    @cached_property
    def on_all(self) -> GapErrors:
        """The same at all instants, those at rest and near reversals, too."""
        trace = self.trace
        fits = (trace.before, trace.inertias_only, trace.after)
        before, bare, after = (root_mean_square(trace.measured - each) / self._analysis.floor for each in fits)
        return GapErrors(before, bare, after, self.gap.expected)

    @cached_property
    def is_open(self) -> BoolArray:
        """The channels ``(C,)`` whose gap is larger than noise and the uncertainty of all that was fitted explain."""
        # A standard deviation from n values is itself uncertain by 1 / sqrt(2 n), relative.
        reached = REACHED * (1.0 + 2.0 / np.sqrt(2.0 * np.maximum(self.counts, 1.0))) * self.gap.expected
        return np.asarray(np.nan_to_num(self.gap.after) >= np.nan_to_num(reached, nan=np.inf))

    @cached_property
    def trace(self) -> Trace:
        """The measured values and the predictions."""
        samples, measured = self._records.samples, self._model.rows(self._records.samples).targets
        fits = (self._untouched, self._analysis.bare, self._analysis.names)
        before, middle, after = (measured - self._residual(found) for found in fits)
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
    def located(self) -> tuple[Located, ...]:
        """Where the remainder of each channel lives."""
        residual = np.where(self._last.valid, self._residual(self._analysis.names), np.nan)
        return located(self._model, self._records, residual, self.trace.load)

    @cached_property
    def counts(self) -> FloatArray:
        """Number of independent instants of each channel ``(C,)``."""
        return np.asarray(np.sum(self._last.valid, axis=0, dtype=np.float64))

    def times_floor(self, found: NamesFit) -> FloatArray:
        """Root mean square of what a fit leaves ``(C,)``, in units of the floor; NaN where nothing is measured."""
        return self._times_floor(self._residual(found))

    def _problem(self, found: NamesFit) -> LinearisedProblem:
        return LinearisedProblem(self._model, self._records, total_model(self._model, found), self._analysis.floor)

    def _residual(self, found: NamesFit) -> FloatArray:
        if found not in self._residuals:
            problem = self._last if found is self._analysis.names else self._problem(found)
            self._residuals[found] = problem.residual(problem.columns(found.chosen, self._prior.terms), found)
        return self._residuals[found]

    def _times_floor(self, residual: FloatArray) -> FloatArray:
        squares = np.sum(np.where(self._last.valid, residual, 0.0) ** 2, axis=0)
        counts = np.where(self.counts > 0.0, self.counts, np.nan)
        return np.asarray(np.sqrt(squares / counts) / self._analysis.floor)
