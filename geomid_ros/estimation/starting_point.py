"""The start of a solve: prior point, scales of the real coefficients, first standard deviations of the channels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from geomid_ros.errors import InputError
from geomid_ros.estimation.summary import ChannelSummary, RowSummary, joined
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray, IntArray

# A positive coefficient without evidence starts where its effect is this share of the channel's size.
_LEAST_SHARE = 1e-2
# In rad/s, rad/s^2 (m/s, m/s^2): the apparent motion of a joint at rest, which must not pass for evidence, and the
# least motion at which a coefficient is made large enough to show.
_NOISE_MOTION = 1e-2
_LEAST_MOTION = 0.1
# No model predicts a channel better than this share of its size.
_LEAST_SIGMA_SHARE = 1e-3
_ROUNDING = 1e-9
_ROUNDING_COLUMN = 1e-12
# Usual error of priors, per direction of the tangent space: inertias from CAD a fifth; positive coefficients a factor
# of e, for they are a first fit that absorbs what the inertias cannot explain; real ones a fifth of what their channel
# measures.
USUAL_SPREAD_OF_LINKS = 0.2
# No prior is more certain than this.
LEAST_PRIOR_SPREAD = 0.1
_USUAL_SPREAD_OF_POSITIVES = 1.0
_USUAL_SPREAD_OF_REALS = 0.2


def channel_sizes(summary: RowSummary, dimension: int) -> FloatArray:
    """Root mean square of each channel's measured values, ``(channels,)``; 1 for channels without any."""
    sizes = summary.rms(np.zeros(dimension))
    return np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0)


def first_sigmas(summary: RowSummary, dimension: int) -> FloatArray:
    """Standard deviations ``(channels,)`` of the part of each channel that no parameters can explain, by itself."""
    sizes = channel_sizes(summary, dimension)
    sigmas = sizes.copy()
    for index, parts in enumerate(summary.parts()):
        factor = joined(parts)
        count, columns = sum(part.count for part in parts), factor.shape[1] - 1
        if count > columns:
            residual, rank = _least_residual(factor)
            sigmas[index] = residual / np.sqrt(count - rank)
    return np.maximum(sigmas, _LEAST_SIGMA_SHARE * sizes)


def _least_residual(factor: FloatArray) -> tuple[float, int]:
    """Norm of the least-squares residual of ``[A b]``, and the rank of A, in which rounding does not count."""
    sizes = np.linalg.norm(factor[:, :-1], axis=0)
    some = sizes > _ROUNDING_COLUMN * np.max(sizes)
    regressor = factor[:, :-1][:, some] / sizes[some]
    solution, _, rank, _ = np.linalg.lstsq(regressor, factor[:, -1], rcond=_ROUNDING)
    return float(np.linalg.norm(factor[:, -1] - regressor @ solution)), int(rank)


def scales_of_reals(model: MeasurementModel, sizes: FloatArray) -> FloatArray:
    """The scale of each real coefficient: the size of its joint's channel."""
    reals = model.coefficients[model.positives :]
    return np.array([sizes[coefficient.joint] for coefficient in reals])


def usual_spreads(manifold: ParameterManifold) -> FloatArray:
    """Usual standard deviations ``(D,)`` of a prior's error, in tangent coordinates."""
    spreads = np.full(manifold.dimension, USUAL_SPREAD_OF_LINKS)
    spreads[manifold.positive] = _USUAL_SPREAD_OF_POSITIVES
    spreads[manifold.real] = _USUAL_SPREAD_OF_REALS
    return spreads


def prior_parameters(model: MeasurementModel, summary: RowSummary, given: FloatArray | None) -> FloatArray:
    """The prior's parameters ``(D,)``.

    These are the ``given`` ones ``(D,)`` where they are given and not NaN; else the URDF's inertias and, for the
    effects, the non-negative least-squares fit of each joint's effects alone to what the inertias leave unexplained: no
    CAD file knows a joint's friction, and the metric on positive coefficients is relative, so that their prior must
    have the right order of magnitude.

    Raises:
        InputError: ``given`` is no point of the model's manifold.
    """
    parameters = np.concatenate([model.nominal_inertias, np.zeros(len(model.coefficients))])
    first = len(model.nominal_inertias)
    if given is not None:
        _check_possible(given, model)
        inertial = given[:first]
        parameters[:first] = np.where(np.isfinite(inertial), inertial, parameters[:first])
    sizes = channel_sizes(summary, model.dimension)
    for channel, parts, size in zip(model.channels, summary.parts(), sizes, strict=True):
        chosen = channel.columns[channel.columns >= first]
        if len(chosen):
            parameters[chosen] = _fitted_effects(model, parts, channel.columns, parameters, size)
    if given is not None:
        parameters = np.where(np.isfinite(given), given, parameters)
    return parameters


def _check_possible(given: FloatArray, model: MeasurementModel) -> None:
    """Raise InputError unless a prior ``(D,)``, in which NaN is allowed, is a point of the model's manifold."""
    if given.shape != (model.dimension,):
        raise InputError(f"the prior has the shape {given.shape}, the model has {model.dimension} parameters")
    first = len(model.nominal_inertias)
    for name, body in zip(model.body_names, given[:first].reshape(-1, 10), strict=True):
        if np.all(np.isfinite(body)) and np.linalg.eigvalsh(pseudo_inertia.from_parameters(body))[0] <= 0.0:
            raise InputError(f"the prior of link '{name}' belongs to no body that can exist")
    for coefficient, value in zip(model.coefficients, given[first:], strict=True):
        if coefficient.effect.positive and value <= 0.0:
            what = f"{coefficient.effect.name} of joint '{coefficient.joint_name}'"
            raise InputError(f"the prior's {what} is {value:g}, expected a number greater than zero")


def _fitted_effects(
    model: MeasurementModel, parts: Sequence[ChannelSummary], columns: IntArray, parameters: FloatArray, size: float
) -> FloatArray:
    """Coefficients of the effects among the ``columns`` of a channel, whose measured values have this ``size``."""
    factor, count = joined(parts), sum(part.count for part in parts)
    inertial = columns < len(model.nominal_inertias)
    chosen = columns[~inertial]
    positive = chosen < len(model.nominal_inertias) + model.positives
    if not len(factor):
        return np.where(positive, 1.0, 0.0)
    remainder = factor[:, -1] - factor[:, :-1][:, inertial] @ parameters[columns[inertial]]
    regressor = factor[:, :-1][:, ~inertial]
    split = np.hstack([regressor, -regressor[:, ~positive]])
    damping = _NOISE_MOTION * np.sqrt(count) * np.eye(split.shape[1])
    halves, _ = nnls(np.concatenate([split, damping]), np.append(remainder, np.zeros(len(damping))))
    fitted = halves[: len(chosen)]
    fitted[~positive] -= halves[len(chosen) :]
    column_sizes = np.maximum(np.linalg.norm(regressor, axis=0) / np.sqrt(count), _LEAST_MOTION)
    result: FloatArray = np.where(positive, np.maximum(fitted, _LEAST_SHARE * size / column_sizes), fitted)
    return result
