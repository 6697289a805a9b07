"""Fits of some of the coefficients to a problem's rows, as the choice of effects compares them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.fit import cost_of_spreads, likely_spreads
from geomid_ros.estimation.objective import rows_at
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.profile_objective import (
    Profile,
    ProfileFit,
    ProfileObjective,
    StraightManifold,
    fit_scales,
)
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import Point
from geomid_ros.model.coefficients import Coefficient, Mechanism
from geomid_ros.model.effects import Effect, Place
from geomid_ros.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class CoefficientRows:
    """The rows of a ``problem`` with all its coefficients: those of motion, by which all effects are judged but those
    that remember; or, for these, all rows.

    At rest and near reversals dry friction depends on the past, and what does not may stand for it.
    """

    problem: Problem
    at_rest: bool = False

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
        unknowns = [len(np.intersect1d(channel.columns, self.standing)) for channel in self.problem.model.channels]
        return bool(np.any(self.counts[self.fast] > unknowns))

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
    def shapes(self) -> dict[Mechanism, list[int]]:
        """The columns of what there is once, in the order of its constant."""
        found: dict[Mechanism, list[int]] = {}
        for column in self.columns:
            found.setdefault(self.mechanism(column), []).append(column)
        for own in found.values():
            own.sort(key=lambda column: [*vars(self.coefficient(column).effect).values()])
        return found

    @cached_property
    def optional(self) -> list[int]:
        """The columns of what may be left out, and is judged by these rows."""
        always = set(self.always)
        own = [column for column in self.columns if self.mechanism(column) not in always]
        return [column for column in own if self.coefficient(column).effect.remembers or not self.at_rest]

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

    @cached_property
    def products(self) -> ChannelProducts:
        """Of each group: all columns and the target by each other; only the share of the rows that is independent
        counts."""
        return self.problem.products.first(len(self.counts)).times(self.problem.independent)

    @cached_property
    def known_products(self) -> FloatArray:
        """Of the rows that are known, at the prior without effects: all columns and the residual by each other."""
        manifold = StraightManifold(len(self.problem.usual), 0, self.problem.scales)
        prior = manifold.point(np.append(self.problem.prior[: self.first], np.zeros(len(manifold.scales))))
        known = rows_at(manifold, prior, self.problem.known.rows, self.problem.known.targets)
        return np.asarray(known.T @ known)

    @cached_property
    def counts(self) -> FloatArray:
        """Independent rows of each group."""
        count = len(self.problem.counts) - (0 if self.at_rest else len(self.problem.model.channels))
        return self.problem.independent * self.problem.counts[:count]

    @property
    def fast(self) -> slice:
        """The groups of fast motion, in which an effect has to be visible: near rest the shape of dry friction may
        stand for it."""
        return slice(len(self.problem.model.channels))

    @cached_property
    def floors(self) -> FloatArray:
        """Least noise of each group: a channel's in slow motion is no less than in fast motion."""
        floors = np.resize(self.problem.least_sigmas[self.fast], len(self.counts))
        floors[self.fast] = 0.0
        return floors

    def fit(
        self, columns: IntArray, start: CoefficientFit | None = None, *, spreads: FloatArray | None = None
    ) -> CoefficientFit:
        """Fit these parameters, from an earlier fit where one is given; with ``spreads (links,)`` of the links, unless
        these are to be found. Coefficients that would be negative and cannot be are zero."""
        zero = np.zeros(0, dtype=np.int64) if start is None else start.zero
        fit = self._non_negative_fit(np.setdiff1d(columns, zero), start, spreads)
        fit = replace(fit, zero=np.setdiff1d(columns, fit.columns))
        if len(wanted := np.intersect1d(fit.wanted, zero)):
            fit = self._non_negative_fit(np.union1d(fit.columns, wanted), fit, spreads)
        return replace(fit, zero=np.setdiff1d(columns, fit.columns))

    def _non_negative_fit(
        self, columns: IntArray, start: CoefficientFit | None, spreads: FloatArray | None
    ) -> CoefficientFit:
        """The same, without the columns whose coefficients would be negative."""
        fit = self._fit(columns, start, spreads)
        while len(negative := fit.negative):
            fit = self._fit(np.setdiff1d(fit.columns, negative), fit, spreads)
        return fit

    def _fit(self, columns: IntArray, start: CoefficientFit | None, given: FloatArray | None) -> CoefficientFit:
        """The same, in which every coefficient may be negative."""
        problem, usual = self.problem, self.problem.usual
        manifold = StraightManifold(len(usual), 0, problem.scales[columns[columns >= self.first] - self.first])
        links = manifold.inertial
        prior = manifold.point(np.append(problem.prior[links], np.zeros(len(manifold.scales))))
        point, spreads = prior, usual
        if start is not None:
            point, spreads = manifold.point(start.parameters[columns]), start.fit.scales
        own = np.append(columns, self.size)
        products = self.known_products.take(own, 0).take(own, 1)
        profile = Profile(manifold, self.products.select(columns), self.counts, prior, self.floors)

        def objective(spreads: FloatArray) -> ProfileObjective:
            weights = np.append(np.repeat(spreads, 10) ** -2.0, np.full(len(manifold.scales), ROUNDING))
            return ProfileObjective(profile, weights, products)

        def likely(point: Point, hessian: FloatArray, _: FloatArray) -> FloatArray:
            unsure = definite.variances(hessian, links.stop)
            return likely_spreads(manifold.log(prior, point)[links], unsure, usual)

        found = fit_scales(objective, point, spreads if given is None else given, likely if given is None else None)
        return CoefficientFit(self, columns, found)


@dataclass(frozen=True, eq=False)
class CoefficientFit:
    """A ``fit`` of the ``columns`` of ``rows``; coefficients of other columns are held at ``zero``."""

    rows: CoefficientRows
    columns: IntArray
    fit: ProfileFit
    zero: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @cached_property
    def parameters(self) -> FloatArray:
        """All parameters ``(D,)``, zero where they are left out."""
        every = np.zeros(self.rows.size)
        every[self.columns] = self.fit.point.parameters
        return every

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
        return self.zero[self.gains(self.zero) > 0.0] if len(self.zero) else self.zero

    @cached_property
    def firm(self) -> CoefficientFit:
        """The fit of the same parameters with links that keep the usual spread."""
        return self.rows.fit(self.every, spreads=self.rows.problem.usual)

    @cached_property
    def score(self) -> float:
        """Minus twice the logarithm of the marginal likelihood."""
        links = self.fit.objective.manifold.inertial
        volume = definite.log_determinant(self.fit.hessian[links, links])
        spreads = self.fit.scales
        width = 20.0 * float(np.sum(np.log(spreads))) + cost_of_spreads(spreads, self.rows.problem.usual)
        return 2.0 * self.fit.evaluation.value + volume + width

    @cached_property
    def weights(self) -> FloatArray:
        """Inverse variances of the groups."""
        return self.rows.counts / self.left

    @property
    def possible(self) -> BoolArray:
        """Whether each of the :attr:`chosen` is in its range, and does what it stands for beside all others at its
        place."""
        every = self.parameters
        there: dict[Place, dict[Effect, float]] = {}
        for column in self.every[self.every >= self.rows.first].tolist():
            own = self.rows.coefficient(column)
            there.setdefault(own.place, {})[own.effect] = float(every[column])
        pairs = [(column, self.rows.coefficient(column)) for column in self.chosen.tolist()]
        return np.array(
            [self.rows.allows(column, every[column]) and c.effect.is_borne_out(there[c.place]) for column, c in pairs],
            dtype=np.bool_,
        )

    @cached_property
    def chosen(self) -> IntArray:
        """The columns that are optional."""
        return np.intersect1d(self.every, self.rows.optional)

    @cached_property
    def left(self) -> FloatArray:
        """Sum of squares of each group."""
        return self.fit.objective.profile.squares(self.fit.point)

    def leaves_less(self, smaller: CoefficientFit, share: float) -> bool:
        """Whether it leaves less of some channel by this share, links as they were fitted or such as stay near the
        prior."""
        pairs, fast = ((self, smaller), (self.firm, smaller.firm)), self.rows.fast
        return any(bool(np.any(one.left[fast] < (1.0 - share) * other.left[fast])) for one, other in pairs)

    @cached_property
    def _vector(self) -> FloatArray:
        """All parameters and minus one ``(n + 1,)``: the residual is what the columns with the target leave of it."""
        return np.append(self.parameters, -1.0)

    @property
    def _slopes(self) -> FloatArray:
        """Half the derivative of the squares of each fold that has rows by each of its coefficients ``(folds, k)``."""
        problem = self.rows.problem
        slopes = np.zeros((problem.summary.folds, self.rows.size + 1))
        for channel, weight, parts in zip(problem.summary.groups, self.weights, problem.summary.parts(), strict=False):
            own = np.append(channel.columns, self.rows.size)
            residuals = [part.factor @ self._vector[own] for part in parts]
            slopes[:, own] += weight * np.array([r @ part.factor for r, part in zip(residuals, parts, strict=True)])
        slopes *= problem.independent
        return slopes[np.any(slopes, axis=1)][:, self.columns]

    def squares_of(self, columns: IntArray) -> FloatArray:
        """Squares of some of its coefficients in units of their variances."""
        inverse, manifold = definite.inverse(self.fit.hessian), self.fit.objective.manifold
        slopes = manifold.whiten(self.fit.point, self._slopes)
        real = self.columns >= self.rows.first
        variances = np.diag(inverse)[real]
        inflation = self._inflation(self.columns[real], (slopes @ inverse)[:, real], variances)
        values = manifold.log(self.fit.objective.profile.prior, self.fit.point)[real]
        squares = np.zeros(self.rows.size)
        squares[self.columns[real]] = values**2 / (inflation * variances)
        return np.asarray(squares[columns])

    def gains(self, columns: IntArray) -> FloatArray:
        """By how much each of other ``columns`` would improve twice the log likelihood, by the score test; zero for a
        coefficient that would be negative and cannot be."""
        products = self.rows.products.some(columns, self.weights)
        values = -products @ self._vector
        gains, able = np.zeros(len(columns)), np.flatnonzero((values >= 0.0) | ~self._positive(columns))
        if len(able):
            shared = self.fit.objective.manifold.whiten(self.fit.point, products[able[:, None], self.columns])
            squares = products[able, columns[able]]
            left = squares - np.sum(shared.T * definite.solved_anyway(self.fit.hessian, shared.T), axis=0)
            possible = left > ROUNDING * squares
            gains[able] = np.where(possible, values[able] ** 2 / np.where(possible, left, 1.0), 0.0)
        return gains

    def _positive(self, columns: IntArray) -> BoolArray:
        """Whether coefficients cannot be negative."""
        return np.array([self.rows.positive(column) for column in columns], dtype=np.bool_)

    def _inflation(self, columns: IntArray, parts: FloatArray, variances: FloatArray) -> FloatArray:
        """How much larger the variances of coefficients are than those by independent residuals, by what each fold says
        of them, ``parts (folds, columns)``; others of a kind count as one fold more."""
        count = len(parts)
        if count < 2:
            return np.ones(len(columns))
        scatter = count / (count - 1.0) * np.sum((parts - np.mean(parts, axis=0)) ** 2, axis=0) / variances
        kinds = np.array([self.rows.coefficient(column).effect.name for column in columns])
        means = {kind: float(np.mean(scatter[kinds == kind])) for kind in set(kinds.tolist())}
        of_kind = np.array([means[kind] for kind in kinds.tolist()])
        return np.asarray(np.maximum(((count - 1.0) * scatter + of_kind) / count, 1.0))
