"""Fits of some of the coefficients to a problem's rows; the choice of effects compares them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.fit import prior_std_cost, reestimated_prior_stds
from geomid_ros.estimation.objective import products_at
from geomid_ros.estimation.problem import Problem, required_columns
from geomid_ros.estimation.profile_objective import (
    Profile,
    ProfileFit,
    ProfileObjective,
    fit_scales,
)
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.coefficients import Coefficient, Mechanism
from geomid_ros.model.effects import Effect, Place
from geomid_ros.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class CoefficientRows:
    """Rows of a ``problem`` with all its coefficients: the rows of motion, which decide on all effects; or, if
    ``at_rest``, all rows, which decide only on shapes and on the effects with memory.

    At rest and near reversals dry friction depends on the past, and an effect without memory may absorb it.
    """

    problem: Problem
    at_rest: bool = False

    @cached_property
    def first_column(self) -> int:
        """Column of the first coefficient."""
        return self.problem.model.dimension - len(self.problem.model.coefficients)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.problem.model.dimension

    @property
    def has_choice(self) -> bool:
        """True if any coefficient may be left out or have another shape, and a channel has more independent rows of
        fast motion than non-optional unknowns."""
        channels, required = self.problem.model.channels, self.required_columns
        unknowns = [len(np.intersect1d(channel.columns, required)) for channel in channels]
        return len(required) < self.size and bool(np.any(self.counts[self.fast] > unknowns))

    def coefficient(self, column: int) -> Coefficient:
        """Coefficient of a column."""
        return self.problem.model.coefficients[column - self.first_column]

    def mechanism(self, column: int) -> Mechanism:
        """Mechanism of a column: its effect at its place, whatever constants it has."""
        return self.coefficient(column).mechanism

    def mechanisms(self, columns: IntArray) -> list[Mechanism]:
        """Mechanisms of those of the columns that are coefficients."""
        return [self.mechanism(column) for column in columns.tolist() if column >= self.first_column]

    @cached_property
    def required_columns(self) -> IntArray:
        """Columns of all non-optional parameters, effects in their default shape."""
        return required_columns(self.problem.model)

    @cached_property
    def shapes(self) -> dict[Mechanism, list[int]]:
        """Columns of each mechanism, in the order of its constant."""
        columns_of: dict[Mechanism, list[int]] = {}
        for column in range(self.first_column, self.size):
            columns_of.setdefault(self.mechanism(column), []).append(column)
        for columns in columns_of.values():
            columns.sort(key=lambda column: [*vars(self.coefficient(column).effect).values()])
        return columns_of

    def needed(self, column: int) -> list[int]:
        """Columns of the effects that the effect of a column needs at its place."""
        own = self.coefficient(column)
        of_needs = {(own.place, effect) for effect in own.effect.needs}
        others = range(self.first_column, self.size) if of_needs else ()
        return [
            other for other in others if (self.coefficient(other).place, self.coefficient(other).effect) in of_needs
        ]

    @cached_property
    def mechanism_numbers(self) -> IntArray:
        """Number ``(D,)`` of each parameter; shapes of one mechanism have the same."""
        numbers = np.arange(self.size)
        for columns in self.shapes.values():
            numbers[columns] = columns[0]
        return numbers

    @cached_property
    def optional(self) -> list[int]:
        """Columns of the optional coefficients that these rows decide on."""
        required = set(self.mechanisms(self.required_columns))
        every = range(self.first_column, self.size)
        columns = [column for column in every if self.mechanism(column) not in required]
        return [column for column in columns if self.coefficient(column).effect.depends_on_past or not self.at_rest]

    def candidates(self, columns: IntArray, refused: Collection[Mechanism]) -> IntArray:
        """Columns that may be added to ``columns``, without the ``refused`` mechanisms."""
        excluded = {*self.mechanisms(columns), *refused}
        return np.array([column for column in self.optional if self.mechanism(column) not in excluded], dtype=np.int64)

    @cached_property
    def positive(self) -> BoolArray:
        """True for each parameter ``(D,)`` that is a coefficient and cannot be negative."""
        return np.array([False] * self.first_column + [c.positive for c in self.problem.model.coefficients])

    def allows(self, column: int, value: float) -> bool:
        """True if a coefficient can have this value."""
        coefficient = self.coefficient(column)
        form = coefficient.effect.column_parameters[coefficient.index]
        return form.above < value < form.below and (value > 0.0 or not coefficient.positive)

    def are_plausible(self, columns: IntArray, parameters: FloatArray) -> BoolArray:
        """True for each optional coefficient among ``columns`` that is in its range, and whose effect has all that it
        needs, and does what it stands for given the others at its place, for all ``parameters (D,)``."""
        chosen = [(column, self.coefficient(column)) for column in np.intersect1d(columns, self.optional).tolist()]
        peers: dict[Place, dict[Effect, float]] = {c.place: {} for _, c in chosen}
        for column in columns[columns >= self.first_column] if chosen else ():
            coefficient = self.coefficient(column)
            if coefficient.place in peers:
                peers[coefficient.place][coefficient.effect] = float(parameters[column])
        return np.array(
            [
                self.allows(column, parameters[column])
                and np.all(parameters[self.needed(column)])
                and c.effect.is_supported(peers[c.place])
                for column, c in chosen
            ],
            dtype=np.bool_,
        )

    @cached_property
    def products(self) -> ChannelProducts:
        """Gram matrices of all columns and the target, per group, times the independent fraction of the rows."""
        products, fraction = self.problem.products, self.problem.independent_fraction
        pairs = zip(products.places, products.blocks, self.counts, strict=False)
        return ChannelProducts.of(products.size, ((places, fraction * block) for places, block, _ in pairs))

    @cached_property
    def known_products(self) -> FloatArray:
        """Gram matrix of all columns and the residual of the known rows, at the prior without effects."""
        known = self.problem.known
        return products_at(*self._prior(self.problem.scales), known.rows, known.targets)

    def _prior(self, scales: FloatArray) -> tuple[ParameterManifold, Point]:
        """Manifold with coefficients of these scales, and the prior without effects."""
        manifold = ParameterManifold(len(self.problem.default_stds), 0, scales)
        return manifold, manifold.point(np.append(self.problem.prior_inertias, np.zeros(len(scales))))

    @cached_property
    def counts(self) -> FloatArray:
        """Number of independent rows of each group."""
        count = len(self.problem.counts) - (0 if self.at_rest else len(self.problem.model.channels))
        return self.problem.independent_fraction * self.problem.counts[:count]

    @property
    def fast(self) -> slice:
        """Groups of fast motion."""
        return slice(len(self.problem.model.channels))

    def visible(self, own: IntArray) -> IntArray:
        """Groups in which an effect that acts on the groups ``own (n,)`` must be visible: those of fast motion, because
        near rest the shape of dry friction may absorb it. An effect with memory may also be visible where its own
        joints begin to move; not at rest, where friction may have any value."""
        first, last = self.fast.stop, (2 if self.at_rest else 1) * self.fast.stop
        return np.append(np.arange(first), own[(own >= first) & (own < last)])

    @cached_property
    def floors(self) -> FloatArray:
        """Noise floor of each group: the noise in slow motion is at least the least noise in fast motion."""
        floors = np.resize(self.problem.least_sigmas[self.fast], len(self.counts))
        floors[self.fast] = 0.0
        return floors

    def fit(
        self, columns: IntArray, start: CoefficientFit | None = None, *, prior_stds: FloatArray | None = None
    ) -> CoefficientFit:
        """Fit these parameters, from an earlier fit if given. ``prior_stds (links,)``: fixed prior std of the links;
        estimated unless given. Coefficients that would be negative and cannot be are zero."""
        zero = np.zeros(0, dtype=np.int64) if start is None else start.zero_columns
        fit = self._non_negative_fit(np.setdiff1d(columns, zero), start, prior_stds)
        fit = replace(fit, zero_columns=np.setdiff1d(columns, fit.columns))
        if len(wanted := np.intersect1d(fit.needlessly_zero, zero)):
            fit = self._non_negative_fit(np.union1d(fit.columns, wanted), fit, prior_stds)
        return replace(fit, zero_columns=np.setdiff1d(columns, fit.columns))

    def _non_negative_fit(
        self, columns: IntArray, start: CoefficientFit | None, prior_stds: FloatArray | None
    ) -> CoefficientFit:
        """Fit without the columns whose coefficients would be negative and cannot be."""
        fit = self._fit(columns, start, prior_stds)
        while len(negative := fit.negative):
            fit = self._fit(np.setdiff1d(fit.columns, negative), fit, prior_stds)
        return fit

    def _fit(self, columns: IntArray, start: CoefficientFit | None, given: FloatArray | None) -> CoefficientFit:
        """Fit in which every coefficient may be negative."""
        problem, default = self.problem, self.problem.default_stds
        manifold, prior = self._prior(problem.scales[columns[columns >= self.first_column] - self.first_column])
        links, point, prior_stds = manifold.inertial, prior, default
        if start is not None:
            point, prior_stds = manifold.point(start.in_any_shape[columns]), start.fit.scales
        selected = np.append(columns, self.size)
        products = self.known_products.take(selected, 0).take(selected, 1)
        profile = Profile(manifold, self.products.select(columns), self.counts, prior, self.floors)

        def objective(prior_stds: FloatArray) -> ProfileObjective:
            weights = np.append(np.repeat(prior_stds, 10) ** -2.0, np.full(len(manifold.scales), ROUNDING))
            return ProfileObjective(profile, weights, products)

        def likely(point: Point, hessian: FloatArray, _: FloatArray) -> FloatArray:
            variances = spd.variances(hessian, links.stop)
            return reestimated_prior_stds(manifold.log(prior, point)[links], variances, default)

        result = fit_scales(objective, point, prior_stds if given is None else given, likely if given is None else None)
        return CoefficientFit(self, columns, result)


@dataclass(frozen=True, eq=False)
class CoefficientFit:
    """Result ``fit`` for the ``columns`` of ``rows``; the chosen coefficients ``zero_columns`` are fixed at zero."""

    rows: CoefficientRows
    columns: IntArray
    fit: ProfileFit
    zero_columns: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @cached_property
    def parameters(self) -> FloatArray:
        """All parameters ``(D,)``; zero if left out."""
        full = np.zeros(self.rows.size)
        full[self.columns] = self.fit.point.parameters
        return full

    @property
    def in_any_shape(self) -> FloatArray:
        """All parameters ``(D,)``; a coefficient in another shape is that in the fitted shape."""
        numbers = self.rows.mechanism_numbers
        return np.asarray(np.bincount(numbers, self.parameters)[numbers], dtype=np.float64)

    @property
    def all_columns(self) -> IntArray:
        """Columns, including those fixed at zero."""
        return np.union1d(self.columns, self.zero_columns)

    @property
    def negative(self) -> IntArray:
        """Columns of coefficients that are negative and cannot be."""
        return self.columns[(self.fit.point.parameters < 0.0) & self.rows.positive[self.columns]]

    @property
    def needlessly_zero(self) -> IntArray:
        """Columns fixed at zero that would improve the fit."""
        zero = self.zero_columns
        return zero[self.gains(zero) > 0.0] if len(zero) else zero

    @cached_property
    def with_default_priors(self) -> CoefficientFit:
        """Fit of the same parameters in which the links keep the default prior std."""
        return self.rows.fit(self.all_columns, prior_stds=self.rows.problem.default_stds)

    @cached_property
    def score(self) -> float:
        """Minus twice the log marginal likelihood."""
        links = self.fit.objective.manifold.inertial
        volume = spd.log_determinant(self.fit.hessian[links, links])
        prior_stds = self.fit.scales
        width = 20.0 * float(np.sum(np.log(prior_stds))) + prior_std_cost(prior_stds, self.rows.problem.default_stds)
        return 2.0 * self.fit.evaluation.value + volume + width

    @cached_property
    def weights(self) -> FloatArray:
        """Inverse noise variances of the groups."""
        return self.rows.counts / self.residual_squares

    @cached_property
    def inverse(self) -> FloatArray:
        """Inverse of the Hessian ``(fitted, fitted)``."""
        return spd.inverse(self.fit.hessian)

    @property
    def is_plausible(self) -> BoolArray:
        """See :meth:`CoefficientRows.are_plausible`, for each of the :attr:`chosen_columns`."""
        return self.rows.are_plausible(self.all_columns, self.parameters)

    @cached_property
    def chosen_columns(self) -> IntArray:
        """Columns of the optional coefficients in this fit."""
        return np.intersect1d(self.all_columns, self.rows.optional)

    @cached_property
    def residual_squares(self) -> FloatArray:
        """Residual sum of squares of each group."""
        return self.fit.objective.profile.squares(self.fit.point)

    @cached_property
    def vector(self) -> FloatArray:
        """All parameters and minus one ``(n + 1,)``; the columns and the target times it are the residual."""
        return np.append(self.parameters, -1.0)

    def gains(self, columns: IntArray) -> FloatArray:
        """Increase of twice the log-likelihood by each of other ``columns``, by the score test; zero for a coefficient
        that would be negative and cannot be."""
        products = self.rows.products.some(columns, self.weights)
        values, squares = -products @ self.vector, products[np.arange(len(columns)), columns]
        shared = self.fit.objective.manifold.whiten(self.fit.point, products[:, self.columns])
        unexplained = squares - np.sum(shared * (shared @ self.inverse), axis=1)
        useful = ((values >= 0.0) | ~self.rows.positive[columns]) & (unexplained > ROUNDING * squares)
        return np.asarray(np.where(useful, values**2 / np.where(useful, unexplained, 1.0), 0.0))
