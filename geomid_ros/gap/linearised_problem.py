"""The problem linearised at a total model: everything that depends on the model is recomputed there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from functools import cached_property
from itertools import groupby
from operator import attrgetter

import numpy as np

from geomid_ros.gap.features import Basis, Features, KnownRemainder, features
from geomid_ros.gap.noise import Autoregression, runs_of
from geomid_ros.gap.records import FEWEST_ROWS, Records, TotalModel
from geomid_ros.inference.candidates import EffectTerm
from geomid_ros.inference.design import ChannelRows, Design, RemainderFit
from geomid_ros.inference.fit import JointFit
from geomid_ros.model.effects import Effect, MotionEffect, Place, SensorEffect, Situation, SituationEffect, joints_of
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.types import BoolArray, FloatArray

Columns = Mapping[EffectTerm, Mapping[int, FloatArray]]
"""Column ``(N,)`` of each term, by channel."""

_FRICTION_ERROR = 0.7  # of the noise; samples with less certain dry friction are neither fitted nor evaluated


def total_model(model: MeasurementModel, found: JointFit) -> TotalModel:
    """Return the total model of a joint fit."""
    inertias = np.array([body.parameters for body in model.robot.bodies])
    inertias[list(model.identified)] = found.loaded_inertias
    grouped: dict[tuple[Effect, Place], list[float]] = {}
    for term in found.terms:
        grouped.setdefault((term.effect, term.place), []).append(found.value(term))
    effects = tuple((effect, place, effect.linearised_at(np.array(own))) for (effect, place), own in grouped.items())
    return TotalModel(inertias, effects, model.robot.gravity)


class LinearisedProblem:
    """Records under a model linearised at ``total``, given its known remainder (``known_remainder``).

    A compensated effect (a tilt, delay or gain) is built in: gravity is rotated, the efforts are shifted in time, the
    rows scaled. The target is changed so that its coefficients still mean the whole tilt, delay or gain.
    """

    def __init__(
        self,
        model: MeasurementModel,
        records: Records,
        total: TotalModel,
        floor: FloatArray | None = None,
        known_remainder: KnownRemainder | None = None,
    ) -> None:
        self.total = total
        self.known_remainder = known_remainder
        self.floor = np.full(len(model.channels), np.inf) if floor is None else floor
        self.records = records.with_shifted_efforts(total.lag)
        gravity = total.gravity
        self.model = model.with_gravity(gravity) if np.any(gravity != model.robot.gravity) else model
        self._scales = total.scales(len(model.channels))

    @staticmethod
    def at(
        model: MeasurementModel,
        records: Records,
        found: JointFit,
        floor: FloatArray | None = None,
        known_remainder: KnownRemainder | None = None,
    ) -> LinearisedProblem:
        """Return the problem linearised at a joint fit."""
        return LinearisedProblem(model, records, total_model(model, found), floor, known_remainder)

    def with_floor(self, floor: FloatArray) -> LinearisedProblem:
        """Return a copy with another noise ``floor (C,)``, which decides which samples are valid."""
        problem = copy(self)
        problem.floor = floor
        vars(problem).pop("valid", None)
        return problem

    def identifiable_floor(self, left: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the noise floor: ``left (C,)`` where rows determine it, the previous one elsewhere; and True where
        they do.

        A fit to few rows leaves less than the noise; with that as floor, fewer samples are valid, which leave even
        less. Where too few would be valid, the rows do not determine the noise.
        """
        valid = np.count_nonzero(self.with_floor(left).valid, axis=0)
        determined = (valid >= FEWEST_ROWS) | np.isinf(self.floor)
        return np.where(determined, left, self.floor), determined

    @cached_property
    def situation(self) -> Situation:
        """Situation under the total model."""
        return self.records.situation(self.model, self.total)

    @cached_property
    def rows(self) -> Rows:
        """Rows of the inertias, with changed targets."""
        rows = self.records.rows(self.model)
        targets = rows.targets.copy()
        for effect, place, coefficients in self.total.compensated_effects:
            column = effect.columns(self.situation, place) @ coefficients
            targets += column if effect.scales_measurement else column * self._scales
        is_scaled = np.any(self._scales != 1.0)
        return Rows(rows.coefficients * self._scales[:, None] if is_scaled else rows.coefficients, targets)

    @cached_property
    def valid(self) -> BoolArray:
        """True for the targets ``(N, C)`` that are measured where the model can be blamed: not where a joint's dry
        friction is uncertain by more than a fraction of the noise, nor where its acceleration carries this to other
        channels."""
        valid = self.records.usable(self.model, self.rows.targets)
        if not self.model.layout.efforts or not np.any(self._dry_friction):
            return valid
        joints = self._dry_friction.shape[1]
        by_acceleration = np.abs(self.situation.by_acceleration)
        diagonal = np.einsum("njj->nj", by_acceleration[:, :joints])
        ratios = by_acceleration / np.maximum(diagonal, 1e-12)[:, None]
        uncertain = np.max(ratios * (self._dry_friction * self.records.friction_ambiguity)[:, None], axis=2)
        return np.asarray(valid & (uncertain < _FRICTION_ERROR * self.floor))

    @cached_property
    def _dry_friction(self) -> FloatArray:
        """Magnitude of the dry friction of the total model ``(N, joints)``."""
        sizes = np.zeros((len(self.records.samples), len(self.model.robot.joints)))
        for effect, place, (coefficient, *_) in self.total.effects:
            for joint in joints_of(place):
                sizes[:, joint] += effect.dry_friction(coefficient, self.situation.transmitted[:, joint])
        return sizes

    def columns(self, terms: Iterable[EffectTerm]) -> dict[EffectTerm, dict[int, FloatArray]]:
        """Columns ``(N,)`` of terms by the channels that they affect."""
        columns: dict[EffectTerm, dict[int, FloatArray]] = {}
        for (effect, place), group in groupby(dict.fromkeys(terms), key=attrgetter("effect", "place")):
            if isinstance(effect, SituationEffect):
                by_state = effect.columns(self.situation, place)
                for term in group:
                    numbered = enumerate(by_state[:, :, term.index].T)
                    columns[term] = {channel: column for channel, column in numbered if np.any(column)}
            elif isinstance(effect, MotionEffect | SensorEffect):
                columns |= {t: self.model.columns_of(self.records.samples, effect, place, t.index) for t in group}
        self.model.eliminate_ground(self.records.samples, columns.values())
        for channel in np.flatnonzero(self._scales != 1.0).tolist():
            for term, by_channel in columns.items():
                if channel in by_channel and not term.effect.scales_measurement:
                    by_channel[channel] = by_channel[channel] * self._scales[channel]
        return columns

    @cached_property
    def features(self) -> list[Features]:
        """Features of each channel's remainder."""
        channels, standing = range(len(self.model.channels)), self.known_remainder
        basis = self.basis if standing is None else standing.basis
        by_channel = [features(self.model, self.records, self.situation, channel, basis) for channel in channels]
        return by_channel if standing is None else standing.with_prior(by_channel)

    @property
    def expected_remainder(self) -> FloatArray:
        """Known remainder of the model ``(N, C)``."""
        if self.known_remainder is None:
            return np.zeros(self.rows.targets.shape)
        return np.stack([channel.expected_remainder for channel in self.features], axis=1)

    @cached_property
    def basis(self) -> Basis:
        """Default basis of the features for these records."""
        return Basis.of(self.model, self.records, self.situation)

    def design(self, columns: Columns, noise: Sequence[Autoregression]) -> Design:
        """Return the whitened rows."""
        return design_of(self.rows, self.valid, columns, self.features, noise, self.records)

    @property
    def usable_features(self) -> list[Features]:
        """Features by channel; empty for a channel without rows."""
        pairs = zip(self.features, np.any(self.valid, axis=0), strict=True)
        return [channel if has_rows else self._no_features for channel, has_rows in pairs]

    @property
    def _no_features(self) -> Features:
        return Features(np.zeros((len(self.valid), 0)), np.zeros(0, dtype=np.intp), ())

    def fit_remainders(
        self,
        residual: FloatArray,
        features: Sequence[Features],
        noise: Sequence[Autoregression],
        near: Sequence[FloatArray] | None,
    ) -> tuple[list[FloatArray], list[RemainderFit]]:
        """Return the variances of the most likely remainder of each channel's ``residual (N, C)``, see
        :meth:`Design.with_fitted_remainder`, and this remainder."""
        variances, lacks, nothing = list[FloatArray](), list[RemainderFit](), np.zeros(0)
        for channel in range(len(noise)):  # one by one, to save memory
            one = slice(channel, channel + 1)
            rows = Rows(np.zeros((len(residual), 1, 0)), residual[:, one])
            design = design_of(rows, self.valid[:, one], {}, features[one], noise[one], self.records)
            design = design.with_fitted_remainder(
                (), (), nothing, np.zeros(1), near=None if near is None else near[one]
            )
            variances += design.variances
            lacks += design.remainders((), (), nothing)
        return variances, lacks

    def design_alone(self, columns: Columns) -> Design:
        """Return rows without whitening: no remainder, white noise."""
        channels = len(self.model.channels)
        nothing, white = (self._no_features,) * channels, (Autoregression.white(),) * channels
        return design_of(self.rows, self.valid, columns, nothing, white, self.records)

    def typical_sizes(self, terms: Sequence[EffectTerm]) -> FloatArray:
        """Coefficients ``(terms,)`` at which a column first reaches the measurement in any channel; 0 without columns,
        infinite for zero columns."""
        measured, columns = root_mean_square(self.rows.targets), self.columns(terms)
        sizes = []
        for term in terms:
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = [measured[channel] / root_mean_square(column) for channel, column in columns[term].items()]
            sizes.append(float(np.fmin.reduce(ratios, initial=np.inf)) if ratios else 0.0)
        return np.array(sizes)

    def residual(self, found: JointFit, columns: Columns | None = None) -> FloatArray:
        """Measurement minus prediction ``(N, C)``, from the ``columns`` if they are known; for a delayed channel at the
        true time."""
        rows, columns = self.rows, self.columns(found.terms) if columns is None else columns
        residual: FloatArray = rows.targets - rows.coefficients @ found.loaded_inertias.ravel()
        for term in found.terms:
            for channel, column in columns[term].items():
                residual[:, channel] -= found.value(term) * column
        return residual

    def valid_rms(self, residual: FloatArray) -> FloatArray:
        """RMS ``(C,)`` of a ``residual (N, C)`` over the valid targets; NaN where there are none."""
        return root_mean_square(np.where(self.valid, residual, np.nan))

    def remainder(self, design: Design, found: JointFit) -> FloatArray:
        """Mean of the remainder ``(N, C)``, from the whitened rows of a ``design``."""
        return mean_of(self.features, found.remainders(design))

    def variance(self, found: JointFit) -> FloatArray:
        """Variance of the prediction ``(N, C)`` from the uncertainty of the fit and of the known remainder."""
        covariance, variance, columns = found.covariance, np.empty_like(self.rows.targets), self.columns(found.terms)
        for channel in range(variance.shape[1]):  # one by one, to save memory
            links = self.rows.coefficients[:, channel]
            payloads = [links[:, 10 * carrier : 10 * carrier + 10] for carrier in found.bodies]
            effects = [columns[term].get(channel, np.zeros(len(links))) for term in found.terms]
            jacobian = np.column_stack([links, *payloads, *effects])
            variance[:, channel] = np.sum((jacobian @ covariance) * jacobian, axis=1)
        if self.known_remainder is not None:
            variance += np.stack([channel.expected_variance for channel in self.features], axis=1)
        return variance


def mean_of(features: Sequence[Features], lacks: Sequence[RemainderFit]) -> FloatArray:
    """Mean of a model's remainder ``(N, C)``."""
    pairs = zip(features, lacks, strict=True)
    return np.stack(
        [channel.expected_remainder + channel.columns @ lack.coefficients for channel, lack in pairs], axis=1
    )


def design_of(
    rows: Rows,
    valid: BoolArray,
    columns: Columns,
    features: Sequence[Features],
    noise: Sequence[Autoregression],
    records: Records,
) -> Design:
    """Create the design from rows, their mask ``valid (N, C)``, and the columns, features and noise of the channels."""
    channels = []
    for channel in range(rows.targets.shape[1]):
        terms = [term for term, by_channel in columns.items() if channel in by_channel]
        effects = [columns[term][channel] for term in terms]
        nonzero, remainder = np.any(rows.coefficients[:, channel], axis=0), features[channel]
        inertial = rows.coefficients[:, channel, nonzero]
        stacked = np.column_stack(
            [inertial, *effects, rows.targets[:, channel] - remainder.expected_remainder, remainder.columns]
        )
        white = noise[channel].whiten(stacked, runs_of(valid[:, channel], records.segment))
        place = {term: inertial.shape[1] + index for index, term in enumerate(terms)}
        first = inertial.shape[1] + len(effects) + 1
        covariance = None if remainder.covariance is None else remainder.covariance / noise[channel].variances[-1]
        channels.append(
            ChannelRows(
                white[:, :first],
                white[:, first:],
                remainder.block,
                place,
                links=np.where(nonzero, np.cumsum(nonzero) - 1, -1),
                before=covariance,
                expected=remainder.mean,
            )
        )
    return Design.of(channels, rows.coefficients.shape[2])


def root_mean_square(values: FloatArray) -> FloatArray:
    """RMS of ``values (N, ...)`` over those that are measured, ``(...)``; NaN where none is."""
    counts = np.sum(np.isfinite(values), axis=0)
    squares = np.where(counts > 0, np.nansum(values**2, axis=0), np.nan)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)))
