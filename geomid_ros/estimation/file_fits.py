"""The parameters fitted anew within what a file can hold.

A robot description holds some effects and lacks others: a URDF says damping and friction, no rotor inertia. To drop
what it lacks from a sum that needs it makes the file worse than one without any effects. So each file has a minimum of
its own, over the inertias and the effects that it holds. What it lacks is part of the noise, which is estimated anew.
Which parts of the robot are unlike those that they should be like the estimate says. Errors of sensors stay in the fit.
They move nothing, and a file does not have to hold them; without them a mass would stand in for an offset. Those that
may as well be nothing go: the weights that they stand in for would be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np

from geomid_ros.estimation.fit import Fit
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray, IntArray, frozen


def fit_files(
    model: MeasurementModel,
    chosen: IntArray,
    files: Mapping[str, tuple[str, ...]],
    untold: IntArray,
    choose: Callable[[IntArray, IntArray], IntArray],
    fitted: Callable[[IntArray], Fit],
) -> dict[str, FloatArray]:
    """Parameters ``(D,)`` of the minimum within each of the ``files``; zero where a file holds nothing.

    Args:
        model: with all its coefficients.
        chosen: the parameters that the estimate has, by their columns.
        files: by who reads it, a file's elements (:meth:`~geomid_ros.model.effects.ParameterForm.said_by`).
        untold: errors of sensors that may as well be nothing, by their columns.
        choose: of the columns that a file can hold those that the rows ask for, from those among them that are chosen
            on: what stands in for an effect that a file lacks is another one.
        fitted: the fit of the parameters of some columns.
    """
    found: dict[tuple[int, ...], FloatArray] = {}
    within = {}
    for reader, elements in files.items():
        held = np.setdiff1d(held_columns(model, np.arange(model.dimension), elements), untold)
        columns = choose(held, np.setdiff1d(held_columns(model, chosen, elements), untold))
        if (key := tuple(columns.tolist())) not in found:  # files that differ may be asked to hold the same
            parameters = np.zeros(model.dimension)
            parameters[columns] = fitted(columns).point.parameters
            found[key] = frozen(parameters)
        within[reader] = found[key]
    return within


def held_columns(model: MeasurementModel, columns: IntArray, elements: Collection[str]) -> IntArray:
    """Those of some parameters that a file with these ``elements`` holds, and errors of sensors, by their columns; of
    effects in their usual shape, as no file says another."""
    first = len(model.nominal_inertias)
    own = [model.coefficients[column - first] for column in columns.tolist() if column >= first]
    held = {model.usual_shapes[c.mechanism] for c in own if _is_held(c, elements)}
    return np.array([*columns[columns < first].tolist(), *sorted(held)], dtype=np.int64)


def _is_held(coefficient: Coefficient, elements: Collection[str]) -> bool:
    effect = coefficient.effect
    return effect.of_sensor or effect.own[coefficient.index].said_by(elements)
