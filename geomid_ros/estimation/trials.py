"""Trials of coefficients at the minimum of a fit: a few change, and all other parameters respond linearly.

At a minimum of half the objective, with the noise of the channels fixed, let H be the Hessian in tangent coordinates.
If the coefficients ``u`` of a trial have given values, the other parameters ``z`` move by ``-H_zz^-1 H_zu du``. So all
residuals are linear in u, and the objective is a quadratic function of u. In the channels that depend on u the noise is
estimated anew, as in a fit. A trial is thus a problem of a few unknowns. As z is at its minimum, the error of its
response, and that of the noise of the other channels, changes the objective in second order only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.estimation.coefficient_fit import CoefficientFit, CoefficientRows
from geomid_ros.estimation.tolerances import LEAST_DECREASE, ROUNDING, ROUNDS
from geomid_ros.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Trial:
    """Minimum at which only some of the coefficients of ``trials`` have ``values (k,)``, zero for the others.

    ``all_columns``: all columns of the fit that this trial stands for, including coefficients that are zero because
    they would be negative. ``score``: as that of a fit.
    """

    trials: Trials
    all_columns: IntArray
    values: FloatArray
    score: float

    @property
    def is_plausible(self) -> bool:
        """True if every optional effect is plausible."""
        return bool(np.all(self.trials.rows.are_plausible(self.all_columns, self._state[:-1])))

    def leaves_less(self, share: float) -> bool:
        """True if it reduces the residual of a group of the fit in which effects must be visible by this fraction."""
        rows = self.trials.rows
        visible, remaining = rows.visible(self.trials.channels), rows.products.squares(self._state)
        return bool(np.any(remaining[visible] < (1.0 - share) * self.trials.fit.residual_squares[visible]))

    @property
    def _state(self) -> FloatArray:
        """All parameters and minus one ``(D + 1,)``."""
        return np.asarray(self.trials.states @ np.append(1.0, self.values))


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials of the coefficients ``columns (k,)``, which a ``fit`` may have or not."""

    fit: CoefficientFit
    columns: IntArray

    @property
    def rows(self) -> CoefficientRows:
        """Rows of the fit."""
        return self.fit.rows

    @cached_property
    def present(self) -> FloatArray:
        """Values ``(k,)`` of the coefficients in the fit."""
        return self.fit.parameters[self.columns]

    @cached_property
    def channels(self) -> IntArray:
        """Groups of rows that depend on the coefficients ``(n,)``."""
        return self.rows.products.having(self.columns)

    @cached_property
    def _new(self) -> FloatArray:
        """Products ``(m, D + 1)`` of the columns that the fit does not have with all columns, weighted by the noise."""
        return self.rows.products.some(np.setdiff1d(self.columns, self.fit.columns), self.fit.weights)

    @cached_property
    def _responses(self) -> tuple[FloatArray, FloatArray]:
        """Tangent coordinates of the fitted parameters ``(fitted, k)`` per unit of each coefficient, and the quadratic
        form of half the objective ``(k + 1, k + 1)`` of one and the coefficients, at the noise of the fit."""
        fit, manifold, prior = self.fit.fit, self.fit.fit.objective.manifold, self.fit.fit.objective.profile.prior
        is_new = ~np.isin(self.columns, self.fit.columns)
        places, new = np.searchsorted(self.fit.columns, self.columns[~is_new]), self.columns[is_new]
        known = self.rows.known_products[new]
        shared = manifold.whiten(fit.point, self._new[:, self.fit.columns])
        shared += manifold.whiten_offset_rows(prior, fit.point, known[:, self.fit.columns])
        inverse, responses = self.fit.inverse, np.zeros((len(self.fit.columns), len(self.columns)))
        responses[:, is_new] = -inverse @ shared.T
        given = np.zeros((len(places), len(self.columns)))
        given[:, ~is_new] = np.diag(1.0 / manifold.jacobian(fit.point)[1][places - manifold.inertial.stop])
        pulls = np.linalg.solve(inverse[places[:, None], places], given - responses[places])
        responses += inverse[:, places] @ pulls
        quadratic = responses.T @ fit.hessian @ responses
        crossed = responses.T @ shared.T
        quadratic[:, is_new] += crossed
        quadratic[is_new] += crossed.T
        scales = self.rows.problem.scales[new - self.rows.first_column]
        quadratic[np.ix_(is_new, is_new)] += self._new[:, new] + known[:, new] + np.diag(ROUNDING * scales**-2.0)
        slope = responses.T @ fit.evaluation.gradient
        slope[is_new] += self._new @ self.fit.vector + known[:, -1]
        slope[is_new] += known[:, self.fit.columns] @ manifold.offset(prior, fit.point)
        form = np.empty((len(slope) + 1, len(slope) + 1))
        form[1:, 1:] = quadratic
        form[0, 1:] = form[1:, 0] = slope - quadratic @ self.present
        form[0, 0] = self.present @ (quadratic @ self.present - 2.0 * slope)
        return responses, form

    @cached_property
    def states(self) -> FloatArray:
        """All parameters and minus one ``(D + 1, k + 1)``, as linear functions of one and the coefficients."""
        manifold, point = self.fit.fit.objective.manifold, self.fit.fit.point
        blocks, diagonal = manifold.jacobian(point)
        states = np.zeros((self.rows.size + 1, len(self.columns) + 1))
        moved = manifold.by_blocks(self._responses[0].T, np.swapaxes(blocks, -1, -2), diagonal)
        states[self.fit.columns, 1:] = moved.T
        states[self.columns, 1:] = np.eye(len(self.columns))
        states[:, 0] = self.fit.vector - states[:, 1:] @ self.present
        return states

    @cached_property
    def _squares(self) -> FloatArray:
        """Quadratic forms ``(n, k + 1, k + 1)`` of the residual squares of :attr:`channels`."""
        size = len(self.columns) + 1
        squares = [self.rows.products.combined(channel, self.states) for channel in self.channels.tolist()]
        return np.array(squares).reshape(-1, size, size)

    @cached_property
    def _others(self) -> FloatArray:
        """Quadratic form of half the objective without :attr:`channels`."""
        weights = self.fit.weights[self.channels]
        return np.asarray(self._responses[1] - np.einsum("c,cij->ij", weights, self._squares))

    def trials(self, choices: Sequence[IntArray]) -> list[Trial]:
        """Return the minimum for each choice of columns among the coefficients. Those that would be negative and cannot
        be are zero."""
        present = np.setdiff1d(self.fit.all_columns, self.columns)
        active = np.array([np.isin(self.columns, columns) for columns in choices]).reshape(-1, len(self.columns))
        while True:
            values, scores = self._minima(active)
            negative = (values < 0.0) & self.rows.positive[self.columns]
            if not np.any(negative):
                break
            active &= ~negative
        ends = zip(choices, values, scores.tolist(), strict=True)
        return [Trial(self, np.union1d(present, columns), values, score) for columns, values, score in ends]

    def _minima(self, active: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Values ``(n, k)`` at the minima with the ``active (n, k)`` coefficients, and their scores ``(n,)``, by
        reweighting the channels."""
        weights, before = self.fit.weights[self.channels], np.full(len(active), np.inf)
        used, size = active[:, :, None] & active[:, None, :], len(self.columns)
        for _ in range(ROUNDS):
            forms = self._others + np.tensordot(weights, self._squares, 1)
            inner = np.where(used, forms[..., 1:, 1:], np.eye(size))
            scales = np.diagonal(inner, axis1=1, axis2=2) ** -0.5
            inner = scales[:, :, None] * inner * scales[:, None, :] + ROUNDING * np.eye(size)
            slopes = np.where(active, -scales * forms[..., 1:, 0], 0.0)
            values = scales * np.linalg.solve(inner, slopes[:, :, None])[:, :, 0]
            scores, weights = self._scores(values)
            if not np.any(scores < before - LEAST_DECREASE):
                break
            before = scores
        return values, scores

    def _scores(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scores ``(n,)`` for values ``(n, k)`` of the coefficients, and inverse noise variances ``(n, channels)``."""
        states = np.column_stack([np.ones(len(values)), values])
        outer = (states[:, :, None] * states[:, None, :]).reshape(len(states), -1)
        squares = outer @ self._squares.reshape(len(self.channels), outer.shape[1]).T
        noise = np.maximum(squares, self.fit.fit.objective.profile.least[self.channels])
        changes, counts = np.log(noise / self.fit.residual_squares[self.channels]), self.rows.counts[self.channels]
        scores = self.fit.score + outer @ self._others.ravel() + (squares / noise + changes) @ counts
        return scores, counts / noise
