"""Estimation problem: the summarised rows, the known rows and the prior, with the quantities derived from these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.objective import dual_metric, products_at
from geomid_ros.estimation.starting_point import (
    DEFAULT_PRIOR_STD,
    first_fit,
    first_sigmas,
    prior_inertias,
    prior_parameters,
    prior_stds_of,
    scales_of_coefficients,
)
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.spd import SIZE
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REGIMES
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray, IntArray

# Cached properties of a problem that do not depend on its known rows.
_OF_ROWS = (
    *("default_stds", "manifold", "scales", "prior_stds", "prior", "prior_point"),
    *("products", "row_weights", "counts", "least_sigmas"),
)


@dataclass(frozen=True, eq=False)
class Problem:
    """Estimation problem.

    Attributes:
        model: measurement model of the rows.
        summary: the rows.
        given_parameters: prior parameters ``(D,)`` where they are known, else NaN; None if none is.
        known: rows of weighed masses and of priors.
        sigmas: standard deviations by channel where they are given ``(channels,)``, else NaN.
        gamma: weight of the prior as a fraction of the rows', if given.
        independent_fraction: fraction of the rows that counts as independent: the filter correlates rows, and motions
            repeat.
        given_stds: default prior std of the links ``(links,)``, if not that of CAD files.
        masses_held: indices of the links that may leave their prior, but not with their mass, with the prior std of
            the link when its mass left, too.
    """

    model: MeasurementModel
    summary: RowSummary
    given_parameters: FloatArray | None
    known: WeighedRows
    sigmas: FloatArray
    gamma: float | None
    independent_fraction: float
    given_stds: FloatArray | None = None
    masses_held: Mapping[int, float] = field(default_factory=dict)

    def with_known_rows(self, known: WeighedRows) -> Problem:
        """Return the problem with more known rows. Properties that do not depend on these are shared by both."""
        other = replace(self, known=self.known.plus(known))
        vars(other).update({name: getattr(self, name) for name in _OF_ROWS})
        return other

    def with_masses_at(self, point: Point, prior_stds: FloatArray) -> Problem:
        """Return the problem with rows that keep the prior std of each mass that is held at its default where that of
        the link, ``prior_stds (links,)``, is larger. The logarithm of the mass is linearised at a ``point``."""
        if not self.masses_held:
            return self
        links = np.array([*self.masses_held])
        rows, columns = held_mass_rows(point, links, self.default_stds, prior_stds), SIZE * links
        off = np.log(point.parameters[columns] / self.prior_inertias[columns])
        return self.with_known_rows(WeighedRows(rows, rows @ point.parameters * (1.0 - off)))

    @cached_property
    def default_stds(self) -> FloatArray:
        """Default prior std of the links ``(links,)``."""
        if self.given_stds is not None:
            return self.given_stds
        return np.full(len(self.model.body_names), DEFAULT_PRIOR_STD)

    @cached_property
    def manifold(self) -> ParameterManifold:
        """Manifold of the parameters."""
        return self.model.manifold(self.scales[self.model.positives :])

    @cached_property
    def scales(self) -> FloatArray:
        """Scale of each coefficient ``(coefficients,)``, see :func:`scales_of_coefficients`."""
        return scales_of_coefficients(self.model, self.summary)

    def default_coefficient_stds(self, point: Point) -> FloatArray:
        """Default prior std ``(coefficients,)`` of the coefficients, in tangent coordinates at a point.

        The prior std of a positive coefficient is relative to its value. Near zero that is too small: it is no better
        known than a real coefficient of its channel. A real coefficient whose prior is a first fit is known to its own
        size at best, as positive ones are.
        """
        positive, real = np.split(self.prior_stds[self.manifold.inertial.stop :], [self.model.positives])
        least = DEFAULT_PRIOR_STD * self.scales[: self.model.positives] / point.positives
        fitted = np.abs(self.prior_point.reals) / self.manifold.scales if self.given_parameters is None else 0.0
        return np.concatenate([np.maximum(positive, least), np.maximum(real, fitted)])

    @cached_property
    def first_fit_sizes(self) -> FloatArray:
        """Sizes of the real coefficients in the first fit, tangent coordinates; zero if a prior is given."""
        scales = self.manifold.scales
        if self.given_parameters is not None:
            return np.zeros(len(scales))
        return np.abs(first_fit(self.model, self.summary, None)[self.manifold.real]) / scales

    @cached_property
    def prior_stds(self) -> FloatArray:
        """Standard deviations ``(D,)`` of the prior's error, tangent coordinates, before the links' are fitted."""
        stds = prior_stds_of(self.model, self.manifold, self.given_parameters)
        stds[self.manifold.inertial] = np.repeat(self.default_stds, 10)
        return stds

    @cached_property
    def prior(self) -> FloatArray:
        """Parameters ``(D,)`` that distances are measured from."""
        return prior_parameters(self.model, self.summary, self.given_parameters)

    @property
    def prior_inertias(self) -> FloatArray:
        """Inertias ``(10 links,)`` of the :attr:`prior`, which need no fit."""
        return prior_inertias(self.model, self.given_parameters)

    @cached_property
    def prior_point(self) -> Point:
        """Point of the :attr:`prior`."""
        return self.manifold.point(self.prior)

    @cached_property
    def products(self) -> ChannelProducts:
        """Gram matrices of the columns ``[A b]`` of each group."""
        last = self.manifold.dimension
        pairs = zip(self.summary.groups, self.summary.factors(), strict=True)
        blocks = ((np.append(group.columns, last), factor.T @ factor) for group, factor in pairs)
        return ChannelProducts.of(last + 1, blocks)

    @cached_property
    def known_products(self) -> FloatArray:
        """Gram matrix of the known rows, weighted up: of the measured rows only a fraction is independent."""
        products = products_at(self.manifold, self.prior_point, self.known.rows, self.known.targets)
        return max(1.0, 1.0 / self.independent_fraction) * products

    @cached_property
    def row_weights(self) -> FloatArray:
        """Sum of the weights (Remark 2) of each group's rows, for standard deviation 1."""
        metric = dual_metric(self.manifold, self.prior_point)
        pairs = zip(self.products.places, self.products.blocks, strict=True)
        return np.array([np.sum(metric[places[:-1, None], places[:-1]] * block[:-1, :-1]) for places, block in pairs])

    @cached_property
    def known_weight(self) -> float:
        """Sum of the weights (Remark 2) of the known rows."""
        squares, links = np.diag(self.known_products)[:-1], self.manifold.inertial.stop
        rest = self.manifold.jacobian(self.prior_point)[1]
        return float(np.sum(squares[:links]) + squares[links:] @ rest**2)

    @cached_property
    def counts(self) -> FloatArray:
        """Number of rows of each group."""
        return self.summary.counts()

    @cached_property
    def least_sigmas(self) -> FloatArray:
        """Standard deviation of the part of each group that no parameters can explain."""
        return first_sigmas(self.summary, self.model.dimension)

    def noise(self, parameters: FloatArray) -> FloatArray:
        """Most likely standard deviation of each group at ``parameters (D,)``.

        It does not decrease from fast to slow motion and to rest, where dry friction may have any value. A group with
        no more rows than unknowns does not determine its noise, unless a group of faster motion does.
        """
        columns = np.array([len(channel.columns) for channel in self.model.channels])
        residual_squares = np.maximum(self.products.squares(np.append(parameters, -1.0)), 0.0)
        of_groups = self.counts, residual_squares, self.least_sigmas
        counts, squares, least = (values.reshape(REGIMES, -1) for values in of_groups)
        informative = counts > columns
        estimated = np.maximum(np.sqrt(squares / np.maximum(counts, 1.0)), np.where(informative, least, 0.0))
        determined = np.logical_or.accumulate(informative)
        sigmas = np.maximum.accumulate(np.where(determined, estimated, 0.0))
        return self._with_given(np.where(determined, sigmas, least).ravel())

    def _with_given(self, sigmas: FloatArray) -> FloatArray:
        given = np.resize(self.sigmas, len(sigmas))
        return np.where(np.isfinite(given), given, sigmas)

    @property
    def distinct(self) -> float:
        """Fraction of the independent rows that counts if a motion repeats.

        The noise is estimated from the residuals. On rows that were not fitted, squared residuals are larger by
        ``(1 - k / n)^-2``, where k parameters follow n rows (generalised cross-validation; Golub, Heath and Wahba
        1979). This is negligible unless the motion repeats. Then the remainder of the model repeats, too, and n is the
        number of rows in different states. If these are few, the parameters follow the whole remainder, and only the
        differences between repeats are left. The fraction is at least that of the rows in different states.
        """
        distinct = self.summary.visited.distinct
        rows = self.independent_fraction * float(np.sum(self.counts[self.row_weights > 0.0]))  # informative ones
        if distinct == 1.0 or rows == 0.0:
            return 1.0
        unfitted = 1.0 - self._followed / np.array([distinct * rows, rows])
        return max(float(unfitted[0] / unfitted[1]) ** 2, distinct) if unfitted[0] > 0.0 else distinct

    @property
    def _followed(self) -> float:
        """Effective number of parameters that the rows determine rather than the prior."""
        products = self.products.weighed(self.first_noise**-2.0)[:-1, :-1]
        half = self.manifold.whiten(self.prior_point, self.independent_fraction * products) * self.prior_stds
        information = self.manifold.whiten(self.prior_point, half.T) * self.prior_stds
        values = np.maximum(np.linalg.eigvalsh(information), 0.0)
        return float(np.sum(values / (1.0 + values)))

    def point_at(self, parameters: FloatArray) -> Point:
        """Point of ``parameters (D,)``; zero entries, which are left out, get the prior's value, because positive
        coefficients cannot be zero."""
        return self.manifold.point(np.where(parameters == 0.0, self.prior, parameters))

    @property
    def first_noise(self) -> FloatArray:
        """Standard deviations ``(groups,)`` with which the search for the noise starts."""
        return self._with_given(self.least_sigmas)


def held_mass_rows(point: Point, held: IntArray, default_stds: FloatArray, prior_stds: FloatArray) -> FloatArray:
    """Rows ``(n, D)`` of the logarithms of the masses of ``held (n,)`` links, linearised at a ``point``: they keep the
    prior std of these at the default ``(links,)`` where that of the link, ``prior_stds (links,)``, is larger."""
    columns, rows = SIZE * held, np.zeros((len(held), len(point.parameters)))
    kept = np.sqrt(np.maximum(default_stds**-2.0 - prior_stds**-2.0, 0.0))[held]
    rows[np.arange(len(held)), columns] = kept / point.parameters[columns]
    return rows


def required_columns(model: MeasurementModel) -> IntArray:
    """Columns of the parameters that are not optional, effects in their default shape."""
    is_required = [True] * len(model.nominal_inertias) + [not c.optional for c in model.coefficients]
    return np.flatnonzero(is_required)


def subproblem(problem: Problem, columns: IntArray) -> Problem:
    """Return the problem of these parameters alone; all other coefficients are zero."""
    first = problem.model.dimension - len(problem.model.coefficients)
    model = problem.model.with_coefficients([int(column) - first for column in columns if column >= first])
    return replace(
        problem,
        model=model,
        summary=problem.summary.with_columns(model.channels, columns),
        given_parameters=None if problem.given_parameters is None else problem.given_parameters[columns],
        known=replace(problem.known, rows=problem.known.rows[:, columns]),
    )
