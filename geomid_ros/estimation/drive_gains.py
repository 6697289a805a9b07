"""Gains of the joints' drives, fitted with the effects to the links of an estimate.

Measured efforts are off by a few percent of what the links need, differently at each joint, because torque constants
are not exact. Here the effort of joint j is ``(1 + g_j) X_j phi`` plus that of the effects, for the links phi of a fit
without gains: a gain is what is left when the links have explained what they can, and cannot hide a change of theirs.
The column of g_j is ``X_j phi``, so its products follow from those of the links' columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.estimate import EffectEstimate
from geomid_ros.estimation.fit import Fit, with_fitted_effects
from geomid_ros.estimation.objective import ResidualObjective
from geomid_ros.estimation.uncertainty import Uncertainty
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.effects import DriveGain
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Errors ``(joints,)`` of the gains with their standard deviations, and the ``point`` with the effects beside
    them."""

    errors: FloatArray
    stds: FloatArray
    point: Point

    def of_channels(self, model: MeasurementModel) -> FloatArray:
        """Factors of the links' efforts ``(channels,)``."""
        return np.append(1.0 + self.errors, np.ones(len(model.channels) - len(self.errors)))

    def effects(self, model: MeasurementModel) -> Iterator[EffectEstimate]:
        """Yield the gains as effects at the joints."""
        (prior_std,) = DriveGain.default_prior_std
        for channel, error, std in zip(model.channels, self.errors, self.stds, strict=False):  # efforts come first
            quantities = DriveGain().quantities(np.array([error]), np.array([[std**2]]))
            removed = max(1.0 - float(std / prior_std) ** 2, 0.0)
            yield EffectEstimate(name=DriveGain.name, joint=channel.name, parameters=quantities, from_data=removed)


def fit_drive_gains(fitted: Fit, point: Point, found: Uncertainty) -> DriveGains:
    """Fit the gains of all joints and the effects; the links stay.

    There are none for legs, as what the ground does to them is known only from their efforts, and none beside links
    that keep the URDF's inertias.

    Args:
        fitted: the fit without gains.
        point: its minimum.
        found: the uncertainty there. That of the links is part of the gains'.
    """
    problem, links = fitted.problem, fitted.problem.manifold.inertial
    model = problem.model
    whole = len({*model.identified}) == len(model.robot.bodies) and not model.legs
    joints = len(model.layout.efforts) if whole else 0
    objective = _with_gains(fitted, point, joints)
    start = Point(point.pseudo_inertias, point.positives, np.append(point.reals, np.zeros(joints)))
    minimum = with_fitted_effects(objective, start) if joints else start
    effects = slice(links.stop, None)
    share = min(found.independent_fraction, problem.independent_fraction)
    information = share * objective.evaluate(minimum).information[effects]
    prior = problem.independent_fraction * objective.prior_weights[effects]
    covariance = spd.inverse(information[:, effects] + np.diag(prior))
    by_links = covariance @ information[:, links]
    of_links = np.sum((by_links @ found.covariance[links, links]) * by_links, axis=1)
    variances = np.diag(covariance) + np.maximum(of_links, 0.0)  # rounding may make it negative
    size = problem.manifold.dimension
    stds = objective.manifold.scales[len(problem.manifold.scales) :] * np.sqrt(variances[size - links.stop :])
    reals, errors = np.split(minimum.reals, [len(point.reals)])
    return DriveGains(errors, stds, Point(point.pseudo_inertias, minimum.positives, reals))


def _with_gains(fitted: Fit, point: Point, joints: int) -> ResidualObjective:
    """Build the objective of a fit with gains as further parameters, linear at the links of a ``point``."""
    problem, objective = fitted.problem, fitted.objective
    manifold, size = problem.manifold, problem.manifold.dimension
    wider = size + joints
    held = [*range(size), wider]
    products, known = np.zeros((2, wider + 1, wider + 1))
    products[np.ix_(held, held)] = objective.products
    if objective.known is not None:
        known[np.ix_(held, held)] = objective.known
    links = np.append(point.parameters, 0.0) * (np.arange(size + 1) < manifold.inertial.stop)
    weights = fitted.sigmas**-2.0
    for group, (places, block) in enumerate(problem.products.by_channel):
        joint = group % len(problem.model.channels)  # efforts come first
        if joint < joints:
            column, at = weights[group] * block @ links[places], np.append(places[:-1], wider)
            products[at, size + joint] += column
            products[size + joint, at] += column
            products[size + joint, size + joint] += links[places] @ column
    (std,) = DriveGain.default_prior_std
    with_gains = ParameterManifold(manifold.links, manifold.positives, np.append(manifold.scales, np.full(joints, std)))
    return ResidualObjective(
        with_gains,
        products,
        with_gains.point(np.append(problem.prior_point.parameters, np.zeros(joints))),
        np.append(objective.prior_weights, np.full(joints, 1.0 / problem.independent_fraction)),
        objective.rows_weight,
        known,
    )
