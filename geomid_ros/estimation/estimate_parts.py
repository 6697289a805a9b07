"""Parts of an estimate: links, effects and weighed masses, from the end of a fit and its uncertainty.

``point`` is everywhere the end of the fit of the ``problem``, and ``found`` its uncertainty.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from geomid_ros.estimation import uncertainty
from geomid_ros.estimation.estimate import QUANTITIES, EffectEstimate, LinkEstimate, WeighedEstimate, identified
from geomid_ros.estimation.posterior import EffectCoordinate, Posterior
from geomid_ros.estimation.problem import Problem
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import Point
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray, frozen


def links(
    problem: Problem, point: Point, found: uncertainty.Uncertainty, outliers: BoolArray, least_stds: FloatArray
) -> tuple[LinkEstimate, ...]:
    """Link estimates; ``outliers (links,)``: True for links that left their prior; ``least_stds (links, 13)``: lower
    bounds of the standard deviations of their quantities and first moments."""
    model, manifold, prior = problem.model, problem.manifold, problem.prior_point
    parameters = pseudo_inertia.to_parameters(point.pseudo_inertias)
    sensitivity = sensitivity_of_numbers(point)
    distances = spd.distance(prior.pseudo_inertias, point.pseudo_inertias)
    ratios = spd.relative_eigenvalues(prior.pseudo_inertias, point.pseudo_inertias)[:, 0]
    enlarged = uncertainty.with_enlarged_prior(found.covariance, found.covariance_from_prior)
    covariances, estimates = (found.covariance, enlarged, found.prior), []
    for index, name in enumerate(model.body_names):
        block = manifold.link(index)
        std, doubted, prior_std = (deviations_of(sensitivity[index], c[block, block]) for c in covariances)
        std, doubted = (np.maximum(stds, least_stds[index]) for stds in (std, doubted))
        default_std = problem.default_stds[index] * np.linalg.norm(sensitivity[index], axis=1)
        prior_std = np.minimum(prior_std, default_std)
        is_identified = identified(parameters[index], doubted, prior_std)
        estimates.append(
            LinkEstimate(
                name=name,
                merged=model.robot.bodies[model.identified[index]].merged,
                parameters=frozen(parameters[index]),
                std=frozen(std[:10]),
                distance_from_prior=float(distances[index]),
                from_data=found.from_data(block),
                min_eigenvalue_ratio=float(ratios[index]),
                cannot_tell=tuple(compress(QUANTITIES, ~is_identified[:10])),
                moments=tuple(compress("xyz", is_identified[10:] & ~outliers[index])),
                std_doubted=frozen(doubted),
                std_prior=frozen(prior_std),
                outlier=bool(outliers[index]),
            )
        )
    return tuple(estimates)


def sensitivity_of_numbers(point: Point) -> FloatArray:
    """Derivative ``(links, 13, 10)`` of each link's quantities and first moments by its tangent coordinates."""
    return np.concatenate([uncertainty.physical_sensitivity(point), point.links_jacobian[:, 1:4]], axis=1)


def deviations_of(sensitivity: FloatArray, covariance: FloatArray) -> FloatArray:
    """Standard deviations ``(n,)`` of numbers, by their ``sensitivity (n, 10)`` to coordinates of ``covariance``."""
    variances = np.einsum("ij,jk,ik->i", sensitivity, covariance, sensitivity)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def effects(problem: Problem, point: Point, found: uncertainty.Uncertainty) -> tuple[EffectEstimate, ...]:
    """Effect estimates; each standard deviation is for the effect's own constant, as this is stated beside it, and
    includes the drift to other motions and what errors of the links' effort contribute."""
    model, first = problem.model, problem.manifold.inertial.stop
    _, diagonal = problem.manifold.jacobian(point)
    prior, variances = found.prior_stds[first:] ** 2, (np.diag(found.covariance) - found.own_constant)[first:]
    wider = np.maximum(prior, problem.default_coefficient_stds(point) ** 2)
    separate = 1.0 / (found.by_rows[first:] + 1.0 / wider)
    variances = np.where(wider > prior, np.maximum(variances, separate), variances)
    removed = np.clip(1.0 - variances / wider, 0.0, 1.0)
    drift = np.array([c.effect.drift for c in model.coefficients]) * point.parameters[first:]
    of_load = np.array([c.effect.load_error for c in model.coefficients]) * problem.scales
    std = np.sqrt(diagonal**2 * variances + drift**2 + of_load**2)
    return tuple(
        EffectEstimate(
            name=c.effect.name, joint=c.place_name, parameters=c.parameters(float(value), float(s)), from_data=part
        )
        for c, value, s, part in zip(model.coefficients, point.parameters[first:], std, removed.tolist(), strict=True)
    )


def posterior(problem: Problem, point: Point, found: uncertainty.Uncertainty) -> Posterior:
    """Joint posterior of all parameters, for the constants of the effects as they are."""
    model = problem.model
    return Posterior(
        links=tuple(model.body_names),
        merged=tuple(model.robot.bodies[body].merged for body in model.identified),
        effects=effect_coordinates(model),
        parameters=point.parameters,
        covariance=frozen(found.covariance),
        scales=problem.manifold.scales,
        prior=frozen(problem.prior),
        prior_stds=frozen(found.prior_stds),
    )


def effect_coordinates(model: MeasurementModel) -> tuple[EffectCoordinate, ...]:
    """Coefficients of a model, as named in a posterior."""
    return tuple(
        EffectCoordinate(
            name=c.effect.name, place=c.place_name, parameter=c.parameter, unit=c.unit, positive=c.positive
        )
        for c in model.coefficients
    )


def weighed(problem: Problem, point: Point, found: uncertainty.Uncertainty) -> tuple[WeighedEstimate, ...]:
    """Estimates of the weighed masses."""
    rows = problem.known.weighed
    normals = problem.manifold.whiten(point, rows.rows)
    stds = np.sqrt(np.einsum("ki,ij,kj->k", normals, found.covariance, normals))
    # In units of the given standard deviation, without the masses of links that are not estimated.
    errors = rows.rows @ point.parameters - rows.targets
    return tuple(
        WeighedEstimate(
            name=given.name,
            given=given.mass,
            given_std=given.std,
            mass=given.mass + float(error) * given.std,
            std=float(std) * given.std,
        )
        for given, error, std in zip(rows.masses, errors, stds, strict=True)
    )
