"""Knowledge of a robot's parameters, and how a motion would improve it, by the criterion of its aim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation.estimate_parts import effect_coordinates
from geomid_ros.estimation.fit import INDEPENDENT_ROWS_PER_PERIOD
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.estimation.starting_point import default_prior_stds
from geomid_ros.estimation.uncertainty import physical_sensitivity
from geomid_ros.excitation.limits import MotionLimits
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.model.effects import effect_class
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import ACCELERATION_PER_SPEED, random_states, samples_of
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, frozen

NOISE = 2e-3
"""Default standard deviation of the effort noise, as a fraction of the joint's effort limit."""
ROWS_PER_SECOND = INDEPENDENT_ROWS_PER_PERIOD * SignalSettings().cutoff
"""Independent measurements of each joint per second, after the default low-pass filter."""
_USUAL_SHARE = 0.02  # typical size of an effect, as a fraction of the joint's effort limit
_STATES = 200
_OTHERS = (
    "{}: an estimate with other links or effects than this robot ({}); give the URDF and the options of that "
    "identification"
)


@dataclass(frozen=True, eq=False)
class Belief:
    """Knowledge of the parameters before a motion.

    Attributes:
        model: defines the unknown parameters; its C channels begin with the joints' efforts.
        posterior: posterior of these parameters, in the model's order.
        sigmas: standard deviations of the measurement noise per channel ``(C,)``.
    """

    model: MeasurementModel
    posterior: Posterior
    sigmas: FloatArray

    @cached_property
    def precision(self) -> FloatArray:
        """Pseudo-inverse of the posterior covariance ``(D, D)``."""
        deviations = np.sqrt(np.diag(self.posterior.covariance))
        scaled = self.posterior.covariance / np.outer(deviations, deviations)
        inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
        return frozen(inverse / np.outer(deviations, deviations))

    def rows_of_parameters(self, states: FloatArray) -> FloatArray:
        """Regressor ``(N, C, D)`` of the parameters, for efforts in N m or N, at ``states (3, N, J)``."""
        return self.model.rows(samples_of(states, len(self.model.sensors))).coefficients

    def rows(self, states: FloatArray) -> FloatArray:
        """Regressor ``(N, C, D)`` of the tangent coordinates at ``states (3, N, J)``."""
        return self.rows_of_parameters(states) @ self.posterior.jacobian

    def efforts(self, states: FloatArray) -> FloatArray:
        """Expected efforts ``(N, J)`` at ``states (3, N, J)``."""
        return np.asarray((self.rows_of_parameters(states) @ self.posterior.parameters)[:, : states.shape[2]])

    def prediction_stds(self, rows: FloatArray) -> FloatArray:
        """Standard deviations ``(N, C)`` of the predictions of ``rows (N, C, D)`` of the tangent coordinates."""
        variances = np.sum((rows @ self.posterior.covariance) * rows, axis=2)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    def information(self, motion: ExcitingMotion) -> FloatArray:
        """Fisher information ``(D, D)`` of a motion about the tangent coordinates."""
        count = int(np.ceil(ROWS_PER_SECOND * motion.form.period))
        times = (np.arange(count) + 0.5) * motion.form.period / count
        rows = self.rows(motion.at(times)[:3]) / self.sigmas[:, None]
        return self.information_of(rows, motion.form.duration)

    def information_of(self, rows: FloatArray, duration: float) -> FloatArray:
        """Fisher information ``(D, D)`` of ``rows (N, C, D)`` in units of the noise, sampled over ``duration`` [s]."""
        flat = rows.reshape(-1, rows.shape[-1])
        return np.asarray(ROWS_PER_SECOND * duration / len(rows) * (flat.T @ flat))

    def updated(self, information: FloatArray) -> Belief:
        """Return the belief after adding ``information (D, D)``; the estimate itself stays."""
        covariance = covariance_of(self.precision + information)
        return replace(self, posterior=replace(self.posterior, covariance=frozen(covariance)))

    def error(self, weight: FloatArray) -> float:
        """Square root of the trace of ``weight (D, D)`` times the covariance."""
        return float(np.sqrt(np.sum(weight * self.posterior.covariance)))

    def quantity_stds(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviations of the links' quantities ``(links, 10)``, in the order of QUANTITIES, and of the effects'
        coefficients ``(effects,)``."""
        manifold, point = self.posterior.manifold, self.posterior.point
        covariance = self.posterior.covariance
        sensitivity = physical_sensitivity(point)
        links = [
            np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance[block, block], jacobian))
            for jacobian, block in zip(sensitivity, map(manifold.link, range(manifold.links)), strict=True)
        ]
        _, diagonal = manifold.jacobian(point)
        effects = diagonal * np.sqrt(np.diag(covariance)[manifold.inertial.stop :])
        return np.array(links), np.asarray(effects)


def covariance_of(precision: FloatArray) -> FloatArray:
    """Invert a positive definite matrix."""
    units = 1.0 / np.sqrt(np.diag(precision))
    return np.asarray(np.linalg.inv(precision * np.outer(units, units)) * np.outer(units, units))


def belief_from_urdf(model: MeasurementModel, limits: MotionLimits) -> Belief:
    """Build the belief from the URDF alone: inertias with the default prior std (CAD), effects with a broad prior.
    A positive coefficient is expected at the typical effect size, or at its <dynamics> value where that is larger."""
    acceleration = np.minimum(ACCELERATION_PER_SPEED * limits.velocity, limits.acceleration)
    states = random_states(np.random.default_rng(0), _STATES, limits.position, limits.velocity, acceleration)
    coefficients = model.rows(samples_of(states, len(model.sensors))).coefficients
    first_effect = len(model.nominal_inertias)
    channel_sizes = _channel_sizes(model, limits, coefficients)
    columns = np.sqrt(np.mean(coefficients[:, :, first_effect:] ** 2, axis=0))  # (C, effects)
    sizes = np.max(channel_sizes[:, None] / np.where(columns > 0.0, columns, np.inf), axis=0, initial=0.0)
    sizes = np.maximum(np.where(sizes > 0.0, sizes, 1.0), model.described_coefficients)
    positive = np.arange(len(sizes)) < model.positives
    parameters = np.concatenate([model.nominal_inertias, np.where(positive, sizes, 0.0)])
    # A real coefficient may have either sign; its prior std is the size that a positive one would have.
    scales = sizes[~positive] / default_prior_stds(model.manifold(np.ones(int(np.sum(~positive)))))[-1:]
    prior_stds = default_prior_stds(model.manifold(scales))
    bodies = [model.robot.bodies[index] for index in model.identified]
    posterior = Posterior(
        links=model.body_names,
        merged=tuple(body.merged for body in bodies),
        effects=effect_coordinates(model),
        parameters=frozen(parameters),
        covariance=frozen(np.diag(prior_stds**2)),
        scales=frozen(scales),
        prior=frozen(parameters),
        prior_stds=frozen(prior_stds),
    )
    return Belief(model, posterior, frozen(NOISE / _USUAL_SHARE * channel_sizes))


def belief_from_estimate(model: MeasurementModel, posterior: Posterior, sigmas: Sequence[float], source: str) -> Belief:
    """Build the belief from the estimate of a model with the same links and effects.

    The effects may be in another order. Raises InputError naming the ``source`` if it is of another robot.
    """
    if posterior.links != model.body_names:
        raise InputError(_OTHERS.format(source, f"its links are {', '.join(posterior.links)}"))
    try:
        reordered = posterior.with_effects(effect_coordinates(model))
    except ValueError as error:
        raise InputError(_OTHERS.format(source, error)) from error
    return Belief(model, reordered, frozen(sigmas))


def _channel_sizes(model: MeasurementModel, limits: MotionLimits, coefficients: FloatArray) -> FloatArray:
    """Typical size of an effect at each channel ``(C,)`` [N m, N], by effort limit or else by nominal effort."""
    nominal = np.sqrt(np.mean((coefficients @ model.nominal_parameters) ** 2, axis=0))
    scale = np.full(len(model.channels), np.inf)
    scale[: len(limits.effort)] = limits.effort
    return _USUAL_SHARE * np.where(np.isfinite(scale), scale, np.maximum(nominal, 1e-6))


PREDICTION, FRICTION, PAYLOAD, LINK = "prediction", "friction", "payload", "link:"
_FRICTION = "dynamics/"  # prefix of the URDF attributes that describe friction
_WORTH = 0.02  # smallest relative gain that is reported


def aim_weight(aim: str, belief: Belief, others: Sequence[ExcitingMotion]) -> FloatArray:
    """Weight W ``(D, D)`` of an aim: the criterion is the trace of W times the covariance of the estimate.

    - ``prediction`` (I-optimal): mean squared error of the efforts on ``others``, in units of the noise;
    - ``friction``: squared relative errors of the coefficients that a URDF's <dynamics> can hold;
    - ``link:NAME``: squared error of a link's inertia, as a geodesic distance;
    - ``payload``: as ``link:NAME``, for the last link that moves.

    Raises InputError for another aim, or an unknown link.
    """
    size, manifold = belief.model.dimension, belief.posterior.manifold
    if aim == PREDICTION:
        rows_per_second = ROWS_PER_SECOND * len(belief.sigmas)
        information = [belief.information(motion) / (rows_per_second * motion.form.duration) for motion in others]
        return np.asarray(np.mean(information, axis=0))
    weight = np.zeros((size, size))
    if aim == FRICTION:
        forms = [effect_class(effect.name).parameters for effect in belief.posterior.effects]
        are_friction = [any(form.urdf.startswith(_FRICTION) for form in of_effect) for of_effect in forms]
        indices = manifold.inertial.stop + np.flatnonzero(are_friction)
        if not len(indices):
            raise InputError("--for friction: none of the identified effects is friction; add one to 'effects'")
    elif aim == PAYLOAD or aim.startswith(LINK):
        links = belief.posterior.links
        name = links[-1] if aim == PAYLOAD else aim.removeprefix(LINK)
        if name not in links:
            raise unknown_name("link to identify", name, links)
        indices = np.arange(size)[manifold.link(links.index(name))]
    else:
        raise unknown_name("aim", aim, (PREDICTION, FRICTION, PAYLOAD, f"{LINK}NAME"))
    weight[indices, indices] = 1.0
    return weight


def error_description(aim: str) -> str:
    """Phrase for the error that the root of an aim's criterion measures."""
    if aim == PREDICTION:
        return "RMS prediction error of efforts on other motions, in units of the noise"
    if aim == FRICTION:
        return "combined relative error of the friction coefficients"
    link = "the last link" if aim == PAYLOAD else aim.removeprefix(LINK)
    return f"error of the inertia of {link}, as a geodesic distance"


@dataclass(frozen=True, eq=False)
class ExpectedUncertainty:
    """Expected uncertainty at one stage: ``error`` is the root of the criterion. ``links (links, 10)`` and
    ``effects (effects,)`` are standard deviations of the links' quantities and of the effects' coefficients."""

    error: float
    links: FloatArray
    effects: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignComparison:
    """Expected uncertainty ``before`` and after the ``designed`` motion. For comparison: after a ``random`` feasible
    motion of equal duration, the designed one ``twice``, and a random one twice as long (``random_twice``)."""

    before: ExpectedUncertainty
    designed: ExpectedUncertainty
    random: ExpectedUncertainty
    twice: ExpectedUncertainty
    random_twice: ExpectedUncertainty

    @property
    def gain(self) -> float:
        """Fraction by which the designed motion lowers the expected error."""
        return 1.0 - self.designed.error / self.before.error

    @property
    def sentences(self) -> list[str]:
        """Sentences that compare the designed motion with the others."""
        lines = [f"{self.before.error:.3g} before, {self.designed.error:.3g} after this motion"]
        gain = 1.0 - self.designed.error / self.random.error
        no_gain = "the design is no better than a random motion here, but it is checked for feasibility"
        saved = f"{gain:.0%} saved" if gain > _WORTH else no_gain
        lines.append(f"a random feasible motion of the same length leaves {self.random.error:.3g}: {saved}")
        longer = self.random_twice.error / self.designed.error
        better = "recording longer" if longer < 1.0 else "the design"
        worse = "the design" if longer < 1.0 else "recording twice as long"
        lines.append(
            f"a random motion twice as long leaves {self.random_twice.error:.3g}: {better} helps more than {worse}"
        )
        lines.append(f"this motion recorded twice leaves {self.twice.error:.3g}")
        return lines


def expected_learning(
    knowledge: Belief, weight: FloatArray, motion: ExcitingMotion, randoms: Sequence[ExcitingMotion]
) -> DesignComparison:
    """Compare a designed ``motion`` with the median of feasible ``randoms`` of its form, by the criterion of a
    ``weight (D, D)``."""

    def expected(belief: Belief) -> ExpectedUncertainty:
        return ExpectedUncertainty(belief.error(weight), *belief.quantity_stds())

    def after(information: FloatArray) -> ExpectedUncertainty:
        return expected(knowledge.updated(information))

    designed, others = knowledge.information(motion), [knowledge.information(other) for other in randoms]
    median = sorted(others, key=lambda other: knowledge.updated(other).error(weight))[len(others) // 2]
    return DesignComparison(
        before=expected(knowledge),
        designed=after(designed),
        random=after(median),
        twice=after(2.0 * designed),
        random_twice=after(2.0 * median),
    )
