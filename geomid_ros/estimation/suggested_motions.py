"""Suggest motions that would identify what a recording does not, by simulation with the estimated model.

The information of a motion's samples is added to the data's likelihood of all links together. The effects' coefficients
are unknown in every motion, so that a link gets no information that an effect could explain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import compress

import numpy as np

from geomid_ros.estimation.channel_products import triangular
from geomid_ros.estimation.estimate import QUANTITIES, Estimate, identified
from geomid_ros.estimation.estimate_parts import deviations_of, sensitivity_of_numbers
from geomid_ros.estimation.uncertainty import with_enlarged_prior
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import ACCELERATION_PER_SPEED, Samples, random_states, samples_of
from geomid_ros.types import FloatArray

_INSTANTS = 80
_AVERAGED = 10.0  # independent measurements that a sample stands for: a second of a pose, or of a motion
_FASTEST = 2.0  # [rad/s, m/s]
_OF_LIMIT = 0.5  # of the joint's speed limit
_TILT = np.array([[1.0, 0.0, 0.0], [0.0, np.sqrt(0.5), -np.sqrt(0.5)], [0.0, np.sqrt(0.5), np.sqrt(0.5)]])

POSES = "standing still in many poses"
FAST = "fast motion of all joints at once"
TILTED = "fast motion of all joints with a tilted base"


def suggested_motions(model: MeasurementModel, estimate: Estimate) -> dict[str, dict[str, list[str]]]:
    """Find the motions that would identify the quantities that an estimate does not.

    Returns:
        By link and motion, the quantities that this motion would identify and no simpler one before it; under an empty
        name those that none identifies. Nothing for outliers: no motion identifies what they absorb.
    """
    remaining = {link.name: [] if link.outlier else list(link.cannot_tell) for link in estimate.links}
    suggestions: dict[str, dict[str, list[str]]] = {name: {} for name in remaining}
    if not any(remaining.values()):
        return suggestions
    for motion, rows in _candidate_motions(model, estimate):
        for link, identified_names in zip(estimate.links, _identified_with(rows, estimate), strict=True):
            gained = [quantity for quantity in remaining[link.name] if quantity in identified_names]
            if gained:
                suggestions[link.name][motion] = gained
                remaining[link.name] = [quantity for quantity in remaining[link.name] if quantity not in gained]
    for name, quantities in remaining.items():
        if quantities:
            suggestions[name][""] = quantities
    return suggestions


def _identified_with(rows: FloatArray, estimate: Estimate) -> Iterator[set[str]]:
    """Yield the identified quantities of each link, from the data of an estimate and further ``rows (N, 10 links)`` of
    standard deviation 1."""
    manifold = ParameterManifold(len(estimate.links), 0, np.zeros(0))
    point = manifold.point(estimate.parameters[manifold.inertial])
    prior_stds = np.repeat(estimate.prior_stds, 10)
    both = np.asarray(manifold.whiten(point, np.concatenate([estimate.information.rows, rows])) * prior_stds)
    posterior = np.asarray(np.linalg.inv(np.eye(both.shape[1]) + both.T @ both))
    covariance = with_enlarged_prior(posterior, posterior @ posterior)
    bodies = pseudo_inertia.to_parameters(point.pseudo_inertias)
    for index, (link, derivative) in enumerate(zip(estimate.links, sensitivity_of_numbers(point), strict=True)):
        block = manifold.link(index)
        scaled = derivative * prior_stds[block]
        prior_std = np.minimum(link.std_prior, np.linalg.norm(scaled, axis=1))
        is_identified = identified(bodies[index], deviations_of(scaled, covariance[block, block]), prior_std)
        yield set(compress(QUANTITIES, is_identified))


def _candidate_motions(model: MeasurementModel, estimate: Estimate) -> Iterator[tuple[str, FloatArray]]:
    """Yield candidate motions, the simplest first, with their rows of the links."""
    yield POSES, _rows(model, instants(model, moving=False), estimate)
    fast = instants(model, moving=True)
    yield FAST, _rows(model, fast, estimate)
    if not model.robot.floating_base:
        yield TILTED, _rows(model.with_gravity(_TILT @ model.robot.gravity), fast, estimate)


def _rows(model: MeasurementModel, samples: Samples, estimate: Estimate) -> FloatArray:
    """Rows ``(<= 10 links, 10 links)`` of standard deviation 1, with the effects eliminated."""
    first, measured = 10 * len(estimate.links), np.isfinite(estimate.sigmas)
    (effects,) = np.nonzero(estimate.parameters[first:])
    used = model.with_coefficients(effects.tolist())
    scaled = used.rows(samples).coefficients[:, measured] / estimate.sigmas[measured, None]
    rows = np.sqrt(_AVERAGED) * scaled.reshape(-1, used.dimension)
    effects_first = np.concatenate([rows[:, first:], rows[:, :first]], axis=1)
    padding = np.zeros((used.dimension, used.dimension))
    return triangular(np.concatenate([effects_first, padding]))[len(effects) :, len(effects) :]


def instants(model: MeasurementModel, *, moving: bool) -> Samples:
    """Samples at random positions of all joints, with random speeds if ``moving``."""
    random, robot = np.random.default_rng(0), model.robot
    turns = random.normal(size=(_INSTANTS, 4))
    base = np.concatenate([np.zeros((_INSTANTS, 3)), turns / np.linalg.norm(turns, axis=1, keepdims=True)], axis=1)
    fastest = np.minimum(_OF_LIMIT * robot.speed_limits, _FASTEST) * moving
    states = random_states(random, _INSTANTS, robot.position_limits, fastest, ACCELERATION_PER_SPEED * fastest)
    still = samples_of(states, len(model.sensors))
    if not robot.floating_base:
        return still
    velocity, acceleration = moving * random.uniform(-1.0, 1.0, (2, _INSTANTS, 6))
    return replace(
        still, base_pose=base, base_velocity=velocity, base_acceleration=ACCELERATION_PER_SPEED * acceleration
    )
