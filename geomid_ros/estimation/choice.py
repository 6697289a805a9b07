"""Which effects beside the default ones the rows ask for, and which shape the default ones have.

One score decides: minus twice the logarithm of the marginal likelihood in Laplace's approximation (MacKay, "Bayesian
interpolation", 1992), with the prior odds. An effect that stands at a place in one of several shapes (the speed over
which dry friction changes its sign) has the best one. Optional effects are added one by one while they improve it, and
those go again whose size is not worth their price where blocks of time disagree on it: what they say of it, each by
itself, scatters far more than independent residuals would (:func:`variance_inflation`). So an effect is believed that
repeats.

A candidate is tried beside the inertias as they were fitted, and beside inertias that stay near the prior, because a
link that has swallowed an effect hides it. No effect is negative that cannot be.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.link_spreads import cost_of_spreads, likely_spreads
from geomid_ros.estimation.posterior import effect_columns
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.profile_objective import (
    Profile,
    ProfileFit,
    ProfileObjective,
    StraightManifold,
    fit_scales,
)
from geomid_ros.estimation.starting_point import USUAL_SPREAD_OF_REALS
from geomid_ros.estimation.uncertainty import Fold, ParameterGroup, variance_inflation
from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import Point
from geomid_ros.model.effects import joints_of
from geomid_ros.model.measurement import Coefficient, Mechanism
from geomid_ros.types import FloatArray, IntArray


def choose(problem: Problem, earlier: IntArray | None = None) -> IntArray:
    """The parameters that the rows ask for, by their columns: all that are not optional, each in its best shape, and
    the optional ones that are believed.

    Args:
        problem: with all coefficients.
        earlier: what was chosen for fewer of the same rows, to go on from.
    """
    rows = _Rows(problem)
    if not (rows.has_choice and rows.enough):
        return rows.standing
    chosen = rows.fit(rows.standing if earlier is None else earlier)
    chosen = _pruned(_shaped(chosen, range(len(problem.model.robot.joints))))
    refused: set[Mechanism] = set()
    while len(left := rows.candidates(chosen.every, refused)):
        column, larger = _best(chosen, left)
        if larger is None:
            break
        refused.add(rows.mechanism(column))
        if larger.possible and larger.score < chosen.score:
            chosen = _shaped(larger, joints_of(rows.coefficient(column).place))
    return _pruned(chosen).every


def _shaped(fit: _Fit, joints: Collection[int]) -> _Fit:
    """The fit in which every effect of ``joints`` that is not optional has its best shape, one after the other."""
    rows = fit.rows
    for mechanism in rows.always:
        if not set(joints).intersection(joints_of(mechanism[1])):
            continue
        shapes = [column for column in rows.columns if rows.mechanism(column) == mechanism]
        if len(shapes) > 1:
            rest = np.setdiff1d(fit.every, shapes)
            sets = [np.sort(np.append(rest, shape)) for shape in shapes]
            fits = [rows.fit(columns, fit, spreads=fit.fit.scales) for columns in sets]
            fit = min(fits, key=lambda shaped: shaped.score)
    return rows.fit(fit.every, fit)


def _pruned(fit: _Fit) -> _Fit:
    """The fit without the optional effects that are not believed, the least one first."""
    while len(fit.chosen):
        worth = np.max([each.worth(fit.chosen) for each in (fit, fit.firm)], axis=0)
        if np.min(worth) > 0.0 and fit.possible:
            break
        fit = fit.rows.fit(np.setdiff1d(fit.every, fit.chosen[np.argmin(worth)]), fit)
    return fit


def _best(chosen: _Fit, left: IntArray) -> tuple[int, _Fit | None]:
    """The column that promises to improve a fit most, and the fit with it; None if none does."""
    starts = (chosen, chosen.firm)
    gains = np.max([start.gains(left) for start in starts], axis=0)
    column = int(left[np.argmax(gains)])
    if np.max(gains) <= 0.0:
        return column, None
    columns = np.sort(np.append(chosen.every, column))
    return column, min((chosen.rows.fit(columns, start) for start in starts), key=lambda fit: fit.score)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The settled rows of a ``problem`` with all its coefficients."""

    problem: Problem

    @property
    def first(self) -> int:
        """The parameter that is the first of the coefficients."""
        return self.problem.model.dimension - len(self.problem.model.coefficients)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.problem.model.dimension

    @property
    def enough(self) -> bool:
        """Whether some channel has more independent rows than unknowns without a choice: fewer ask for nothing."""
        columns = [len(np.intersect1d(channel.columns, self.standing)) for channel in self.problem.model.channels]
        return bool(np.any(self.counts > columns))

    @property
    def columns(self) -> range:
        """The columns of the coefficients."""
        return range(self.first, self.size)

    def coefficient(self, column: int) -> Coefficient:
        """The coefficient of a column."""
        return self.problem.model.coefficients[column - self.first]

    def mechanism(self, column: int) -> Mechanism:
        """What there is once, whatever constants it has."""
        return self.coefficient(column).mechanism

    @cached_property
    def standing(self) -> IntArray:
        """The columns of all that may not be left out, in its usual shape."""
        return np.array([c for c in range(self.size) if c < self.first or not self.coefficient(c).optional])

    @cached_property
    def always(self) -> list[Mechanism]:
        """What is never left out."""
        return [self.mechanism(column) for column in self.standing if column >= self.first]

    @cached_property
    def optional(self) -> list[int]:
        """The columns of what may be left out."""
        always = set(self.always)
        return [column for column in self.columns if self.mechanism(column) not in always]

    @property
    def has_choice(self) -> bool:
        """Whether anything may be left out, or have another shape."""
        return len(self.standing) < self.size

    def candidates(self, columns: IntArray, refused: Collection[Mechanism]) -> IntArray:
        """The columns that may be added to others."""
        there = {self.mechanism(column) for column in columns if column >= self.first} | {*refused}
        return np.array([column for column in self.optional if self.mechanism(column) not in there], dtype=np.int64)

    def positive(self, column: int) -> bool:
        """Whether a coefficient cannot be negative."""
        return self.coefficient(column).positive

    def allows(self, column: int, value: float) -> bool:
        """Whether a coefficient can have this value."""
        coefficient = self.coefficient(column)
        form = coefficient.effect.own[coefficient.index]
        return form.above < value < form.below and (value > 0.0 or not coefficient.positive)

    def costs(self, columns: IntArray) -> FloatArray:
        """Minus twice the logarithm of the prior odds of optional effects."""
        return np.array([-2.0 * np.log(self.coefficient(column).effect.odds) for column in columns])

    def trust(self, columns: IntArray) -> FloatArray:
        """Weights of coefficients in their prior."""
        return np.asarray((USUAL_SPREAD_OF_REALS * self.problem.scales[columns - self.first]) ** -2.0)

    @cached_property
    def products(self) -> FloatArray:
        """Of each channel: all columns and the target by each other, ``(channels, D + 1, D + 1)``; only the share of
        the rows that is independent counts."""
        return np.asarray(self.problem.independent * self.problem.products[: len(self.problem.model.channels)])

    @cached_property
    def counts(self) -> FloatArray:
        """Independent rows of each channel."""
        return self.problem.independent * self.problem.counts[: len(self.problem.model.channels)]

    def fit(self, columns: IntArray, start: _Fit | None = None, *, spreads: FloatArray | None = None) -> _Fit:
        """Fit these parameters, from an earlier fit where one is given; with ``spreads (links,)`` of the links, unless
        these are to be found. Coefficients that would be negative and cannot be are zero."""
        zero = np.zeros(0, dtype=np.int64) if start is None else start.zero
        fit = self._non_negative_fit(np.setdiff1d(columns, zero), start, spreads)
        fit = replace(fit, zero=np.setdiff1d(columns, fit.columns))
        if len(wanted := np.intersect1d(fit.wanted, zero)):
            fit = self._non_negative_fit(np.union1d(fit.columns, wanted), fit, spreads)
        return replace(fit, zero=np.setdiff1d(columns, fit.columns))

    def _non_negative_fit(self, columns: IntArray, start: _Fit | None, spreads: FloatArray | None) -> _Fit:
        """The same, without the columns whose coefficients would be negative."""
        fit = self._fit(columns, start, spreads)
        while len(negative := fit.negative):
            fit = self._fit(np.setdiff1d(fit.columns, negative), fit, spreads)
        return fit

    def _fit(self, columns: IntArray, start: _Fit | None, given: FloatArray | None) -> _Fit:
        """The same, in which every coefficient may be negative."""
        problem, usual = self.problem, self.problem.usual
        manifold = StraightManifold(len(usual), 0, problem.scales[columns[columns >= self.first] - self.first])
        links = manifold.inertial
        prior = manifold.point(np.append(problem.prior[links], np.zeros(len(manifold.scales))))
        point, spreads = prior, usual
        if start is not None:
            before = np.zeros(self.size)
            before[start.columns] = start.fit.point.parameters
            point, spreads = manifold.point(before[columns]), start.fit.scales
        own = np.append(columns, self.size)
        # In the order of its axes, in which such an index leaves nothing: else it is multiplied five times as slowly.
        products = np.ascontiguousarray(self.products[:, own[:, None], own])
        known = problem.known.rows[:, columns]
        known_rows = np.column_stack([known, known @ prior.parameters - problem.known.targets])
        profile = Profile(manifold, products, self.counts, prior)

        def objective(spreads: FloatArray) -> ProfileObjective:
            every = np.append(np.repeat(spreads, 10), np.full(len(manifold.scales), USUAL_SPREAD_OF_REALS))
            return ProfileObjective(profile, every**-2.0, known_rows)

        def likely(point: Point, whitener: FloatArray) -> FloatArray:
            unsure = np.sum(whitener[:, links] ** 2, axis=0)
            return likely_spreads(manifold.log(prior, point)[links], unsure, usual)

        found = fit_scales(objective, point, spreads if given is None else given, likely if given is None else None)
        return _Fit(self, columns, found)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A ``fit`` of the ``columns`` of ``rows``; coefficients of other columns are held at ``zero``."""

    rows: _Rows
    columns: IntArray
    fit: ProfileFit
    zero: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def every(self) -> IntArray:
        """The columns, with those that are held at zero."""
        return np.union1d(self.columns, self.zero)

    @property
    def negative(self) -> IntArray:
        """The columns of coefficients that are negative, and cannot be."""
        negative = self.fit.point.parameters < 0.0
        return np.array([c for c in self.columns[negative] if c >= self.rows.first and self.rows.positive(c)])

    @property
    def wanted(self) -> IntArray:
        """The columns that are held at zero though they need not be."""
        return self.zero[self._beside(self.zero)[0] > 0.0]

    @cached_property
    def firm(self) -> _Fit:
        """The fit of the same parameters with links that keep the usual spread."""
        return self.rows.fit(self.every, spreads=self.rows.problem.usual)

    @cached_property
    def score(self) -> float:
        """Minus twice the logarithm of the marginal likelihood and of the prior odds; what is held at zero has its
        price as well."""
        cost = cost_of_spreads(self.fit.scales, self.rows.problem.usual) + float(np.sum(self.rows.costs(self.chosen)))
        return self.fit.score + cost + float(np.sum(self._prices(self.zero)))

    @cached_property
    def weights(self) -> FloatArray:
        """Inverse variances of the channels."""
        return np.asarray(self.rows.counts / self.fit.objective.profile.squares(self.fit.point))

    @property
    def possible(self) -> bool:
        """Whether all optional coefficients are in their ranges."""
        every = np.zeros(self.rows.size)
        every[self.columns] = self.fit.point.parameters
        return all(map(self.rows.allows, self.chosen.tolist(), every[self.chosen].tolist()))

    @cached_property
    def chosen(self) -> IntArray:
        """The columns that are optional."""
        return np.intersect1d(self.every, self.rows.optional)

    @cached_property
    def _vector(self) -> FloatArray:
        """All parameters and minus one ``(n + 1,)``: the residual is what the columns with the target leave of it."""
        vector = np.zeros(self.rows.size + 1)
        vector[self.columns], vector[-1] = self.fit.point.parameters, -1.0
        return vector

    def worth(self, columns: IntArray) -> FloatArray:
        """By how much the score is worse without some optional coefficients, as their sizes say, by the density at
        nothing of posterior and prior (Dickey, "The weighted likelihood ratio", 1971); the posterior is as wide as
        blocks of time show. Nothing of what is held at zero."""
        real = self.columns >= self.rows.first
        variances = (self._inflation * np.diag(definite.inverse(self.fit.hessian)))[real]
        values = self.fit.objective.manifold.log(self.fit.objective.profile.prior, self.fit.point)[real]
        worth = np.full(self.rows.size, -np.inf)
        price = np.maximum(np.log(USUAL_SPREAD_OF_REALS**2 / variances), 0.0)
        worth[self.columns[real]] = values**2 / variances - price
        return np.asarray(worth[columns] - self.rows.costs(columns))

    @property
    def _inflation(self) -> FloatArray:
        """How much larger the variances of its parameters are than those by independent residuals, of each effect at
        all its places ``(D,)``."""
        rows, objective = self.rows, self.fit.objective
        summary, channels = rows.problem.summary, len(self.weights)
        sigmas = np.full(len(summary.groups), np.inf)  # what is not settled says nothing
        sigmas[:channels] = (rows.problem.independent * self.weights) ** -0.5
        own = np.append(self.columns, rows.size)
        products = summary.products(sigmas, rows.size)[:, own[:, None], own]
        folds = [Fold.at(objective.manifold, self.fit.point, each) for each in products]
        known = objective.manifold.whiten(self.fit.point, objective.known[:, :-1])
        names = (rows.coefficient(column).effect.name for column in self.columns[self.columns >= rows.first])
        effects = effect_columns(names, rows.first).values()
        groups = [ParameterGroup(places, USUAL_SPREAD_OF_REALS) for places in effects]
        return variance_inflation(folds, known.T @ known, objective.weights, groups)

    def gains(self, columns: IntArray) -> FloatArray:
        """By how much each of other ``columns`` would improve the score, by the score test; nothing of a coefficient
        that would be negative and cannot be."""
        slopes, left = self._beside(columns)
        positive = np.array([self.rows.positive(column) for column in columns])
        gains = slopes**2 / (left + self.rows.trust(columns)) - self._prices(columns) - self.rows.costs(columns)
        return np.asarray(np.where(positive & (slopes < 0.0), 0.0, gains))

    def _prices(self, columns: IntArray) -> FloatArray:
        """By how much the data narrow other coefficients, as minus twice a logarithm."""
        return np.asarray(np.log1p(self._beside(columns)[1] / self.rows.trust(columns)))

    def _beside(self, columns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Slopes of half twice the log likelihood along other columns, and their squares that the own ones leave."""
        manifold = self.fit.objective.manifold
        whitener = manifold.whiten(self.fit.point, np.eye(len(self.columns)))
        products = np.tensordot(self.weights, self.rows.products[:, columns], axes=1)
        shared = products[:, self.columns].T
        projected = whitener @ definite.inverse(self.fit.hessian) @ whitener.T @ shared
        left = products[np.arange(len(columns)), columns] - np.sum(shared * projected, axis=0)
        return -products @ self._vector, np.maximum(left, 0.0)
