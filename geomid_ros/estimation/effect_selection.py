"""Choose the effects of a fit: those that the rows support, in their best shape; and those that a file can hold.

A default effect may have one of several shapes, such as the speed over which dry friction changes its sign. It gets the
shape of the highest marginal likelihood. Then optional effects are added one by one while they improve the fit
visibly. This is done first with the rows of motion. Then the rows at rest and near reversals are added: they decide
anew on the shapes, and on the effects with memory of the past motion. Whether what was chosen is significant is asked
of the estimate (``estimator.py``), which knows how much each effect scatters between blocks of time: it must repeat.

The score test makes a shortlist of candidates, and the best of their trials is taken. They are tried with the inertias
as fitted, and with inertias that stay near the prior, because a link that has absorbed an effect hides it. A
coefficient that cannot be negative is fixed at zero instead. Shapes and candidates are tried to first order about the
present fit (``trials.py``); only what is taken is fitted.

A robot description can hold some effects but not others: a URDF has damping and friction, but no rotor inertia.
Dropping an effect from a fit that needs it makes the file worse than one without any effects. So each file has its own
minimum, over the inertias and the effects that it holds. The other effects are part of the noise, which is estimated
anew. Inertias stand in for a rotor that the file lacks; masses would, too, so they are known as they were estimated.
But inertias may also follow what is missing where only this recording has it, and predict other motion badly. So
the file keeps the estimate's links, unless others predict folds of time better that were left out of the fit. The block
weights of a coupled prior are those of the estimate. Errors of sensors stay in the fit: they move nothing, and a file
need not hold them, but without them a mass would absorb an offset. They are left out, as weights that they absorb would
be lost, unless they are significant both in the estimate and in the file's own fit. So is the offset of a spring that a
file lacks: it is no error of a sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.estimation.coefficient_fit import CoefficientFit, CoefficientRows
from geomid_ros.estimation.estimate import SIGNIFICANT_STDS
from geomid_ros.estimation.fit import Fit, with_fitted_effects
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.tolerances import SHORTLIST
from geomid_ros.estimation.trials import Trial, Trials
from geomid_ros.estimation.uncertainty import fold_at
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import Point
from geomid_ros.model.coefficients import Coefficient, Mechanism
from geomid_ros.model.effects import joints_of
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray, IntArray, frozen

_VISIBLE = 0.04
"""Least fraction of a channel's residual sum of squares that a visible effect explains."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Chosen parameters by their ``columns``. If there was a choice, also the end of their fit: all ``parameters
    (D,)``, zero for those left out, and the links' prior std ``prior_stds (links,)``."""

    columns: IntArray
    parameters: FloatArray | None = None
    prior_stds: FloatArray | None = None


def choose(problem: Problem, earlier: IntArray | None, add_prior: Callable[[Problem], Problem]) -> Choice:
    """Choose the parameters: all that are not optional, each in its best shape, and the significant optional ones.

    Args:
        problem: the problem with all coefficients.
        earlier: columns of an earlier choice, to start from; the non-optional ones unless given.
        add_prior: adds prior rows to the problem; called only if there is a choice.
    """
    rows = CoefficientRows(problem)
    if not rows.has_choice:
        return Choice(rows.required_columns)
    problem = add_prior(problem)
    rows = CoefficientRows(problem)
    moving = _grown(rows.fit(rows.required_columns if earlier is None else earlier))
    chosen = _grown(CoefficientRows(problem, at_rest=True).fit(moving.all_columns))
    return Choice(chosen.all_columns, chosen.parameters, chosen.fit.scales)


def _grown(fit: CoefficientFit) -> CoefficientFit:
    """Add the optional effects that the rows support, and remove those that are implausible."""
    rows = fit.rows
    fit = _plausible(_shaped(fit, range(len(rows.problem.model.robot.joints))))
    tried: set[Mechanism] = set()
    while trials := _trials_of_best(fit, rows.candidates(fit.all_columns, tried)):
        possible = {column: trial for column, trial in trials.items() if trial is not None}
        tried.update(rows.mechanism(column) for column in trials.keys() - possible.keys())
        if not possible:
            continue
        column, best = min(possible.items(), key=lambda one: one[1].score)
        tried.add(rows.mechanism(column))
        fit = min((rows.fit(best.all_columns, start) for start in _starts(fit)), key=lambda larger: larger.score)
        fit = _shaped(fit, joints_of(rows.coefficient(column).place))
    return _plausible(fit)


def _starts(fit: CoefficientFit) -> tuple[CoefficientFit, CoefficientFit]:
    """A fit with the links as fitted, and with links that stay near the prior."""
    return fit, fit.with_default_priors


def _shaped(fit: CoefficientFit, joints: Collection[int]) -> CoefficientFit:
    """Give every effect of ``joints`` its most likely shape, one joint after the other."""
    for joint in joints:
        fit, better = _reshaped(fit, joint), fit
        while better is not fit:
            fit, better = _reshaped(fit, joint), fit
    return fit.rows.fit(fit.all_columns, fit)


def _reshaped(fit: CoefficientFit, joint: int) -> CoefficientFit:
    """Fit with the shapes that trials of the effects of a joint find, if it is more likely; else the same."""
    trials = _trials(fit, {joint})
    if not len(np.setdiff1d(trials.columns, fit.all_columns)):
        return fit  # no effect has another shape
    shaped = _best_shapes(trials, fit.all_columns)
    if np.array_equal(shaped.all_columns, fit.all_columns):
        return fit
    return min(fit, fit.rows.fit(shaped.all_columns, fit, prior_stds=fit.fit.scales), key=lambda one: one.score)


def _trials(fit: CoefficientFit, joints: Collection[int], more: Sequence[int] = ()) -> Trials:
    """Trials of all shapes of the effects of ``joints`` that a fit has, and of ``more`` columns."""
    columns = list(more)
    for mechanism in fit.rows.mechanisms(fit.all_columns):
        if set(joints).intersection(joints_of(mechanism[1])):
            columns += fit.rows.shapes[mechanism]
    return Trials(fit, np.unique(np.array(columns, dtype=np.int64)))


def _best_shapes(trials: Trials, columns: IntArray) -> Trial:
    """Give the effects of the trials among ``columns`` their most likely shapes in which all effects are plausible, one
    after the other."""
    (best,) = trials.trials([columns])
    for mechanism in trials.rows.mechanisms(np.intersect1d(columns, trials.columns)):
        shapes = trials.rows.shapes[mechanism]
        if len(shapes) == 1:
            continue
        others = np.setdiff1d(best.all_columns, shapes)
        tried = trials.trials([np.append(others, shape) for shape in np.setdiff1d(shapes, best.all_columns)])
        better = (trial for trial in sorted(tried, key=lambda trial: trial.score) if trial.score < best.score)
        best = next((trial for trial in better if trial.is_plausible), best)
    return best


def _plausible(fit: CoefficientFit) -> CoefficientFit:
    """Remove the optional effects that are implausible."""
    while not np.all(fit.is_plausible):
        fit = fit.rows.fit(np.setdiff1d(fit.all_columns, fit.chosen_columns[~fit.is_plausible]), fit)
    return fit


def _trials_of_best(present: CoefficientFit, candidates: IntArray) -> dict[int, Trial | None]:
    """Try the candidate columns that the score test prefers, one of each mechanism, if they would be significant."""
    starts = _starts(present)
    gains = np.max([start.gains(candidates) for start in starts], axis=0)
    significant = candidates[np.argsort(-gains)][: np.count_nonzero(gains >= SIGNIFICANT_STDS**2)]
    preferred = dict[Mechanism, int]()
    for column in significant.tolist():
        preferred.setdefault(present.rows.mechanism(column), column)
    return {column: _trial(starts, column) for column in list(preferred.values())[:SHORTLIST]}


def _trial(starts: Sequence[CoefficientFit], column: int) -> Trial | None:
    """Return the best trial of a column in any shape, with what it needs instead of other shapes of that, from fits
    with the same columns; None if it is not plausible, or not visible from any of them."""
    rows = starts[0].rows
    added = [column, *rows.needed(column)]
    joints = joints_of(rows.coefficient(column).place)
    shapes = [shape for each in added for shape in rows.shapes[rows.mechanism(each)]]
    columns = np.union1d(np.setdiff1d(starts[0].all_columns, shapes), added)
    tried = [_best_shapes(_trials(start, joints, shapes), columns) for start in starts]
    best = min(tried, key=lambda trial: trial.score)
    return best if best.is_plausible and any(trial.leaves_less(_VISIBLE) for trial in tried) else None


def fit_files(
    model: MeasurementModel,
    estimate_columns: IntArray,
    files: Mapping[str, tuple[str, ...]],
    insignificant_errors: IntArray,
    choose: Callable[[IntArray, IntArray], IntArray],
    fitted: Callable[[IntArray, bool], FloatArray],
) -> dict[str, FloatArray]:
    """Fit the parameters ``(D,)`` within each of the ``files``; zero for effects that a file does not hold.

    Args:
        model: the model with all its coefficients.
        estimate_columns: columns of the parameters of the estimate.
        files: elements of a file, by its reader (:meth:`~geomid_ros.model.effects.ParameterForm.said_by`).
        insignificant_errors: columns of sensor errors that are not significant.
        choose: chooses effects among the columns that a file can hold, starting from those of the estimate among them:
            other effects may absorb one that the file lacks.
        fitted: fits the parameters ``(D,)`` of some columns; True if the file cannot hold what a mass may stand in for.
    """
    by_columns: dict[tuple[int, ...], FloatArray] = {}
    within = {}
    for reader, elements in files.items():
        lost = [c for c in _coefficients(model, estimate_columns) if not _is_held(c, elements)]
        left_out = np.union1d(insignificant_errors, _errors_in(lost, model))
        columns = choose(
            *(
                np.setdiff1d(held_columns(model, columns, elements), left_out)
                for columns in (np.arange(model.dimension), estimate_columns)
            )
        )
        lacks_like_mass = any(c.effect.confusable_with_payload for c in lost)
        if (key := (lacks_like_mass, *columns.tolist())) not in by_columns:  # different files may hold the same columns
            by_columns[key] = frozen(fitted(columns, lacks_like_mass))
        within[reader] = by_columns[key]
    return within


def _coefficients(model: MeasurementModel, columns: IntArray) -> list[Coefficient]:
    """Coefficients among ``columns`` of the parameters."""
    first = len(model.nominal_inertias)
    return [model.coefficients[column - first] for column in columns.tolist() if column >= first]


def _errors_in(lost: Sequence[Coefficient], model: MeasurementModel) -> IntArray:
    """Columns of errors of sensors that are part of effects which a file has ``lost``: a spring's offset."""
    parts = {(c.place, part) for c in lost for part in c.effect.parts if part.is_sensor_error}
    is_part = [(c.place, c.effect) in parts for c in model.coefficients]
    return len(model.nominal_inertias) + np.flatnonzero(is_part)


def file_fit(own: Fit, estimate: Fit) -> FloatArray:
    """Choose a file's parameters: its minimum, ``own``, or the ``estimate``'s links with the effects fitted to them.

    The links change only if that predicts folds of time, to which nothing was fitted, better by more than the standard
    error of the difference (one-standard-error rule; Breiman et al., "Classification and regression trees", 1984). The
    noise is that of the estimate.
    """
    links = own.problem.manifold.inertial
    held = replace(own, search_point=_with_links_of(estimate, own))
    moves = _steps(estimate, estimate.fold_products)[:, links]
    ends = _without_folds(held, own.fold_products, moves), _without_folds(own, own.fold_products)
    as_held, changed = (own.problem.summary.fold_squares(estimate.sigmas, vectors) for vectors in ends)
    gains = as_held - changed  # their mean exceeds its standard error if their sum exceeds their norm
    return (own.point if np.sum(gains) > np.linalg.norm(gains) else held.search_point).parameters


def _with_links_of(estimate: Fit, own: Fit) -> Point:
    """Point of the ``estimate``'s links, at which the effects minimise the objective of a fit."""
    links, manifold = own.problem.manifold.inertial, own.problem.manifold
    parameters = np.append(estimate.point.parameters[links], own.point.parameters[links.stop :])
    return with_fitted_effects(own.objective, manifold.point(parameters))


def _without_folds(fit: Fit, products: FloatArray, first: FloatArray | None = None) -> FloatArray:
    """Parameters without each fold, and minus one ``(folds, D + 1)``, see :func:`_steps`."""
    blocks, diagonal = fit.problem.manifold.jacobian(fit.search_point)
    steps = _steps(fit, products, first)
    moved = fit.problem.manifold.by_blocks(steps, np.swapaxes(blocks, -1, -2), diagonal)
    return np.column_stack([fit.search_point.parameters + moved, np.full(len(moved), -1.0)])


def _steps(fit: Fit, products: FloatArray, first: FloatArray | None = None) -> FloatArray:
    """Newton steps ``(folds, D)``, tangent coordinates, from a minimum to that without each fold, for the folds'
    ``products (folds, D + 1, D + 1)``; the ``first (folds, n)`` coordinates of the steps may be given."""
    first, steps = np.zeros((len(products), 0)) if first is None else first, []
    given, rest = slice(first.shape[1]), slice(first.shape[1], None)
    for fold_products, known in zip(products, first, strict=True):  # one by one, to save memory
        fold = fold_at(fit.problem.manifold, fit.search_point, fold_products)
        others = fit.information / fit.problem.independent_fraction - fold.information
        slopes = fold.gradient[rest] - others[rest, given] @ known
        steps.append(np.append(known, spd.solve_or_least_squares(others[rest, rest], slopes)))
    return np.array(steps)


def held_columns(model: MeasurementModel, columns: IntArray, elements: Collection[str]) -> IntArray:
    """Columns among ``columns`` that a file with these ``elements`` holds, with errors of sensors; effects in the shape
    of a description, because no file can hold another."""
    held = {model.described_shapes[c.mechanism] for c in _coefficients(model, columns) if _is_held(c, elements)}
    return np.append(columns[columns < len(model.nominal_inertias)], sorted(held)).astype(np.int64)


def _is_held(coefficient: Coefficient, elements: Collection[str]) -> bool:
    effect = coefficient.effect
    return effect.is_sensor_error or effect.column_parameters[coefficient.index].said_by(elements)
