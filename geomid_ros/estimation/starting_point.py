"""Start of a solve: prior point and its standard deviations, scales of the coefficients, first noise of each group."""

from __future__ import annotations

from itertools import chain

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.channel_products import triangular
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.estimation.tolerances import ROUNDING, ROUNDING_OF_PRODUCTS
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.effects import GravityEffect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REGIMES, REST_SPEED
from geomid_ros.types import BoolArray, FloatArray, IntArray

# A positive coefficient without evidence starts where its effect is this fraction of the channel's size.
_LEAST_SHARE = 1e-2
# In rad/s, rad/s^2 (m/s, m/s^2): columns of slower motion do not raise that start further.
_LEAST_MOTION = 0.1
# No model predicts a channel better than to this fraction of its size.
_LEAST_SIGMA_SHARE = 1e-3
# Default prior std per direction of the tangent space. Inertias from CAD: a fifth. Positive coefficients: a factor of
# e, because they are a first fit that absorbs the inertias' errors. Real ones: a fifth of what their channel measures.
DEFAULT_PRIOR_STD = 0.2


def channel_sizes(summary: RowSummary, dimension: int) -> FloatArray:
    """RMS of each channel's measured values ``(channels,)``; 1 for channels without any."""
    sizes = summary.rms(np.zeros(dimension))
    return np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0)


def first_sigmas(summary: RowSummary, dimension: int) -> FloatArray:
    """Standard deviations ``(groups,)`` of the part of each group alone that no parameters can explain."""
    sizes = np.tile(channel_sizes(summary, dimension), REGIMES)
    sigmas = sizes.copy()
    for index, (factor, count) in enumerate(zip(summary.factors(), summary.counts(), strict=True)):
        columns = factor.shape[1] - 1
        if count > columns:
            residual, rank = _least_residual(factor)
            sigmas[index] = residual / np.sqrt(count - rank)
    return np.maximum(sigmas, _LEAST_SIGMA_SHARE * sizes)


def _least_residual(factor: FloatArray) -> tuple[float, int]:
    """Norm of the least-squares residual of ``[A b]``, and the numerical rank of A."""
    sizes = np.linalg.norm(factor[:, :-1], axis=0)
    nonzero = sizes > ROUNDING_OF_PRODUCTS * np.max(sizes, initial=0.0)
    regressor = factor[:, :-1][:, nonzero] / sizes[nonzero]
    try:
        solution, _, rank, _ = np.linalg.lstsq(regressor, factor[:, -1], rcond=ROUNDING)
    except np.linalg.LinAlgError:  # LAPACK's divide and conquer does not always converge; its QR iteration does
        from scipy.linalg import lstsq  # noqa: PLC0415 seldom needed

        solution, _, rank, _ = lstsq(regressor, factor[:, -1], cond=ROUNDING, lapack_driver="gelss")
    return float(np.linalg.norm(factor[:, -1] - regressor @ solution)), int(rank)


def scales_of_coefficients(model: MeasurementModel, summary: RowSummary) -> FloatArray:
    """Scale of each coefficient: the value at which its effect is as large as the channel it adds to. Of several
    channels, the one in which it is most visible counts. If no motion shows it, it may be as large as the channel. If
    the effect's default prior std does not depend on the robot, the scale is that at which it is the usual one."""
    scales, unseen = np.full((2, model.dimension), np.inf)
    sizes, factors = channel_sizes(summary, model.dimension), summary.factors()
    counts = np.sum(summary.counts().reshape(REGIMES, -1), axis=0)
    for index, channel in enumerate(model.channels):
        squares = sum(np.sum(factor[:, :-1] ** 2, axis=0) for factor in factors[index :: len(sizes)])
        columns = np.sqrt(squares / max(counts[index], 1.0))
        large = columns > ROUNDING_OF_PRODUCTS
        in_channel = sizes[index] / np.where(large, columns, 1.0)
        scales[channel.columns] = np.minimum(scales[channel.columns], np.where(large, in_channel, np.inf))
        unseen[channel.columns] = np.minimum(unseen[channel.columns], sizes[index] / _LEAST_MOTION)
    usual = [(c.effect.default_prior_std, c.index) for c in model.coefficients]
    own = np.array([stds[index] if stds else np.nan for stds, index in usual], dtype=np.float64)
    seen = np.where(np.isfinite(scales), scales, unseen)[len(model.nominal_inertias) :]
    return np.where(np.isfinite(own), own / DEFAULT_PRIOR_STD, seen)


def default_prior_stds(manifold: ParameterManifold) -> FloatArray:
    """Default prior std ``(D,)``, in tangent coordinates."""
    stds = np.full(manifold.dimension, DEFAULT_PRIOR_STD)
    stds[manifold.positive] = 1.0
    return stds


def prior_stds_of(model: MeasurementModel, manifold: ParameterManifold, given: FloatArray | None) -> FloatArray:
    """Default prior std ``(D,)``; coefficients that are expected to be about zero have their effect's."""
    stds = default_prior_stds(manifold)
    expected = _expected_shares(model, given)
    stds[manifold.inertial.stop :] = np.where(np.isnan(expected), stds[manifold.inertial.stop :], expected)
    return stds


def _expected_shares(model: MeasurementModel, given: FloatArray | None) -> FloatArray:
    """Expected size of each coefficient about zero ``(coefficients,)``, in units of its scale. NaN
    where more is known: a ``given`` prior ``(D,)``, or a first fit, as for an effect that is part of another one."""
    parts = {(c.place, part) for c in model.coefficients for part in c.effect.parts if part != c.effect}
    own = [DEFAULT_PRIOR_STD if c.effect.default_prior_std else c.effect.prior_std_fraction for c in model.coefficients]
    expected = [None if (c.place, c.effect) in parts else size for c, size in zip(model.coefficients, own, strict=True)]
    unknown = True if given is None else ~np.isfinite(given[len(model.nominal_inertias) :])
    return np.where(unknown, np.array(expected, dtype=np.float64), np.nan)


def prior_inertias(model: MeasurementModel, given: FloatArray | None) -> FloatArray:
    """Inertias of the prior ``(10 links,)``: see :func:`prior_parameters`."""
    if given is None:
        return model.nominal_inertias
    _check_possible(given, model)
    inertial = given[: len(model.nominal_inertias)]
    return np.where(np.isfinite(inertial), inertial, model.nominal_inertias)


def prior_parameters(model: MeasurementModel, summary: RowSummary, given: FloatArray | None) -> FloatArray:
    """Parameters of the prior ``(D,)``: the ``given`` ones ``(D,)`` where they are not NaN, else those of
    :func:`first_fit`. Errors of sensors are expected to be zero.

    Raises:
        InputError: ``given`` is no point of the model's manifold.
    """
    parameters = first_fit(model, summary, given)
    parameters[len(model.nominal_inertias) :][np.isfinite(_expected_shares(model, given))] = 0.0
    return parameters if given is None else np.where(np.isfinite(given), given, parameters)


def first_fit(model: MeasurementModel, summary: RowSummary, given: FloatArray | None) -> FloatArray:
    """Parameters ``(D,)`` with the inertias of the prior, and effects that are fitted to what these leave unexplained.

    This is the non-negative least-squares fit of each joint's effects alone. No CAD file knows a joint's friction, and
    the metric on positive coefficients is relative, so that their prior must have the right order of magnitude. If a
    joint hardly moves, the URDF's friction stays; and so does gravity, which would tie the fits of all joints together.

    Raises:
        InputError: the ``given`` prior ``(D,)`` is no point of the model's manifold.
    """
    first = len(model.nominal_inertias)
    parameters = np.append(prior_inertias(model, given), model.nominal_parameters[first:])
    sizes = channel_sizes(summary, model.dimension)
    factors, counts = summary.factors(), np.sum(summary.counts().reshape(REGIMES, -1), axis=0)
    described = model.described_coefficients
    local = first + np.flatnonzero([not isinstance(c.effect, GravityEffect) for c in model.coefficients])
    for group in _sharing_effects(model, local):
        channel_columns = [model.channels[index].columns for index in group]
        channel_factors = [triangular(np.concatenate(factors[index :: len(sizes)])) for index in group]
        columns, factor = _together(channel_columns, channel_factors, sizes[group])
        fitted = np.isin(columns, local)
        chosen, known = columns[fitted], columns[~fitted]
        remainder = factor[:, -1] - factor[:, :-1][:, ~fitted] @ parameters[known]
        parameters[chosen] = _fitted_effects(
            np.column_stack([factor[:, :-1][:, fitted], remainder]),
            float(np.sum(counts[group])),
            float(np.mean(sizes[group])),
            chosen < first + model.positives,
            described[chosen - first],
        )
    return parameters


def _sharing_effects(model: MeasurementModel, columns: IntArray) -> list[list[int]]:
    """Groups of channels with effects of these columns; channels that share one are in one group."""
    has = np.array([np.isin(columns, channel.columns) for channel in model.channels])
    groups: list[list[int]] = []
    for channel in np.flatnonzero(np.any(has, axis=1)).tolist():
        sharing = [group for group in groups if np.any(has[group] & has[channel])]
        others = [group for group in groups if group not in sharing]
        groups = [*others, sorted([*chain(*sharing), channel])]
    return sorted(groups)


def _together(columns: list[IntArray], factors: list[FloatArray], sizes: FloatArray) -> tuple[IntArray, FloatArray]:
    """Stack channels, scaled to equal weight: columns ``(k,)`` and factor ``(rows, k + 1)``."""
    union = np.unique(np.concatenate(columns))
    blocks = []
    for indices, factor, size in zip(columns, factors, sizes, strict=True):
        block = np.zeros((len(factor), len(union) + 1))
        block[:, [*np.searchsorted(union, indices), -1]] = factor * (np.mean(sizes) / size)
        blocks.append(block)
    return union, np.concatenate(blocks)


def _check_possible(given: FloatArray, model: MeasurementModel) -> None:
    """Raise InputError unless a prior ``(D,)``, in which NaN is allowed, is a point of the model's manifold."""
    if given.shape != (model.dimension,):
        raise InputError(f"the prior has the shape {given.shape}, the model has {model.dimension} parameters")
    first = len(model.nominal_inertias)
    for name, body in zip(model.body_names, given[:first].reshape(-1, 10), strict=True):
        if np.all(np.isfinite(body)) and np.linalg.eigvalsh(pseudo_inertia.from_parameters(body))[0] <= 0.0:
            raise InputError(f"the prior of link '{name}' is not physically consistent")
    for coefficient, value in zip(model.coefficients, given[first:], strict=True):
        if coefficient.positive and value <= 0.0:
            label = f"{coefficient.effect.name} of joint '{coefficient.place_name}'"
            raise InputError(f"the prior's {label} is {value:g}, expected a number greater than zero")


def _fitted_effects(
    augmented: FloatArray, count: float, size: float, positive: BoolArray, described: FloatArray
) -> FloatArray:
    """Fit the coefficients ``(k,)`` of the effects of channels.

    Args:
        augmented: ``(rows, k + 1)``: the factor of their ``count`` rows, and what the inertias leave unexplained.
        count, size: number of rows, and RMS of their measured values.
        positive: True for positive coefficients ``(k,)``.
        described: the URDF's values ``(k,)``.
    """
    if not len(augmented):
        return np.where(positive, 1.0, 0.0)
    regressor, remainder = augmented[:, :-1], augmented[:, -1]
    split = np.hstack([regressor, -regressor[:, ~positive]])
    # The apparent motion of a joint at rest must not count as evidence.
    damping = REST_SPEED * np.sqrt(count) * np.eye(split.shape[1])
    described = np.append(described, np.zeros(np.count_nonzero(~positive)))
    rows = np.concatenate([np.column_stack([split, remainder]), np.column_stack([damping, damping @ described])])
    halves = _non_negative(rows.T @ rows)
    fitted = halves[: len(positive)]
    fitted[~positive] -= halves[len(positive) :]
    column_sizes = np.maximum(np.linalg.norm(regressor, axis=0) / np.sqrt(count), _LEAST_MOTION)
    return np.asarray(np.where(positive, np.maximum(fitted, _LEAST_SHARE * size / column_sizes), fitted))


def _non_negative(products: FloatArray) -> FloatArray:
    """Return the ``x >= 0`` with the least ``|A x - b|`` (Lawson & Hanson 1974). ``products (k + 1, k + 1)``: those of
    the columns ``[A b]``, which are independent."""
    sizes = np.sqrt(np.diag(products))[:-1]
    gram, slope = products[:-1, :-1] / np.outer(sizes, sizes), products[:-1, -1] / sizes
    x, free = np.zeros(len(slope)), np.zeros(len(slope), dtype=bool)
    least = ROUNDING_OF_PRODUCTS * np.sqrt(products[-1, -1])
    for _ in range(3 * len(x)):
        slopes = np.where(free, -np.inf, slope - gram @ x - least)
        if np.all(slopes <= 0.0):
            break
        free[np.argmax(slopes)] = True
        while np.any(free):
            best = np.zeros(len(x))
            best[free] = np.linalg.solve(gram[np.ix_(free, free)], slope[free])
            blocked = free & (best <= 0.0)
            if not np.any(blocked):
                x = best
                break
            # Step until the first of them reaches zero, where it stays.
            distances = np.maximum(np.where(blocked, x - best, 1.0), np.finfo(float).tiny)
            fractions = np.where(blocked, x / distances, np.inf)
            free &= fractions > np.min(fractions)
            x = np.where(free, x + np.min(fractions) * (best - x), 0.0)
    return np.asarray(x / sizes)
