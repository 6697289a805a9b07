"""Suggested motions: which would identify what a recording does not, tried on the estimated model.

What instants of a motion would say is added to what the data say of all links together. The effects' coefficients are
taken as unknown in every motion, so that what only an effect could be is not put down to a link.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import compress

import numpy as np

from geomid_ros.estimation.channel_products import triangular
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimate_parts import deviations_of, sensitivity_of_numbers
from geomid_ros.estimation.uncertain_inertia import QUANTITIES, identified
from geomid_ros.estimation.uncertainty import doubted
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import ACCELERATION_PER_SPEED, Samples, random_states, samples_of
from geomid_ros.types import FloatArray

_INSTANTS = 80
_AVERAGED = 10.0  # independent measurements that an instant stands for: a second of a pose, or of a motion
_FASTEST = 2.0  # [rad/s, m/s]
_OF_LIMIT = 0.5  # of the speed that a joint may have
_TILT = np.array([[1.0, 0.0, 0.0], [0.0, np.sqrt(0.5), -np.sqrt(0.5)], [0.0, np.sqrt(0.5), np.sqrt(0.5)]])

POSES = "standing still in many poses"
FAST = "fast motion of all joints at once"
TILTED = "fast motion of all joints with a tilted base"


def suggested_motions(model: MeasurementModel, estimate: Estimate) -> dict[str, dict[str, list[str]]]:
    """What would tell the quantities that an estimate's data do not tell.

    Returns:
        By link, and by motion, the quantities that this motion would tell and no simpler one before it does; under
        an empty name those that none tells. Nothing of outliers: more motion does not tell what they stand in for.
    """
    left = {link.name: [] if link.outlier else list(link.cannot_tell) for link in estimate.links}
    found: dict[str, dict[str, list[str]]] = {name: {} for name in left}
    if not any(left.values()):
        return found
    problem = _KnownLinks(estimate)
    for motion, rows in _tried(model, estimate):
        for link, told in zip(estimate.links, problem.told_with(rows), strict=True):
            now = [quantity for quantity in left[link.name] if quantity in told]
            if now:
                found[link.name][motion] = now
                left[link.name] = [quantity for quantity in left[link.name] if quantity not in now]
    for name, quantities in left.items():
        if quantities:
            found[name][""] = quantities
    return found


class _KnownLinks:
    """The information of an estimate's data on all links together, and the prior."""

    def __init__(self, estimate: Estimate) -> None:
        self._of_prior = [link.std_prior for link in estimate.links]
        self._manifold = ParameterManifold(len(estimate.links), 0, np.zeros(0))
        self._point: Point = self._manifold.point(estimate.parameters[self._manifold.inertial])
        self._spreads = np.repeat(estimate.spreads, 10)
        self._sensitivity = sensitivity_of_numbers(self._point)
        self._rows = self._scaled(estimate.information.rows)

    def _scaled(self, rows: FloatArray) -> FloatArray:
        """Rows by tangent coordinates in units of their prior deviations."""
        return np.asarray(self._manifold.whiten(self._point, rows) * self._spreads)

    def told_with(self, rows: FloatArray) -> list[set[str]]:
        """The quantities of each link that are told with further rows ``(N, 10 links)`` of standard deviation 1."""
        both = np.concatenate([self._rows, self._scaled(rows)])
        posterior = np.linalg.inv(np.eye(both.shape[1]) + both.T @ both)
        covariance = doubted(posterior, posterior @ posterior)
        bodies = pseudo_inertia.to_parameters(self._point.pseudo_inertias)
        told = []
        for index, derivative in enumerate(self._sensitivity):
            block = self._manifold.link(index)
            scaled = derivative * self._spreads[block]
            of_prior = np.minimum(self._of_prior[index], np.linalg.norm(scaled, axis=1))
            known = identified(bodies[index], deviations_of(scaled, covariance[block, block]), of_prior)
            told.append(set(compress(QUANTITIES, known)))
        return told


def _tried(model: MeasurementModel, estimate: Estimate) -> Iterator[tuple[str, FloatArray]]:
    """Motions, the simplest first, with what their rows say of the links."""
    yield POSES, _rows(model, instants(model, moving=False), estimate)
    fast = instants(model, moving=True)
    yield FAST, _rows(model, fast, estimate)
    if not model.robot.floating_base:
        yield TILTED, _rows(model.with_gravity(_TILT @ model.robot.gravity), fast, estimate)


def _rows(model: MeasurementModel, samples: Samples, estimate: Estimate) -> FloatArray:
    """Rows ``(<= 10 links, 10 links)`` of standard deviation 1 from which the effects are eliminated."""
    measured = np.isfinite(estimate.sigmas)
    scaled = model.rows(samples).coefficients[:, measured] / estimate.sigmas[measured, None]
    rows = np.sqrt(_AVERAGED) * scaled.reshape(-1, model.dimension)
    first = 10 * len(estimate.links)
    effects = first + np.flatnonzero(estimate.parameters[first:])
    whole = np.concatenate([rows[:, effects], rows[:, :first]], axis=1)
    return triangular(np.concatenate([whole, np.zeros((whole.shape[1], whole.shape[1]))]))[
        len(effects) :, len(effects) :
    ]


def instants(model: MeasurementModel, *, moving: bool) -> Samples:
    """Instants at random positions of all joints, with random speeds if they move."""
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
