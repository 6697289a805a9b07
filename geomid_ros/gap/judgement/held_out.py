"""Fits on data that they have not seen, and where what they leave lives: the share of it that a smooth curve of one
variable explains."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.candidates import NamesFit
from geomid_ros.gap.evidence.features import hats, knots
from geomid_ros.gap.evidence.linearised_problem import LinearisedProblem, root_mean_square, total_model
from geomid_ros.gap.evidence.record import Records
from geomid_ros.gap.result import GapErrors, Located, Trace
from geomid_ros.inference.fit import unfitted
from geomid_ros.inference.remainder import USUAL
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

GAP_ABOVE = 1.15
"""Noise floors: a remainder that is larger is a gap, what is smaller has reached the floor."""
_KNOTS = 12  # of the curves that explain a remainder


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
        """Of all channels, in units of the floor, at the instants that are judged on.

        What a model is known to lack may be otherwise now by as much as usual, which is no gap.
        """
        names = self._analysis.names
        variance = self._last.variance(self._last.columns(names.chosen, self._prior.terms), names)
        unsure = self._times_floor(np.sqrt(variance))
        fits = (self._untouched, self._analysis.bare, names)
        before, bare, after = (self.times_floor(found) for found in fits)
        known = (len(own.depends_on) if own.mean is not None else 0 for own in self._analysis.problem.features)
        return GapErrors(before, bare, after, np.sqrt(1.0 + unsure**2 + USUAL * np.array([*known])))

    @cached_property
    def on_all(self) -> GapErrors:
        """The same at all instants, those at rest and near reversals, too."""
        trace = self.trace
        fits = (trace.before, trace.inertias_only, trace.after)
        before, bare, after = (root_mean_square(trace.measured - each) / self._analysis.floor for each in fits)
        return GapErrors(before, bare, after, self.gap.expected)

    @cached_property
    def is_open(self) -> BoolArray:
        """The channels ``(C,)`` whose gap is larger than noise and the uncertainty of all that was fitted explain, be
        it with what the model is known to lack or without: another motion may not tell of it here."""
        # A standard deviation from n values is itself uncertain by 1 / sqrt(2 n), relative.
        reached = GAP_ABOVE * (1.0 + 2.0 / np.sqrt(2.0 * np.maximum(self.counts, 1.0))) * self.gap.expected
        beside = self._times_floor(self._residual(self._analysis.names) - self._last.expected)
        after = np.minimum(self.gap.after, beside)
        return np.asarray(np.nan_to_num(after) >= np.nan_to_num(reached, nan=np.inf))

    @cached_property
    def unjudged(self) -> BoolArray:
        """The channels ``(C,)`` that are measured in motion, but at no instant at which the model can be blamed."""
        measured = np.any(self._last.records.usable(self._model, self._last.rows.targets), axis=0)
        return np.asarray(measured & np.isnan(self.gap.after))

    @cached_property
    def trace(self) -> Trace:
        """The measured values and the predictions."""
        samples, measured = self._records.samples, self._records.rows(self._model).targets
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
        total, known = total_model(self._model, found), self._analysis.problem.standing
        return LinearisedProblem(self._model, self._records, total, self._analysis.floor, known)

    def _residual(self, found: NamesFit) -> FloatArray:
        if found not in self._residuals:
            problem = self._last if found is self._analysis.names else self._problem(found)
            self._residuals[found] = problem.residual(problem.columns(found.chosen, self._prior.terms), found)
        return self._residuals[found]

    def _times_floor(self, residual: FloatArray) -> FloatArray:
        squares = np.sum(np.where(self._last.valid, residual, 0.0) ** 2, axis=0)
        counts = np.where(self.counts > 0.0, self.counts, np.nan)
        return np.asarray(np.sqrt(squares / counts) / self._analysis.floor)


def located(model: MeasurementModel, records: Records, residual: FloatArray, load: FloatArray) -> tuple[Located, ...]:
    """For each channel of ``residual (N, C)``; a wrench channel has no joint, only load and time."""
    samples = records.samples
    found = []
    for index, channel in enumerate(model.channels):
        values = residual[:, index]
        own = channel.joint is not None
        velocity = samples.velocity[:, index] if own else np.zeros(len(values))
        position = samples.position[:, index] if own else np.zeros(len(values))
        reversals = np.tanh(velocity / max(0.05 * float(np.std(velocity)), 1e-9))
        variables = (velocity, position, load[:, index], samples.seconds, reversals)
        found.append(Located(channel.name, *(share(values, variable) for variable in variables)))
    return tuple(found)


def strongest(found: Located) -> str:
    """The variable that explains most of a channel's remainder, ``unknown`` where none explains any of it."""
    shares = {name: float(getattr(found, name)) for name in ("velocity", "position", "load", "time", "reversals")}
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] > 0.0 else "unknown"


def share(values: FloatArray, variable: FloatArray) -> float:
    """Share of the mean square of ``values (N,)`` that a piecewise linear curve of a variable explains, 0 to 1, less
    what it would explain of noise."""
    usable = np.isfinite(values)
    values, variable = values[usable], variable[usable]
    if len(values) <= _KNOTS or np.ptp(variable) == 0.0:
        return 0.0
    curves = hats(variable, knots(variable), _KNOTS)
    solution, _, rank, _ = np.linalg.lstsq(curves, values, rcond=1e-9)
    left = float(np.sum((values - curves @ solution) ** 2)) / (len(values) - int(rank))
    return float(np.clip(1.0 - left / max(float(np.mean(values**2)), 1e-300), 0.0, 1.0))
