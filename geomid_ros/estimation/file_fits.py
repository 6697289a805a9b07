"""Fits of the parameters with only the effects that a file can hold.

A robot description can hold some effects but not others: a URDF has damping and friction, but no rotor inertia.
Dropping an effect from a fit that needs it makes the file worse than one without any effects. So each file has its own
minimum, over the inertias and the effects that it holds. The other effects are part of the noise, which is estimated
anew. The block weights of a coupled prior are those of the estimate. Errors of sensors stay in the fit: they move
nothing, and a file need not hold them, but without them a mass would absorb an offset. Those that are not significant
are left out: weights that they absorb would be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np

from geomid_ros.estimation.fit import Fit
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray, IntArray, frozen


def fit_files(
    model: MeasurementModel,
    estimate_columns: IntArray,
    files: Mapping[str, tuple[str, ...]],
    insignificant_errors: IntArray,
    choose: Callable[[IntArray, IntArray], IntArray],
    fitted: Callable[[IntArray], Fit],
) -> dict[str, FloatArray]:
    """Fit the parameters ``(D,)`` within each of the ``files``; zero for effects that a file does not hold.

    Args:
        model: the model with all its coefficients.
        estimate_columns: columns of the parameters of the estimate.
        files: elements of a file, by its reader (:meth:`~geomid_ros.model.effects.ParameterForm.said_by`).
        insignificant_errors: columns of sensor errors that are not significant.
        choose: chooses effects among the columns that a file can hold, starting from those of the estimate among them:
            other effects may absorb one that the file lacks.
        fitted: fits the parameters of some columns.
    """
    by_columns: dict[tuple[int, ...], FloatArray] = {}
    within = {}
    for reader, elements in files.items():
        held = np.setdiff1d(held_columns(model, np.arange(model.dimension), elements), insignificant_errors)
        columns = choose(held, np.setdiff1d(held_columns(model, estimate_columns, elements), insignificant_errors))
        if (key := tuple(columns.tolist())) not in by_columns:  # different files may hold the same columns
            parameters = np.zeros(model.dimension)
            parameters[columns] = fitted(columns).point.parameters
            by_columns[key] = frozen(parameters)
        within[reader] = by_columns[key]
    return within


def held_columns(model: MeasurementModel, columns: IntArray, elements: Collection[str]) -> IntArray:
    """Columns among ``columns`` that a file with these ``elements`` holds, with errors of sensors; effects in their
    default shape, because no file can hold another."""
    first = len(model.nominal_inertias)
    coefficients = [model.coefficients[column - first] for column in columns.tolist() if column >= first]
    held = {model.usual_shapes[c.mechanism] for c in coefficients if _is_held(c, elements)}
    return np.array([*columns[columns < first].tolist(), *sorted(held)], dtype=np.int64)


def _is_held(coefficient: Coefficient, elements: Collection[str]) -> bool:
    effect = coefficient.effect
    return effect.is_sensor_error or effect.column_parameters[coefficient.index].said_by(elements)
