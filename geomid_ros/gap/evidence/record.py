"""Recordings as the gap workflow sees them: dense samples for derivatives by time, thin ones for independent rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d

from geomid_ros.gap import candidates as library
from geomid_ros.gap.evidence.play import sides
from geomid_ros.model.dynamics import Dynamics
from geomid_ros.model.effects import Situation
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.model.samples import Samples
from geomid_ros.signals.kernels import filtered
from geomid_ros.types import BoolArray, FloatArray, IntArray

THIN = 2.67  # rows per cutoff period: the filter leaves nothing above 1.5 times the cutoff, so few are enough
# An instant is not used for a joint that in the filter's window stands still for so long, or moves not so much one way:
# at a reversal friction depends on the past.
_REST_SHARE = 0.3
_SAME_WAY = 0.97
# Between two guesses of how friction changes its sign it is unknown; what happens there lasts so long, either way [s].
_REVERSAL = 0.03
_FEWEST = 3  # samples of a stretch
_SMOOTHER = 0.5  # the load, differentiated twice, is smoothed to this share of the cutoff


@dataclass(frozen=True, eq=False)
class Records:
    """Stretches of samples without a pause. ``dense``: as given; ``chosen``: the indices of the rows that are used,
    away from the ends; ``cutoff`` of the filter that made them."""

    dense: tuple[Samples, ...]
    chosen: tuple[IntArray, ...]
    cutoff: float

    @staticmethod
    def make(parts: Sequence[Samples], cutoff: float) -> Records:
        """Divide ``parts`` at pauses and choose rows."""
        dense, chosen = [], []
        for part in parts:
            for stretch in part.stretches():
                if len(stretch) < _FEWEST:
                    continue
                period = _period(stretch)
                step = max(1, round(1.0 / (THIN * cutoff * period)))
                margin = _half(cutoff, period)
                index = np.arange(margin, len(stretch) - margin, step)
                if len(index) > 2:
                    dense.append(stretch)
                    chosen.append(index)
        return Records(tuple(dense), tuple(chosen), cutoff)

    def advanced(self, seconds: float) -> Records:
        """The same records with the efforts of so many seconds later; not a number beyond the ends."""
        return Records(tuple(_advanced(part, seconds) for part in self.dense), self.chosen, self.cutoff)

    @cached_property
    def samples(self) -> Samples:
        """The chosen samples of all stretches."""
        return Samples.concatenate([part.select(index) for part, index in zip(self.dense, self.chosen, strict=True)])

    @cached_property
    def segment(self) -> IntArray:
        """Which stretch each chosen sample belongs to."""
        return np.repeat(np.arange(len(self.chosen)), [len(index) for index in self.chosen])

    def usable(self, model: MeasurementModel, targets: FloatArray) -> BoolArray:
        """Which of the targets ``(N, C)`` are measured, and efforts of joints that move."""
        valid: BoolArray = np.isfinite(targets)
        if model.efforts_usable:
            sign, rest = self.samples.effects[:, :, library.SIGN], self.samples.effects[:, :, library.REST]
            valid[:, : sign.shape[1]] &= (np.abs(sign) > _SAME_WAY) & (rest < _REST_SHARE)
        return valid

    @cached_property
    def unsettled(self) -> FloatArray:
        """By how much two models of dry friction of level 1 differ ``(N, joints)``: much near reversals, where friction
        depends on the past."""
        parts = [_unsettled(part)[index] for part, index in zip(self.dense, self.chosen, strict=True)]
        return np.concatenate(parts)

    def rows(self, model: MeasurementModel) -> Rows:
        """Rows of the inertias alone."""
        return model.rows(self.samples)

    def situation(
        self, model: MeasurementModel, inertias: FloatArray, effects: FloatArray, gravity_by_tilt: FloatArray
    ) -> Situation:
        """What a model with ``inertias (bodies, 10)`` and joint effects of strength ``effects (joints, library)`` says;
        ``gravity_by_tilt (3, 2)``: derivative of its gravity by the base's rotation."""
        dynamics = Dynamics(model, inertias)
        joints, channels = len(model.robot.joints), len(model.channels)
        parts = [
            _load_terms(part, index, dynamics, effects, self.cutoff)
            for part, index in zip(self.dense, self.chosen, strict=True)
        ]
        joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
        predicted_joints, rate_joints = joined[:2]
        predicted, rate = np.zeros((len(self.samples), channels)), np.zeros((len(self.samples), channels))
        if model.efforts_usable:
            predicted[:, :joints], rate[:, :joints] = predicted_joints, rate_joints
        sensitivity = dynamics.sensitivity(self.samples)
        return Situation(
            self.samples.effects[:, :, library.SIGN],
            predicted,
            rate,
            joined[2],
            joined[3],
            joined[4],
            joined[5],
            joined[6],
            joined[7],
            sensitivity.by_position,
            sensitivity.by_velocity,
            sensitivity.by_acceleration,
            sensitivity.by_gravity @ gravity_by_tilt,
        )


def _load_terms(
    part: Samples, index: IntArray, dynamics: Dynamics, effects: FloatArray, cutoff: float
) -> tuple[FloatArray, ...]:
    period = _period(part)
    load = dynamics.efforts(part)
    predicted = load + np.einsum("njl,jl->nj", part.effects[:, :, : effects.shape[1]], effects)
    rate = np.gradient(predicted, period, axis=0)
    smooth = filtered(load, _SMOOTHER * cutoff, period)
    side = [filtered(each, cutoff, period) for each in np.moveaxis(sides(smooth[0], period), 2, 0)]
    return tuple(values[index] for values in (predicted, rate, *smooth, *np.stack(side, axis=3)))


def _unsettled(part: Samples) -> FloatArray:
    sharp, smooth = part.effects[:, :, library.SIGN], part.effects[:, :, library.SMOOTH_SIGN]
    reach = 2 * round(_REVERSAL / _period(part)) + 1
    differences: FloatArray = maximum_filter1d(np.abs(sharp - smooth), reach, axis=0)
    return differences


def _advanced(part: Samples, seconds: float) -> Samples:
    if seconds == 0.0:
        return part
    times = (part.stamps - part.stamps[0]) * 1e-9
    effort = np.full(part.effort.shape, np.nan)
    for joint, measured in enumerate(np.isfinite(part.effort).T):
        if np.count_nonzero(measured) > 1:
            known = CubicSpline(times[measured], part.effort[measured, joint], extrapolate=False)(times + seconds)
            beside_gaps = np.interp(times + seconds, times, measured.astype(np.float64)) < 1.0
            effort[:, joint] = np.where(beside_gaps, np.nan, known)
    return replace(part, effort=effort)


def _half(cutoff: float, period: float) -> int:
    """Samples at each end whose derivatives by time would reach beyond."""
    return round(0.5 / (cutoff * period)) + 1


def _period(part: Samples) -> float:
    return float(np.median(np.diff(part.stamps))) * 1e-9
