"""The problem linearised at a total model: what depends on the model itself is computed there anew."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import cached_property

import numpy as np

from geomid_ros.gap.candidates import Candidate, EffectTerm, NamesFit
from geomid_ros.gap.evidence.features import Basis, Features, StandingRemainder, features
from geomid_ros.gap.evidence.noise import Autoregression, runs_of
from geomid_ros.gap.evidence.record import FEWEST_ROWS, Records, TotalModel
from geomid_ros.inference.design import ChannelRows, Design, Lack
from geomid_ros.model.effects import Effect, MotionEffect, Place, SensorEffect, Situation, SituationEffect, joints_of
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.types import BoolArray, FloatArray

Columns = Mapping[EffectTerm, Mapping[int, FloatArray]]
"""Of each term, by channel ``(N,)``."""

_FRICTION_ERROR = 0.7  # of the noise: where dry friction is less sure than this nothing is learnt and nothing judged


def total_model(model: MeasurementModel, found: NamesFit) -> TotalModel:
    """The whole model that a joint fit says."""
    inertias = np.array([body.parameters for body in model.robot.bodies])
    inertias[list(model.identified)] = found.loaded_inertias
    grouped: dict[tuple[Effect, Place], list[float]] = {}
    for term in found.terms:
        if isinstance(term, EffectTerm):
            grouped.setdefault((term.effect, term.place), []).append(found.value(term))
    effects = tuple((effect, place, effect.linearised_at(np.array(own))) for (effect, place), own in grouped.items())
    return TotalModel(inertias, effects, model.robot.gravity)


class LinearisedProblem:
    """Records under a model linearised at ``total``, beside what it is known to lack (``standing``).

    An effect that is absorbed (a tilt, delay or gain) is not added as its column: the gravity is turned, the efforts
    are moved, the rows scaled; and the target is changed so that the coefficients still mean the whole tilt, delay and
    gain.
    """

    def __init__(
        self,
        model: MeasurementModel,
        records: Records,
        total: TotalModel,
        floor: FloatArray | None = None,
        standing: StandingRemainder | None = None,
    ) -> None:
        self.total = total
        self.standing = standing
        self.floor = np.full(len(model.channels), np.inf) if floor is None else floor
        self.records = records.advanced(total.lag)
        gravity = total.gravity
        self.model = model.with_gravity(gravity) if np.any(gravity != model.robot.gravity) else model
        self._scales = total.scales(len(model.channels))

    def with_floor(self, floor: FloatArray) -> LinearisedProblem:
        """The same, with the noise ``floor (C,)`` by which instants are valid."""
        problem = copy(self)
        problem.floor = floor
        vars(problem).pop("valid", None)
        return problem

    def told_floor(self, left: FloatArray) -> tuple[FloatArray, BoolArray]:
        """The noise floor that is ``left (C,)``, and of which channels it is told: of others it is the one before.

        What few rows leave is less than the noise, by which fewer instants are valid, which leave even less: where
        those would be too few the rows do not tell the noise.
        """
        valid = np.count_nonzero(self.with_floor(left).valid, axis=0)
        told = (valid >= FEWEST_ROWS) | np.isinf(self.floor)
        return np.where(told, left, self.floor), told

    @cached_property
    def situation(self) -> Situation:
        """What the total model says."""
        return self.records.situation(self.model, self.total)

    @cached_property
    def rows(self) -> Rows:
        """Rows of the inertias, with the targets changed."""
        rows = self.records.rows(self.model)
        targets = rows.targets.copy()
        for effect, place, coefficients in self.total.absorbed:
            column = effect.columns(self.situation, place) @ coefficients
            targets += column if effect.scales_measurement else column * self._scales
        is_scaled = np.any(self._scales != 1.0)
        return Rows(rows.coefficients * self._scales[:, None] if is_scaled else rows.coefficients, targets)

    @cached_property
    def valid(self) -> BoolArray:
        """Which targets ``(N, C)`` are measured at instants that the model can be blamed for: not where a joint's dry
        friction is uncertain by more than a share of the noise, nor where that reaches other channels through the
        joint's acceleration."""
        valid = self.records.usable(self.model, self.rows.targets)
        if not self.model.layout.efforts or not np.any(self._dry_friction):
            return valid
        joints = self._dry_friction.shape[1]
        by_acceleration = np.abs(self.situation.by_acceleration)
        own = np.einsum("njj->nj", by_acceleration[:, :joints])
        shares = by_acceleration / np.maximum(own, 1e-12)[:, None]
        uncertain = np.max(shares * (self._dry_friction * self.records.unsettled)[:, None], axis=2)
        return np.asarray(valid & (uncertain < _FRICTION_ERROR * self.floor))

    @cached_property
    def _dry_friction(self) -> FloatArray:
        """Size of the dry friction that the total model says ``(N, joints)``."""
        sizes = np.zeros((len(self.records.samples), len(self.model.robot.joints)))
        for effect, place, (coefficient, *_) in self.total.effects:
            for joint in joints_of(place):
                sizes[:, joint] += effect.dry_friction(coefficient, self.situation.transmitted[:, joint])
        return sizes

    def columns(
        self, candidates: Sequence[Candidate], base: Sequence[EffectTerm]
    ) -> dict[EffectTerm, dict[int, FloatArray]]:
        """Columns of all candidates, and of what the model already has."""
        terms = dict.fromkeys([*base, *(term for candidate in candidates for term in candidate.terms)])
        columns = term_columns(self.model, self.records, list(terms), lambda: self.situation)
        for channel in np.flatnonzero(self._scales != 1.0).tolist():
            for term, by_channel in columns.items():
                if channel in by_channel and not term.effect.scales_measurement:
                    by_channel[channel] = by_channel[channel] * self._scales[channel]
        return columns

    @cached_property
    def features(self) -> list[Features]:
        """What the remainder of each channel may consist of."""
        channels, known = range(len(self.model.channels)), self.standing
        basis = self.basis if known is None else known.basis
        found = [features(self.model, self.records, self.situation, channel, basis) for channel in channels]
        return found if known is None else known.beside(found)

    @property
    def expected(self) -> FloatArray:
        """What the model is known to lack ``(N, C)``."""
        if self.standing is None:
            return np.zeros(self.rows.targets.shape)
        return np.stack([own.known for own in self.features], axis=1)

    @cached_property
    def basis(self) -> Basis:
        """The features' usual basis for these records."""
        return Basis.of(self.model, self.records, self.situation)

    def design(self, columns: Columns, noise: Sequence[Autoregression]) -> Design:
        """Whitened rows."""
        return design_of(self.rows, self.valid, columns, self.features, noise, self.records)

    @property
    def told(self) -> list[Features]:
        """The features, none of a channel without rows."""
        nothing = Features(np.zeros((len(self.valid), 0)), np.zeros(0, dtype=np.intp), ())
        pairs = zip(self.features, np.any(self.valid, axis=0), strict=True)
        return [own if has_rows else nothing for own, has_rows in pairs]

    def lacks(
        self,
        residual: FloatArray,
        features: Sequence[Features],
        noise: Sequence[Autoregression],
        near: Sequence[FloatArray] | None,
    ) -> tuple[list[FloatArray], list[Lack]]:
        """Of each channel the variances of the most likely remainder of a ``residual (N, C)``, see
        :meth:`Design.settled`, and what it is."""
        variances, lacks, nothing = list[FloatArray](), list[Lack](), np.zeros(0)
        for channel in range(len(noise)):  # one by one, as each takes much memory
            own = slice(channel, channel + 1)
            rows = Rows(np.zeros((len(residual), 1, 0)), residual[:, own])
            design = design_of(rows, self.valid[:, own], {}, features[own], noise[own], self.records)
            design = design.settled((), (), nothing, np.zeros(1), near=None if near is None else near[own])
            variances += design.variances
            lacks += design.remainders((), (), nothing)
        return variances, lacks

    def design_alone(self, columns: Columns) -> Design:
        """Rows as they are: beside no remainder, in white noise."""
        channels = len(self.model.channels)
        nothing = Features(np.zeros((len(self.rows.targets), 0)), np.zeros(0, dtype=np.intp), ())
        white = (Autoregression.white(),) * channels
        return design_of(self.rows, self.valid, columns, (nothing,) * channels, white, self.records)

    def usual_sizes(self, terms: Sequence[EffectTerm]) -> FloatArray:
        """The coefficients ``(terms,)`` with which columns are as large as what is measured, at most; 0 without any,
        infinite of columns that are zero."""
        measured, columns = root_mean_square(self.rows.targets), self.columns((), terms)
        sizes = []
        for term in terms:
            with np.errstate(divide="ignore", invalid="ignore"):
                own = [measured[channel] / root_mean_square(column) for channel, column in columns[term].items()]
            sizes.append(float(np.fmin.reduce(own, initial=np.inf)) if own else 0.0)
        return np.array(sizes)

    def residual(self, columns: Columns, found: NamesFit) -> FloatArray:
        """Measured less predicted ``(N, C)``; of a delayed channel at the moment at which it was true."""
        rows = self.rows
        residual: FloatArray = rows.targets - rows.coefficients @ found.loaded_inertias.ravel()
        for term in found.terms:
            for channel, column in columns[term].items():
                residual[:, channel] -= found.value(term) * column
        return residual

    def remainder(self, design: Design, found: NamesFit) -> FloatArray:
        """The mean of what the model lacks ``(N, C)``, of the whitened rows of a ``design``."""
        return mean_of(self.features, found.remainders(design))

    def variance(self, columns: Columns, found: NamesFit) -> FloatArray:
        """Of the prediction ``(N, C)``, from the uncertainty of what was fitted."""
        covariance, variance = found.covariance, np.empty_like(self.rows.targets)
        for channel in range(variance.shape[1]):  # one by one, as rows of all take much memory
            links = self.rows.coefficients[:, channel]
            again = [links[:, 10 * carrier : 10 * carrier + 10] for carrier in found.bodies]
            own = [columns[term].get(channel, np.zeros(len(links))) for term in found.terms]
            jacobian = np.column_stack([links, *again, *own])
            variance[:, channel] = np.sum((jacobian @ covariance) * jacobian, axis=1)
        return variance


def term_columns(
    model: MeasurementModel, records: Records, terms: Sequence[EffectTerm], situation: Callable[[], Situation]
) -> dict[EffectTerm, dict[int, FloatArray]]:
    """Columns of effects' terms at the chosen rows, by the channels that they reach; ``situation``, which takes
    long, is asked for only when a term needs it."""
    found: dict[EffectTerm, dict[int, FloatArray]] = {}
    for term in terms:
        if isinstance(term.effect, SituationEffect):
            columns = term.effect.columns(situation(), term.place)[:, :, term.index]
            found[term] = {channel: column for channel, column in enumerate(columns.T) if np.any(column)}
        elif isinstance(term.effect, MotionEffect | SensorEffect):
            found[term] = model.columns_of(records.samples, term.effect, term.place, term.index)
    model.eliminate_ground(records.samples, found.values())
    return found


def mean_of(features: Sequence[Features], lacks: Sequence[Lack]) -> FloatArray:
    """The mean of what a model lacks ``(N, C)``."""
    pairs = zip(features, lacks, strict=True)
    return np.stack([own.known + own.columns @ lack.coefficients for own, lack in pairs], axis=1)


def design_of(
    rows: Rows,
    valid: BoolArray,
    columns: Columns,
    features: Sequence[Features],
    noise: Sequence[Autoregression],
    records: Records,
) -> Design:
    """From rows, which of them are ``valid (N, C)``, columns, features and noise of the channels."""
    channels = []
    for channel in range(rows.targets.shape[1]):
        terms = [term for term, by_channel in columns.items() if channel in by_channel]
        own = [columns[term][channel] for term in terms]
        felt, remainder = np.any(rows.coefficients[:, channel], axis=0), features[channel]
        inertial = rows.coefficients[:, channel, felt]
        stacked = np.column_stack([inertial, *own, rows.targets[:, channel] - remainder.known, remainder.columns])
        white = noise[channel].whiten(stacked, runs_of(valid[:, channel], records.segment))
        place = {term: inertial.shape[1] + index for index, term in enumerate(terms)}
        first = inertial.shape[1] + len(own) + 1
        unsure = None if remainder.unsure is None else remainder.unsure / noise[channel].variances[-1]
        channels.append(
            ChannelRows.of(
                white[:, :first],
                white[:, first:],
                remainder.block,
                place,
                links=np.where(felt, np.cumsum(felt) - 1, -1),
                before=unsure,
                expected=remainder.mean,
            )
        )
    return Design.of(channels, rows.coefficients.shape[2])


def root_mean_square(values: FloatArray) -> FloatArray:
    """RMS of ``values (N, ...)`` over those that are measured, ``(...)``; NaN where none is."""
    counts = np.sum(np.isfinite(values), axis=0)
    squares = np.where(counts > 0, np.nansum(values**2, axis=0), np.nan)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)))
