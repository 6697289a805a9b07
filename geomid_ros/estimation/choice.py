"""Which effects beside the default ones the rows ask for, and which shape the default ones have.

An effect that stands at a place in one of several shapes (the speed over which dry friction changes its sign) has the
shape of the highest marginal likelihood. Then optional effects are added one by one while they improve the fit visibly,
and those go again that are not believed: first by the rows of motion; then, beside these, by the rows at rest and near
reversals, too, which judge the shapes anew, and those effects that remember the motion before. What decides is the
squared size of an effect in units of its standard deviation, as blocks of time show it: what they say of it, each by
itself, scatters far more than independent residuals would (jackknife; Liang and Zeger, "Longitudinal data analysis
using generalized linear models", 1986). So an effect is believed that repeats.

A candidate is tried beside the inertias as they were fitted, and beside inertias that stay near the prior, because a
link that has swallowed an effect hides it. No effect is negative that cannot be.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.coefficient_fit import CoefficientFit, CoefficientRows
from geomid_ros.estimation.estimate import TOLD
from geomid_ros.estimation.problem import Problem
from geomid_ros.model.coefficients import Mechanism
from geomid_ros.model.effects import joints_of
from geomid_ros.types import FloatArray, IntArray

_VISIBLE = 0.04
"""Share of a channel's remaining squares that an effect explains at least."""


@dataclass(frozen=True, eq=False)
class Choice:
    """The ``columns`` of the parameters that the rows ask for, and where their fit ended, if there was a choice: all
    ``parameters (D,)``, zero where they are left out, and the links' ``spreads (links,)``."""

    columns: IntArray
    parameters: FloatArray | None = None
    spreads: FloatArray | None = None


def choose(
    problem: Problem, earlier: IntArray | None = None, beside: Callable[[Problem], Problem] = lambda alone: alone
) -> Choice:
    """The parameters that the rows ask for: all that are not optional, each in its best shape, and the optional ones
    that are believed.

    Args:
        problem: with all coefficients.
        earlier: what was chosen for fewer of the same rows, to go on from.
        beside: the problem with what is known beside it; found only where there is a choice.
    """
    rows = CoefficientRows(problem)
    if not (rows.has_choice and rows.enough):
        return Choice(rows.standing)
    problem = beside(problem)
    rows = CoefficientRows(problem)
    moving = _grown(rows.fit(rows.standing if earlier is None else earlier))
    chosen = _grown(CoefficientRows(problem, at_rest=True).fit(moving.every))
    return Choice(chosen.every, chosen.parameters, chosen.fit.scales)


def _grown(chosen: CoefficientFit) -> CoefficientFit:
    """The fit with the optional effects that its rows ask for, and without those that they do not."""
    rows = chosen.rows
    chosen = _without_unbelieved(_shaped(chosen, range(len(rows.problem.model.robot.joints))))
    refused: set[Mechanism] = set()
    while len(left := rows.candidates(chosen.every, refused)):
        column, larger = _best(chosen, left)
        if larger is None:
            break
        refused.add(rows.mechanism(column))
        if np.all(larger.possible) and larger.leaves_less(chosen, _VISIBLE):
            chosen = _shaped(larger, joints_of(rows.coefficient(column).place))
    return _without_unbelieved(chosen)


def _shaped(fit: CoefficientFit, joints: Collection[int]) -> CoefficientFit:
    """The fit in which every effect of ``joints`` that is not optional has the shape of the highest likelihood, one
    after the other."""
    rows = fit.rows
    for mechanism in rows.always:
        if not set(joints).intersection(joints_of(mechanism[1])):
            continue
        fit = _best_shape(fit, rows.shapes[mechanism])
    return rows.fit(fit.every, fit)


def _best_shape(fit: CoefficientFit, shapes: Sequence[int]) -> CoefficientFit:
    """The fit in which the one effect of the columns ``shapes``, in the order of its constant, has the most likely one:
    to either side of the one that it has, as far as each is more likely than the one before."""
    own = next(place for place, shape in enumerate(shapes) if shape in fit.every)
    best = fit
    for side in (range(own + 1, len(shapes)), range(own - 1, -1, -1)):
        before = fit
        for place in side:
            columns = np.sort(np.append(np.setdiff1d(fit.every, shapes), shapes[place]))
            shaped = fit.rows.fit(columns, before, spreads=fit.fit.scales)
            if shaped.score >= before.score:
                break
            before = shaped
        best = min(best, before, key=lambda found: found.score)
    return best


def _without_unbelieved(fit: CoefficientFit) -> CoefficientFit:
    """The fit without the optional effects that are not believed, the least one first."""
    while len(fit.chosen):
        squares = fit.possible * np.max([each.squares_of(fit.chosen) for each in (fit, fit.firm)], axis=0)
        if np.min(squares) > TOLD**2:
            break
        fit = fit.rows.fit(np.setdiff1d(fit.every, fit.chosen[np.argmin(squares)]), fit)
    return fit


def _best(chosen: CoefficientFit, left: IntArray) -> tuple[int, CoefficientFit | None]:
    """The column that improves a fit most, and the fit with it; None if none improves it visibly."""
    starts = (chosen, chosen.firm)
    gains = np.max([start.gains(left) for start in starts], axis=0)
    column = int(left[np.argmax(gains)])
    if np.max(gains) < max(_VISIBLE * float(np.max(chosen.rows.counts[chosen.rows.fast])), TOLD**2):
        return column, None
    columns = np.sort(np.append(chosen.every, column))
    return column, min((chosen.rows.fit(columns, start) for start in starts), key=lambda fit: fit.score)
