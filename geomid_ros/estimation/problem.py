"""What is to be fitted: the summarised rows, what is known beside them, and what follows from both at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.objective import dual_metric, row_weights, rows_at
from geomid_ros.estimation.starting_point import (
    USUAL_SPREAD,
    first_sigmas,
    prior_parameters,
    prior_spreads,
    scales_of_coefficients,
)
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import REGIMES
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray, IntArray

# Of a problem: what does not depend on what is known beside the rows.
_OF_ROWS = (
    *("usual", "manifold", "scales", "prior_spreads", "prior", "prior_point"),
    *("products", "row_weights", "counts", "least_sigmas"),
)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be fitted.

    Attributes:
        model: what the rows mean.
        summary: the rows.
        given: parameters ``(D,)`` of the prior where they are known, else NaN; None if none is.
        known: rows of weighed masses.
        sigmas: standard deviations by channel where they are given ``(channels,)``, else NaN.
        gamma: the prior's weight as a share of the rows', if it is given.
        independent: share of the rows that counts: filtered rows are not independent.
        given_spreads: usual spreads of the links' priors ``(links,)``, if they are not those of CAD files.
    """

    model: MeasurementModel
    summary: RowSummary
    given: FloatArray | None
    known: WeighedRows
    sigmas: FloatArray
    gamma: float | None
    independent: float
    given_spreads: FloatArray | None = None

    def beside(self, known: WeighedRows) -> Problem:
        """The problem with more known rows; what else follows from its own rows is computed once for both."""
        other = replace(self, known=self.known.plus(known))
        vars(other).update({name: getattr(self, name) for name in _OF_ROWS})
        return other

    @cached_property
    def usual(self) -> FloatArray:
        """The usual spreads of the links' priors ``(links,)``."""
        if self.given_spreads is not None:
            return self.given_spreads
        return np.full(len(self.model.body_names), USUAL_SPREAD)

    @cached_property
    def manifold(self) -> ParameterManifold:
        """Where the parameters live."""
        return self.model.manifold(self.scales[self.model.positives :])

    @cached_property
    def scales(self) -> FloatArray:
        """The scale of each coefficient ``(coefficients,)``, see :func:`scales_of_coefficients`."""
        return scales_of_coefficients(self.model, self.summary)

    def usual_errors(self, point: Point) -> FloatArray:
        """Usual errors ``(coefficients,)`` of the coefficients' priors, tangent coordinates at a point.

        That of a logarithm says nothing of how large a positive coefficient may be that is next to nothing: it is no
        better known than a real one of its channel. A real one that was fitted first is known to its own size at best,
        as positive ones are.
        """
        positive, real = np.split(self.prior_spreads[self.manifold.inertial.stop :], [self.model.positives])
        least = USUAL_SPREAD * self.scales[: self.model.positives] / point.positives
        fitted = np.abs(self.prior_point.reals) / self.manifold.scales if self.given is None else 0.0
        return np.concatenate([np.maximum(positive, least), np.maximum(real, fitted)])

    @cached_property
    def prior_spreads(self) -> FloatArray:
        """Standard deviations ``(D,)`` of the prior's error, tangent coordinates, before the links' are fitted."""
        spreads = prior_spreads(self.model, self.manifold, self.given)
        spreads[self.manifold.inertial] = np.repeat(self.usual, 10)
        return spreads

    @cached_property
    def prior(self) -> FloatArray:
        """The parameters ``(D,)`` that distances are measured from."""
        return prior_parameters(self.model, self.summary, self.given)

    @cached_property
    def prior_point(self) -> Point:
        """The prior."""
        return self.manifold.point(self.prior)

    @cached_property
    def products(self) -> ChannelProducts:
        """The columns ``[A b]`` of each group by each other."""
        last = self.manifold.dimension
        pairs = zip(self.summary.groups, self.summary.factors(), strict=True)
        own = ((np.append(group.columns, last), factor.T @ factor) for group, factor in pairs)
        return ChannelProducts.of(last + 1, own)

    @cached_property
    def known_products(self) -> FloatArray:
        """Products of what is known, with the weight that it has among rows of which only a share counts."""
        rows = rows_at(self.manifold, self.prior_point, self.known.rows, self.known.targets)
        return np.asarray(self._known_factor * rows.T @ rows)

    @property
    def _known_factor(self) -> float:
        return max(1.0, 1.0 / self.independent)

    @cached_property
    def row_weights(self) -> FloatArray:
        """Of each group: the sum of the weights (Remark 2) of its rows, if their standard deviation is 1."""
        metric = dual_metric(self.manifold, self.prior_point)
        pairs = zip(self.products.places, self.products.blocks, strict=True)
        return np.array([np.sum(metric[own[:-1, None], own[:-1]] * block[:-1, :-1]) for own, block in pairs])

    @cached_property
    def known_weight(self) -> float:
        """The same of the weighed masses."""
        ones = np.ones(len(self.known.rows))
        return self._known_factor * float(np.sum(row_weights(self.manifold, self.prior_point, self.known.rows, ones)))

    @cached_property
    def counts(self) -> FloatArray:
        """Rows of each group."""
        return self.summary.counts()

    @cached_property
    def least_sigmas(self) -> FloatArray:
        """Of each group: what no parameters can explain."""
        return first_sigmas(self.summary, self.model.dimension)

    def rows(self, sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
        """All measured rows, in units of their standard deviations ``(groups,)``."""
        return self.summary.compressed(sigmas, self.manifold.dimension)

    def squares(self, parameters: FloatArray) -> FloatArray:
        """Sums of squares of each group's residuals."""
        return np.maximum(self.products.squares(np.append(parameters, -1.0)), 0.0)

    def noise(self, parameters: FloatArray) -> FloatArray:
        """The standard deviation of each group that is most likely at ``parameters (D,)``.

        Nothing is surer in slow motion, or at rest, where dry friction may have any value, than in fast motion. A group
        that has hardly more rows than unknowns says nothing of its noise, unless one of faster motion does.
        """
        columns = np.array([len(channel.columns) for channel in self.model.channels])
        counts, squares, least = (
            each.reshape(REGIMES, -1) for each in (self.counts, self.squares(parameters), self.least_sigmas)
        )
        telling = counts > columns
        found = np.maximum(np.sqrt(squares / np.maximum(counts, 1.0)), np.where(telling, least, 0.0))
        known = np.logical_or.accumulate(telling)
        sigmas = np.maximum.accumulate(np.where(known, found, 0.0))
        return self._with_given(np.where(known, sigmas, least).ravel())

    def _with_given(self, sigmas: FloatArray) -> FloatArray:
        given = np.resize(self.sigmas, len(sigmas))
        return np.where(np.isfinite(given), given, sigmas)

    @property
    def distinct(self) -> float:
        """The share of the independent rows that counts where a motion repeats.

        How sure rows are is found from what parameters leave of them. On rows that were not fitted the squares are by
        ``(1 - k / n)^-2`` larger, where k parameters follow n rows (generalised cross-validation; Golub, Heath and
        Wahba 1979): next to nothing, unless the motion repeats. Then what the model lacks repeats, too, and n is the
        number of rows in different states: if they are few, parameters follow all that the model lacks, and only what
        differs from one repeat to the next is left. In no case do fewer rows count than those.
        """
        distinct = self.summary.visited.distinct
        rows = self.independent * float(np.sum(self.counts[self.row_weights > 0.0]))  # that tell any
        if distinct == 1.0 or rows == 0.0:
            return 1.0
        left = 1.0 - self._followed / np.array([distinct * rows, rows])
        return max(float(left[0] / left[1]) ** 2, distinct) if left[0] > 0.0 else distinct

    @property
    def _followed(self) -> float:
        """How many parameters follow the rows rather than the prior."""
        products = self.products.weighed(self.first_noise**-2.0)[:-1, :-1]
        half = self.manifold.whiten(self.prior_point, self.independent * products) * self.prior_spreads
        information = self.manifold.whiten(self.prior_point, half.T) * self.prior_spreads
        values = np.maximum(np.linalg.eigvalsh(information), 0.0)
        return float(np.sum(values / (1.0 + values)))

    def place(self, parameters: FloatArray) -> Point:
        """The point of ``parameters (D,)``, those of the prior where they are left out: what is positive cannot be
        zero."""
        return self.manifold.point(np.where(parameters == 0.0, self.prior, parameters))

    @property
    def first_noise(self) -> FloatArray:
        """Where the search for the noise begins."""
        return self._with_given(self.least_sigmas)


def subproblem(whole: Problem, columns: IntArray) -> Problem:
    """The problem of these parameters alone, in which all other coefficients are zero."""
    first = whole.model.dimension - len(whole.model.coefficients)
    model = whole.model.with_coefficients([int(column) - first for column in columns if column >= first])
    return replace(
        whole,
        model=model,
        summary=whole.summary.with_columns(model.channels, columns),
        given=None if whole.given is None else whole.given[columns],
        known=replace(whole.known, rows=whole.known.rows[:, columns]),
    )
