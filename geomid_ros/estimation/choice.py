"""Which effects beside the default ones the rows ask for: forward selection by evidence and by held-out blocks of time.

A candidate is tried that the score test promises most of: once beside the inertias as they were fitted, and once beside
inertias that stay near the prior, because a link that has swallowed an effect hides it. It is taken if the marginal
likelihood rises by more than :data:`LEAST_GAIN` after a penalty of ``log N`` (Schwarz 1978), and if on blocks that were
held out the error falls visibly, and by more than one standard error over the blocks (Breiman et al., "Classification
and regression trees", 1984, section 3.4.3). The search is linear in all coefficients; those that cannot be negative are
not taken where they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.estimation.fit import CERTAINTY, driven_rows
from geomid_ros.estimation.objective import Evaluation
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.profile_objective import Profile, ProfileObjective, StraightManifold, minimum
from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import Point
from geomid_ros.model.effects import Place
from geomid_ros.types import FloatArray, IntArray

LEAST_GAIN = 12.0
"""An effect that improves the score by less is not taken: e^-6 in probability."""
_VISIBLE = 0.02  # of the standard deviation of a channel, at least
_ERRORS = 1.0  # standard errors over the blocks
_PROMISING = 0.5 * LEAST_GAIN
_PARALLEL = 1e-6  # a column that is so nearly a combination of others says nothing
_LOOSE = 1.5  # times the usual spread: a link beyond it has left its prior
_FREE = 1e-6  # weight of a coefficient's prior
_ROUNDS, _SETTLED = 8, 0.03
_LEAST_SHARE = 1e-10  # of the target's sum of squares: no residual is smaller


def choose(problem: Problem, earlier: IntArray | None = None) -> IntArray:
    """The parameters without optional coefficients but for those that the rows ask for, by their columns.

    Args:
        problem: with all coefficients.
        earlier: what was chosen for fewer of the same rows: where they ask for all of it still, more is looked for
            beside it, which takes a fraction of the time.
    """
    rows = _Rows(problem)
    every = range(problem.model.dimension)
    optional = [column for column in every if column >= rows.first and rows.optional(column)]
    base = np.setdiff1d(every, optional)
    if not optional or not rows.enough:
        return base
    chosen = rows.fit(base if earlier is None else earlier)
    if not chosen.asked_for:
        chosen = rows.fit(base)
    settled = set(map(rows.mechanism, np.setdiff1d(chosen.columns, base)))  # what was taken or refused
    while left := [column for column in optional if rows.mechanism(column) not in settled]:
        larger, column = _best(chosen, np.array(left))
        if larger is None:
            break
        if _asked_for(chosen, larger):
            chosen = larger
        settled.add(rows.mechanism(column))
    return chosen.columns


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
        """Whether some channel has more independent rows than unknowns: fewer ask for nothing."""
        columns = [len(channel.columns) for channel in self.problem.model.channels]
        return bool(np.any(self.counts > columns))

    def optional(self, column: int) -> bool:
        """Whether a coefficient may be left out."""
        return self.problem.model.coefficients[column - self.first].optional

    def positive(self, column: int) -> bool:
        """Whether a coefficient cannot be negative."""
        return self.problem.model.coefficients[column - self.first].positive

    def allows(self, column: int, value: float) -> bool:
        """Whether a coefficient can have this value."""
        coefficient = self.problem.model.coefficients[column - self.first]
        form = coefficient.effect.own[coefficient.index]
        return form.above < value < form.below and (value > 0.0 or not coefficient.positive)

    def mechanism(self, column: int) -> tuple[str, Place]:
        """What there is once at a place, whatever constants it has."""
        coefficient = self.problem.model.coefficients[column - self.first]
        return coefficient.effect.name, coefficient.place

    @cached_property
    def products(self) -> list[tuple[IntArray, FloatArray]]:
        """Of each channel: which columns it has, the last of which is the target, and of each fold these by each other,
        ``(folds, n, n)``; only the share of them that is independent counts."""
        channels, independent = self.problem.model.channels, self.problem.independent
        return [
            (np.append(channel.columns, self.size), independent * np.array([p.factor.T @ p.factor for p in parts]))
            for channel, parts in zip(channels, self.problem.summary.parts(), strict=False)
        ]

    @cached_property
    def all_products(self) -> FloatArray:
        """Of each channel: all columns and the target by each other, of all folds, ``(channels, D + 1, D + 1)``."""
        whole = np.zeros((len(self.products), self.size + 1, self.size + 1))
        for own, (places, products) in zip(whole, self.products, strict=True):
            own[places[:, None], places] = np.sum(products, axis=0)
        return whole

    @cached_property
    def counts(self) -> FloatArray:
        """Independent rows of each channel."""
        return self.problem.independent * self.problem.counts[: len(self.problem.model.channels)]

    @cached_property
    def scales(self) -> FloatArray:
        """Of each coefficient: the one with which its column is as large as a channel that it reaches."""
        squares = np.diagonal(self.all_products, axis1=1, axis2=2)
        own, target = squares[:, self.first : -1], squares[:, -1:]
        size = np.where(own > 0.0, target / np.where(own > 0.0, own, 1.0), np.inf)
        best = np.sqrt(np.min(size, axis=0, initial=np.inf))
        return np.where(np.isfinite(best) & (best > 0.0), best, 1.0)

    def fit(self, columns: IntArray, start: _Fit | None = None, *, firm: bool = False) -> _Fit:
        """Fit these parameters, from an earlier fit where one is given; ``firm``: all links keep the usual spread."""
        found = self._fit(columns, start, np.zeros((0, len(columns))), firm=firm)
        every = np.zeros(self.size)
        every[columns] = found.point.parameters
        rows = driven_rows(self.problem.model, every)[:, columns]
        return self._fit(columns, found, rows, firm=firm) if len(rows) else found

    def _fit(self, columns: IntArray, start: _Fit | None, held: FloatArray, *, firm: bool) -> _Fit:
        """The same, with rows ``(r, columns)`` that are zero."""
        scales = self.scales[columns[columns >= self.first] - self.first]
        manifold = StraightManifold(self.first // 10, 0, scales)
        inertias = self.problem.prior[: self.first]
        prior = manifold.point(np.concatenate([inertias, np.zeros(len(scales))]))
        spreads = self.problem.usual
        point = prior
        if start is not None:
            before = np.zeros(self.size)
            before[start.columns] = start.point.parameters
            point, spreads = manifold.point(before[columns]), start.spreads
        own = np.append(columns, self.size)
        # In the order of its axes, in which such an index leaves nothing: else it is multiplied five times as slowly.
        products = np.ascontiguousarray(self.all_products[:, own[:, None], own])
        least = _LEAST_SHARE * products[:, -1, -1] + np.finfo(float).tiny
        weighed = self.problem.known
        known = np.concatenate([weighed.rows[:, columns], held])
        off = known @ prior.parameters - np.append(weighed.targets, np.zeros(len(held)))
        known_rows = np.column_stack([known, off])
        profile = Profile(manifold, products, self.counts, least, prior)

        def objective(spreads: FloatArray) -> ProfileObjective:
            weights = np.full(manifold.dimension, _FREE)
            weights[manifold.inertial] = np.repeat(spreads, 10) ** -2.0
            return ProfileObjective(profile, weights, known_rows)

        for _ in range(_ROUNDS):
            trusted = objective(spreads)
            solution = minimum(trusted, point)
            point = solution.point
            if firm:
                break
            earlier = spreads
            hessian = solution.evaluation.information + np.diag(trusted.weights)
            unsure = np.diag(definite.inverse(hessian))[manifold.inertial]
            errors = np.sum((manifold.log(prior, point)[manifold.inertial] ** 2 + unsure).reshape(-1, 10), axis=1)
            spreads = np.sqrt((errors + CERTAINTY * self.problem.usual**2) / (10.0 + CERTAINTY))
            if np.all(np.abs(np.log(spreads / earlier)) < _SETTLED):
                break
        return _Fit(self, columns, point, objective(spreads), spreads)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Where a fit of the ``columns`` of ``rows`` ended: at a ``point``, with the links' ``spreads``."""

    rows: _Rows
    columns: IntArray
    point: Point
    objective: ProfileObjective
    spreads: FloatArray

    @cached_property
    def firm(self) -> _Fit:
        """The fit of the same parameters with links that keep the usual spread; this one, if they do here."""
        loose = bool(np.any(self.spreads > _LOOSE * self.rows.problem.usual))
        return self.rows.fit(self.columns, firm=True) if loose else self

    @cached_property
    def evaluation(self) -> Evaluation:
        """The objective there."""
        return self.objective.evaluate(self.point)

    @cached_property
    def hessian(self) -> FloatArray:
        """Information ``(D, D)`` of the rows and of the prior, in tangent coordinates."""
        return self.evaluation.information + np.diag(self.objective.weights)

    @cached_property
    def score(self) -> float:
        """Minus twice the logarithm of the marginal likelihood, with a penalty for each coefficient."""
        links = self.objective.manifold.inertial
        _, volume = np.linalg.slogdet(self.hessian[links, links])
        relative = self.spreads / self.rows.problem.usual
        width = 20.0 * float(np.sum(np.log(self.spreads)))
        width += CERTAINTY * float(np.sum(relative**-2 + 2.0 * np.log(relative)))
        return 2.0 * self.evaluation.value + float(volume) + width + len(self.columns) * self._penalty

    @property
    def _penalty(self) -> float:
        """Of each coefficient."""
        return float(np.log(max(np.max(self.rows.counts), 1.0)))

    @cached_property
    def weights(self) -> FloatArray:
        """Inverse variances of the channels."""
        return self.rows.counts / self.objective.profile.squares(self.point)

    @property
    def possible(self) -> bool:
        """Whether all optional coefficients are in their ranges."""
        return all(self.rows.allows(self.columns[place], self.point.parameters[place]) for place in self._optional)

    @property
    def _optional(self) -> list[int]:
        """The places of the optional coefficients among the parameters."""
        rows = self.rows
        return [place for place, column in enumerate(self.columns) if column >= rows.first and rows.optional(column)]

    @property
    def asked_for(self) -> bool:
        """Whether each optional coefficient improves the score by as much as one that is taken, by Wald's test."""
        places = self._optional
        values = self.objective.manifold.log(self.objective.profile.prior, self.point)[places]
        gains = values**2 / np.diag(definite.inverse(self.hessian))[places] - self._penalty
        return bool(np.all(gains >= LEAST_GAIN)) and self.possible

    def gains(self, columns: IntArray) -> FloatArray:
        """By how much each of other ``columns`` would improve the likelihood, by the score test; 0 for a coefficient
        that would have a sign that it cannot have."""
        products = np.tensordot(self.weights, self.rows.all_products, axes=1)
        slopes = products[np.ix_(columns, np.append(self.columns, self.rows.size))] @ np.append(
            self.point.parameters, -1.0
        )
        shared = self.objective.manifold.whiten(self.point, products[np.ix_(columns, self.columns)])
        squares = np.diag(products)[columns]
        left = squares - np.sum((shared @ definite.inverse(self.hessian)) * shared, axis=1)
        positive = np.array([self.rows.positive(column) for column in columns])
        telling = (left > _PARALLEL * squares) & ~(positive & (slopes > 0.0))
        return np.where(telling, slopes**2 / np.where(telling, left, 1.0), 0.0)

    @cached_property
    def held_out(self) -> FloatArray:
        """Sums of squares of each fold's channels at the fit to the other folds ``(folds, channels)``, by one Newton
        step from the fit to all."""
        rows, manifold, folds = self.rows, self.objective.manifold, self.rows.problem.summary.folds
        totals = np.zeros((folds, rows.size + 1, rows.size + 1))
        for weight, (places, products) in zip(self.weights, rows.products, strict=True):
            totals[:, places[:, None], places] += weight * products
        own = np.append(self.columns, rows.size)
        parameters = np.append(self.point.parameters, -1.0)
        whitener = manifold.whiten(self.point, np.eye(len(self.columns)))
        moved = np.zeros((folds, rows.size + 1))
        for fold, total in enumerate(totals[:, own[:, None], own]):
            slope = whitener.T @ (total[:-1] @ parameters)
            information = manifold.whiten(self.point, manifold.whiten(self.point, total[:-1, :-1]).T)
            step = whitener @ np.linalg.solve(self.hessian - information, slope)
            moved[fold, own] = parameters + np.append(step, 0.0)
        squares = [
            np.einsum("fi,fij,fj->f", moved[:, places], products, moved[:, places], optimize=True)
            for places, products in rows.products
        ]
        return np.stack(squares, axis=1)


def _best(chosen: _Fit, left: IntArray) -> tuple[_Fit | None, int]:
    """The best of those with one column more that promise most; None if none promises enough."""
    trials: dict[int, _Fit] = {}
    for fitted in dict.fromkeys((chosen, chosen.firm)):
        gains = fitted.gains(left)
        column = int(left[np.argmax(gains)])
        if np.max(gains) > _PROMISING and column not in trials:
            columns = np.sort(np.append(chosen.columns, column))
            fits = [chosen.rows.fit(columns, start) for start in dict.fromkeys((chosen, chosen.firm))]
            trials[column] = min(fits, key=lambda fit: fit.score)
    best = min(trials, key=lambda column: trials[column].score, default=-1)
    return trials.get(best), best


def _asked_for(chosen: _Fit, larger: _Fit) -> bool:
    """Whether the rows ask for what a fit has beyond another.

    A link that has swallowed an effect predicts other blocks of the same motion as well as the effect does. Then the
    effect must do so beside inertias that stay near the prior, and no worse beside the others.
    """
    if chosen.score - larger.score < LEAST_GAIN or not larger.possible:
        return False
    mean, error = _change(chosen, larger)
    if mean < -error:
        return True
    firm_mean, firm_error = _change(chosen.firm, larger.firm)
    return mean < error and firm_mean < -firm_error


def _change(before: _Fit, after: _Fit) -> tuple[float, float]:
    """By how much the held-out errors of a block change, relative to those of all blocks, and the standard error of
    that; infinite where the change is too small to be seen."""
    total = np.sum(before.held_out, axis=0)
    reached = total > 0.0
    changes = np.sum((after.held_out - before.held_out)[:, reached] / total[reached], axis=1)
    changes = changes[np.sum(before.held_out, axis=1) > 0.0]
    if len(changes) < 2 or abs(np.sum(changes)) < 2.0 * _VISIBLE:
        return 0.0, np.inf
    return float(np.mean(changes)), _ERRORS * float(np.std(changes, ddof=1)) / np.sqrt(len(changes))
