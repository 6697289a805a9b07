"""Recordings in the gap workflow: dense samples for derivatives by time, thinned ones for independent rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from geomid_ros.estimation.fit import INDEPENDENT_ROWS_PER_PERIOD
from geomid_ros.model.dynamics import Dynamics
from geomid_ros.model.effects import Effect, MotionEffect, Place, Situation, SituationEffect, joints_of
from geomid_ros.model.effects.situation import Derivatives, OfLoad
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.model.samples import REST_SPEED, SIGN, SMOOTH_SIGN, Samples, moves_one_way
from geomid_ros.signals.kernels import filtered
from geomid_ros.types import BoolArray, FloatArray, IntArray

# Near a reversal, two models of friction's sign differ; their disagreement spreads so far in time, either way [s].
_REVERSAL = 0.03
FEWEST_ROWS = 30
"""With fewer rows, a channel's noise is not identifiable."""
_FEWEST = 3  # samples in a stretch
_SMOOTHER = 0.5  # fraction of the cutoff; smooths the load, which is differentiated twice


@dataclass(frozen=True, eq=False)
class Records:
    """Stretches of samples without a pause.

    Attributes:
        dense: the samples as given.
        chosen: indices of the rows that are used, away from the ends.
        cutoff: of the filter that made the samples [Hz].
    """

    dense: tuple[Samples, ...]
    chosen: tuple[IntArray, ...]
    cutoff: float

    @staticmethod
    def make(parts: Sequence[Samples], cutoff: float) -> Records:
        """Split ``parts`` at pauses and choose rows."""
        dense, chosen = [], []
        for part in parts:
            for stretch in part.segments():
                if len(stretch) < _FEWEST:
                    continue
                period = _period(stretch)
                step = max(1, round(1.0 / (INDEPENDENT_ROWS_PER_PERIOD * cutoff * period)))
                margin = round(0.5 / (cutoff * period)) + 1  # derivatives by time would reach beyond the ends
                index = np.arange(margin, len(stretch) - margin, step)
                if len(index) > 2:
                    dense.append(stretch)
                    chosen.append(index)
        return Records(tuple(dense), tuple(chosen), cutoff)

    def with_shifted_efforts(self, seconds: float) -> Records:
        """Return the records with efforts from ``seconds`` later; NaN beyond the ends."""
        if seconds == 0.0:
            return self
        return Records(tuple(_advanced(part, seconds) for part in self.dense), self.chosen, self.cutoff)

    @cached_property
    def samples(self) -> Samples:
        """Chosen samples of all stretches."""
        return Samples.concatenate([part.select(index) for part, index in zip(self.dense, self.chosen, strict=True)])

    def rows(self, model: MeasurementModel) -> Rows:
        """Rows of the chosen samples, read-only; kept for the last model only, being as large as all else together."""
        if model not in self._rows:
            self._rows.clear()
            rows = self._rows[model] = model.rows(self.samples)
            for array in (rows.coefficients, rows.targets):
                array.setflags(write=False)
        return self._rows[model]

    @cached_property
    def _rows(self) -> dict[MeasurementModel, Rows]:
        return {}

    @cached_property
    def moving(self) -> BoolArray:
        """True where a joint moves at a chosen sample ``(N, joints)``."""
        return np.asarray(np.abs(self.samples.velocity) > REST_SPEED)

    @cached_property
    def segment(self) -> IntArray:
        """Stretch of each chosen sample."""
        return np.repeat(np.arange(len(self.chosen)), [len(index) for index in self.chosen])

    def usable(self, model: MeasurementModel, targets: FloatArray) -> BoolArray:
        """True for targets ``(N, C)`` that are measured; efforts only where their joints move one way."""
        valid: BoolArray = np.isfinite(targets)
        if model.layout.efforts:
            valid[:, model.layout.efforts] &= moves_one_way(self.samples)
        return valid

    @cached_property
    def friction_ambiguity(self) -> FloatArray:
        """Difference of two dry friction models of level 1 ``(N, joints)``; large near reversals: the past matters."""
        return np.concatenate([_unsettled(part)[index] for part, index in zip(self.dense, self.chosen, strict=True)])

    def situation(self, model: MeasurementModel, total: TotalModel) -> Situation:
        """Situation of a ``model`` with the gravity, inertias and effects of ``total``."""
        dynamics = Dynamics(model, total.inertias)
        joints, channels = len(model.robot.joints), len(model.channels)
        loads = [dynamics.efforts(part) for part in self.dense]
        parts = [
            _load_terms(part, index, load, total, self.cutoff)
            for part, index, load in zip(self.dense, self.chosen, loads, strict=True)
        ]
        joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        of_joints, joined["predicted"] = joined["predicted"], np.zeros((len(self.samples), channels))
        if model.layout.efforts:
            joined["predicted"][:, :joints] = of_joints
            joined["transmitted"] = model.with_ground(self.samples, joined["transmitted"])
        return Situation(
            sign=self.samples.column(SIGN),
            **vars(dynamics.sensitivity(self.samples)),
            gravity=total.straight_gravity,
            coefficients={(effect.name, place): values for effect, place, values in total.effects},
            from_load_history=self._derivatives_of(loads),
            **joined,
        )

    def _derivatives_of(self, loads: Sequence[FloatArray]) -> Callable[[OfLoad], Derivatives]:
        """:attr:`Situation.from_load_history` for the stretches' dense ``loads (n, J)``."""

        def of_load(function: OfLoad) -> Derivatives:
            parts = []
            for part, index, load in zip(self.dense, self.chosen, loads, strict=True):
                period = _period(part)
                smooth, _, _ = filtered(load, _SMOOTHER * self.cutoff, period)
                layers = function(smooth, period)
                derived = filtered(layers.reshape(len(layers), -1), self.cutoff, period, index)
                parts.append(np.stack(derived).reshape(3, len(index), *layers.shape[1:]))
            value, rate, acceleration = np.concatenate(parts, axis=1)
            return value, rate, acceleration

        return cache(of_load)


@dataclass(frozen=True, eq=False)
class TotalModel:
    """Inertias, effects and gravity that together predict the measurement.

    Attributes:
        inertias: of all bodies with their payloads ``(bodies, 10)``.
        effects: each at a place with its coefficients ``(k,)``.
        straight_gravity: gravity ``(3,)`` in the frame of an upright base [m/s^2].
    """

    inertias: FloatArray
    effects: tuple[tuple[Effect, Place, FloatArray], ...]
    straight_gravity: FloatArray

    @property
    def gravity(self) -> FloatArray:
        """Gravity ``(3,)`` in the base frame [m/s^2]."""
        gravity = self.straight_gravity
        for effect, _, coefficients in self.compensated_effects:
            gravity = effect.tilted_gravity(gravity, effect.values(coefficients))
        return gravity

    @property
    def lag(self) -> float:
        """Delay of the measured efforts behind the motion [s]."""
        return sum(
            effect.effort_lag(effect.values(coefficients)) for effect, _, coefficients in self.compensated_effects
        )

    @property
    def compensated_effects(self) -> list[tuple[SituationEffect, Place, FloatArray]]:
        """Effects that are built into the model (gravity, time, scale); their columns stand for changes."""
        absorbed = [
            (effect, place, coefficients)
            for effect, place, coefficients in self.effects
            if isinstance(effect, SituationEffect) and effect.compensated_in_samples and np.any(coefficients)
        ]
        return sorted(
            absorbed, key=lambda one: (one[0].scales_measurement, not one[0].turns_gravity, joints_of(one[1]))
        )

    def scales(self, channels: int) -> FloatArray:
        """Factors ``(channels,)`` from true to measured values."""
        scales = np.ones(channels)
        for effect, place, coefficients in self.compensated_effects:
            if effect.scales_measurement:
                scales[list(joints_of(place))] *= effect.effort_scale(effect.values(coefficients))
        return scales

    def efforts(self, samples: Samples) -> FloatArray:
        """Joint efforts ``(N, J)`` due to the effects of motion."""
        return samples.efforts_of(
            (effect, place, float(coefficient))
            for effect, place, (coefficient, *_) in self.effects
            if isinstance(effect, MotionEffect)
        )


def _load_terms(
    part: Samples, index: IntArray, load: FloatArray, total: TotalModel, cutoff: float
) -> dict[str, FloatArray]:
    period = _period(part)
    smooth = filtered(load, _SMOOTHER * cutoff, period)
    terms = {
        "predicted": load + total.efforts(part),
        "transmitted": load,
        **dict(zip(("load", "load_rate", "load_acceleration"), smooth, strict=True)),
    }
    return {name: values[index] for name, values in terms.items()}


def _unsettled(part: Samples) -> FloatArray:
    sharp, smooth = part.column(SIGN), part.column(SMOOTH_SIGN)
    reach = round(_REVERSAL / _period(part))
    difference = np.pad(np.abs(sharp - smooth), ((reach, reach), (0, 0)))
    return np.asarray(np.max(sliding_window_view(difference, 2 * reach + 1, axis=0), axis=-1))


def _advanced(part: Samples, seconds: float) -> Samples:
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 of delays alone

    times = part.seconds
    effort = np.full(part.effort.shape, np.nan)
    for joint, measured in enumerate(np.isfinite(part.effort).T):
        if np.count_nonzero(measured) > 1:
            shifted = CubicSpline(times[measured], part.effort[measured, joint], extrapolate=False)(times + seconds)
            near_gaps = np.interp(times + seconds, times, measured.astype(np.float64)) < 1.0
            effort[:, joint] = np.where(near_gaps, np.nan, shifted)
    return replace(part, effort=effort)


def _period(part: Samples) -> float:
    return float(np.median(np.diff(part.stamps))) * 1e-9
