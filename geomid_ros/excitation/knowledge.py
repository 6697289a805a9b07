"""What is known of a robot's parameters, and what a motion would add to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate_parts import effect_coordinates
from geomid_ros.estimation.fit import INDEPENDENT
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.estimation.starting_point import usual_spreads
from geomid_ros.estimation.uncertainty import physical_sensitivity
from geomid_ros.excitation.limits import MotionLimits
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import ACCELERATION_PER_SPEED, random_states, samples_of
from geomid_ros.types import FloatArray, frozen

NOISE = 2e-3
"""Standard deviation of an effort of which nothing is known, as a share of the joint's limit."""
CUTOFF = 5.0
"""[Hz] of the low-pass that recordings usually pass."""
ROWS_PER_SECOND = INDEPENDENT * CUTOFF
"""Independent measurements of each joint in a second behind that filter."""
_USUAL_SHARE = 0.02  # of the joint's effort limit that an effect usually adds
_STATES = 200
_OTHERS = (
    "{}: an estimate with other links or effects than this robot ({}); give the URDF and the options of that "
    "identification"
)


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known before a motion.

    Attributes:
        model: which parameters are unknown; its C channels begin with the joints' efforts.
        posterior: of these parameters, in their order.
        sigmas: standard deviations of what is measured ``(C,)``.
    """

    model: MeasurementModel
    posterior: Posterior
    sigmas: FloatArray

    @cached_property
    def precision(self) -> FloatArray:
        """The inverse of the covariance ``(D, D)``."""
        deviations = np.sqrt(np.diag(self.posterior.covariance))
        scaled = self.posterior.covariance / np.outer(deviations, deviations)
        inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
        return frozen(inverse / np.outer(deviations, deviations))

    def rows_of_parameters(self, states: FloatArray) -> FloatArray:
        """Rows ``(N, C, D)`` by the parameters, of efforts in N m or N, at ``states (3, N, J)``."""
        return self.model.rows(samples_of(states, len(self.model.sensors))).coefficients

    def rows(self, states: FloatArray) -> FloatArray:
        """The same by the tangent coordinates."""
        return self.rows_of_parameters(states) @ self.posterior.jacobian

    def efforts(self, states: FloatArray) -> FloatArray:
        """The efforts ``(N, J)`` to expect at ``states (3, N, J)``."""
        return np.asarray((self.rows_of_parameters(states) @ self.posterior.parameters)[:, : states.shape[2]])

    def deviations_of(self, rows: FloatArray) -> FloatArray:
        """Standard deviations ``(N, C)`` of what ``rows (N, C, D)`` by the tangent coordinates predict."""
        variances = np.sum((rows @ self.posterior.covariance) * rows, axis=2)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    def information(self, motion: ExcitingMotion) -> FloatArray:
        """What a motion tells of the tangent coordinates ``(D, D)``."""
        count = int(np.ceil(ROWS_PER_SECOND * motion.form.period))
        times = (np.arange(count) + 0.5) * motion.form.period / count
        rows = self.rows(motion.at(times)[:3]) / self.sigmas[:, None]
        return self.information_of(rows, motion.form.duration)

    def information_of(self, rows: FloatArray, duration: float) -> FloatArray:
        """The same, of rows ``(N, C, D)`` in units of the noise at instants spread over a ``duration`` [s]."""
        flat = rows.reshape(-1, rows.shape[-1])
        return np.asarray(ROWS_PER_SECOND * duration / len(rows) * (flat.T @ flat))

    def after(self, information: FloatArray) -> Belief:
        """What is known when that ``information (D, D)`` is added; the estimate itself stays."""
        covariance = covariance_of(self.precision + information)
        return replace(self, posterior=replace(self.posterior, covariance=frozen(covariance)))

    def error(self, weight: FloatArray) -> float:
        """The root of the trace of a ``weight (D, D)`` times the covariance."""
        return float(np.sqrt(np.sum(weight * self.posterior.covariance)))

    def deviations(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviations of the links' quantities ``(links, 10)``, as :data:`QUANTITIES` names them, and of the
        effects' coefficients ``(effects,)``."""
        manifold, point = self.posterior.manifold, self.posterior.point
        covariance = self.posterior.covariance
        sensitivity = physical_sensitivity(point)
        links = [
            np.sqrt(np.einsum("ij,jk,ik->i", own, covariance[block, block], own))
            for own, block in zip(sensitivity, map(manifold.link, range(manifold.links)), strict=True)
        ]
        _, diagonal = manifold.jacobian(point)
        effects = diagonal * np.sqrt(np.diag(covariance)[manifold.inertial.stop :])
        return np.array(links), np.asarray(effects)


def covariance_of(precision: FloatArray) -> FloatArray:
    """The inverse of a positive definite matrix."""
    units = 1.0 / np.sqrt(np.diag(precision))
    return np.asarray(np.linalg.inv(precision * np.outer(units, units)) * np.outer(units, units))


def prior_knowledge(model: MeasurementModel, limits: MotionLimits) -> Belief:
    """What a URDF says: inertias as sure as CAD's, effects of any size about the usual, or about
    what its <dynamics> say where that is more."""
    fastest = np.minimum(ACCELERATION_PER_SPEED * limits.velocity, limits.acceleration)
    states = random_states(np.random.default_rng(0), _STATES, limits.position, limits.velocity, fastest)
    coefficients = model.rows(samples_of(states, len(model.sensors))).coefficients
    first = len(model.nominal_inertias)
    usual = _channel_sizes(model, limits, coefficients)
    columns = np.sqrt(np.mean(coefficients[:, :, first:] ** 2, axis=0))  # (C, effects)
    sizes = np.max(usual[:, None] / np.where(columns > 0.0, columns, np.inf), axis=0, initial=0.0)
    sizes = np.maximum(np.where(sizes > 0.0, sizes, 1.0), model.described_coefficients)
    positive = np.arange(len(sizes)) < model.positives
    parameters = np.concatenate([model.nominal_inertias, np.where(positive, sizes, 0.0)])
    # A real coefficient is of any sign and about the size that a positive one has.
    scales = sizes[~positive] / usual_spreads(model.manifold(np.ones(int(np.sum(~positive)))))[-1:]
    spreads = usual_spreads(model.manifold(scales))
    bodies = [model.robot.bodies[index] for index in model.identified]
    posterior = Posterior(
        links=model.body_names,
        merged=tuple(body.merged for body in bodies),
        effects=effect_coordinates(model),
        parameters=frozen(parameters),
        covariance=frozen(np.diag(spreads**2)),
        scales=frozen(scales),
        prior=frozen(parameters),
        prior_spreads=frozen(spreads),
    )
    return Belief(model, posterior, frozen(NOISE / _USUAL_SHARE * usual))


def known_before(model: MeasurementModel, posterior: Posterior, sigmas: Sequence[float], source: str) -> Belief:
    """What an estimate knows, of a model with the same links and effects.

    The order of the effects may be another. Raises InputError naming the ``source`` if it is of another robot.
    """
    if posterior.links != model.body_names:
        raise InputError(_OTHERS.format(source, f"its links are {', '.join(posterior.links)}"))
    try:
        known = posterior.with_effects(effect_coordinates(model))
    except ValueError as error:
        raise InputError(_OTHERS.format(source, error)) from error
    return Belief(model, known, frozen(sigmas))


def _channel_sizes(model: MeasurementModel, limits: MotionLimits, coefficients: FloatArray) -> FloatArray:
    """The usual size of an effect at each channel ``(C,)`` [N m, N]."""
    weights = np.sqrt(np.mean((coefficients @ model.nominal_parameters) ** 2, axis=0))
    limit = np.full(len(model.channels), np.inf)
    limit[: len(limits.effort)] = limits.effort
    return _USUAL_SHARE * np.where(np.isfinite(limit), limit, np.maximum(weights, 1e-6))
