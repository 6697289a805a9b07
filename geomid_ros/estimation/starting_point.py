"""What is known before the solve: the prior point, the scales of real coefficients, and first standard deviations."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from geomid_ros.estimation.summary import RowSummary
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

# A positive coefficient without evidence starts where its effect is this share of the channel's size.
_LEAST_SHARE = 1e-2
_LEAST_SIGMA_SHARE = 1e-6


def channel_sizes(summary: RowSummary, dimension: int) -> FloatArray:
    """Root mean square of each channel's measured values, ``(channels,)``; 1 for channels without any."""
    sizes = summary.rms(np.zeros(dimension))
    return np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0)


def first_sigmas(summary: RowSummary, dimension: int) -> FloatArray:
    """Standard deviations ``(channels,)`` of what no parameters at all can explain of each channel by itself."""
    sizes = channel_sizes(summary, dimension)
    sigmas = sizes.copy()
    for index, parts in enumerate(summary.parts()):
        factor = np.concatenate([part.factor for part in parts])
        count, columns = sum(part.count for part in parts), factor.shape[1] - 1
        if count > columns:
            remainder = abs(np.linalg.qr(factor, mode="r")[-1, -1]) if len(factor) > columns else 0.0
            sigmas[index] = remainder / np.sqrt(count - columns)
    return np.maximum(sigmas, _LEAST_SIGMA_SHARE * sizes)


def scales_of_reals(model: MeasurementModel, sizes: FloatArray) -> FloatArray:
    """The scale of each real coefficient: the size of its joint's channel."""
    reals = model.coefficients[model.positives :]
    return np.array([sizes[coefficient.joint] for coefficient in reals])


def prior_parameters(
    model: MeasurementModel, summary: RowSummary, known: FloatArray | None
) -> FloatArray:
    """The prior's parameters ``(D,)``: ``known`` if given, else the URDF's inertias and, for the effects, the
    non-negative least-squares fit of each joint's effects alone on what those inertias leave unexplained.

    No CAD file knows a joint's friction. The metric on positive coefficients is relative, so that their prior must have
    the right order of magnitude; the data have it.
    """
    if known is not None:
        return known
    parameters = np.concatenate([model.nominal_inertias, np.zeros(len(model.coefficients))])
    sizes = channel_sizes(summary, model.dimension)
    first = 10 * len(model.identified)
    for index, parts in enumerate(summary.parts()):
        columns = model.channels[index].columns
        effects = np.flatnonzero(columns >= first)
        if not len(effects):
            continue
        factor = np.concatenate([part.factor for part in parts])
        chosen = columns[effects]
        if len(factor) == 0:
            parameters[chosen] = np.where(chosen < first + model.positives, 1.0, 0.0)
            continue
        remainder = factor[:, -1] - factor[:, :-1] @ parameters[columns]
        regressor = factor[:, effects]
        positive = chosen < first + model.positives
        lower = np.where(positive, 0.0, -np.inf)
        fitted = lsq_linear(regressor, remainder, bounds=(lower, np.inf)).x
        count = sum(part.count for part in parts)
        column_sizes = np.maximum(np.linalg.norm(regressor, axis=0) / np.sqrt(count), 1e-9)
        least = _LEAST_SHARE * sizes[index] / column_sizes
        parameters[chosen] = np.where(positive, np.maximum(fitted, least), fitted)
    return parameters
