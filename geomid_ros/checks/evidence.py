"""How probable measurements are under a hypothesis, whatever the links, friction and noise are within reason.

For a channel c with targets u (in units of the standard deviation of what was measured, so that a gain costs nothing),
``u = A x + F f + noise``: x are the links' errors, normal with unit variance, f friction (a constant of either sign,
the others at least zero). The evidence is the probability density of u with x and f integrated out; sigma is found per
channel by a fixed point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import ONE_BODY, ParameterManifold
from geomid_ros.inference.prior import SPREAD_OF_PAYLOADS, usual_payload
from geomid_ros.model.robot import Robot
from geomid_ros.types import BoolArray, FloatArray

LEAST_SIGMA = 0.1
"""Of a channel's standard deviation: no model is believed to be better."""
FOLLOWS = 0.6
"""A channel follows the model if no more than this share of its standard deviation is left."""
HALF = 0.5
"""Of a whole: more is most of it."""
_ROUNDS = 12
_SETTLED = 1e-3
SPREAD = 0.7
"""Of links, a geodesic distance, of gains, and of curves in units of a channel: a mass may be half or twice that of the
URDF."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """What a hypothesis explains.

    Attributes:
        log: the log evidence.
        sigmas: ``(C,)`` of what is left, in standard deviations of the measured channels.
        links: ``(r,)`` the links' errors.
        friction: ``(C, 4)`` its coefficients, in standard deviations of the measured channels.
        precision: ``(r + k, r + k)`` of the links' errors and of friction's coefficients that are not held at zero.
    """

    log: float
    sigmas: FloatArray
    links: FloatArray
    friction: FloatArray
    precision: FloatArray

    def deviations(self) -> FloatArray:
        """Standard deviations ``(r,)`` of the links' errors."""
        variances = np.diag(definite.inverse(self.precision))[: len(self.links)]
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))  # rounding may leave next to nothing, of either sign


def evidence(
    target: FloatArray,
    columns: FloatArray,
    friction: FloatArray,
    tolerated: FloatArray,
    *,
    counted: FloatArray | None = None,
    either_sign: bool = False,
) -> Evidence:
    """The evidence of a hypothesis.

    Args:
        target: ``(N, C)`` what is measured beside what the URDF's links predict.
        columns: ``(N, C, r)`` of the links' errors.
        friction: ``(N, C, 4)`` its columns.
        tolerated: ``(C, 4)`` standard deviations of friction's coefficients: about what explains all of a channel.
        counted: ``(N, C)`` 1 for the instants that count at a channel, 0 for others; None if all do.
        either_sign: whether viscous and dry friction may be below zero.
    """
    sums = _Sums.of(target, np.concatenate([columns, friction], axis=2), counted)
    rank = sums.rank
    precision = np.concatenate([np.ones(rank), (1.0 / tolerated**2).ravel()])
    of_friction = [False, not either_sign, not either_sign, True]
    bounded = np.concatenate([np.zeros(rank, dtype=bool), np.tile(of_friction, len(tolerated))])
    held = np.zeros(len(precision), dtype=bool)  # coefficients that are held at zero
    sigmas = np.full(len(tolerated), 0.5)
    # Of efforts next to nothing, beside what the links predict, sums of squares leave their rounding errors.
    least = max(LEAST_SIGMA**2, float(np.finfo(float).eps * np.max(sums.squares / sums.counts)))
    for _ in range(_ROUNDS):
        mean, posterior, held = _solved(*sums.normal_equations(sigmas**-2.0, precision), bounded, held)
        squares = sums.left(mean)
        before, sigmas = sigmas, np.sqrt(np.maximum(squares / sums.counts, least))
        if np.all(np.abs(np.log(sigmas / before)) < _SETTLED):
            break
    weighted = float(np.sum(squares / sigmas**2) + precision @ mean**2)
    noise = float(sums.counts @ np.log(2.0 * np.pi * sigmas**2))
    log_determinant = float(np.linalg.slogdet(posterior)[1] - np.sum(np.log(precision[~held])))
    return Evidence(
        log=-0.5 * (weighted + noise + log_determinant),
        sigmas=sigmas,
        links=mean[:rank],
        friction=mean[rank:].reshape(tolerated.shape),
        precision=posterior,
    )


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over instants: how many there are at each channel ``counts (C,)``, products of the columns, r of the links
    and four of friction, ``unknowns (C, r + 4, r + 4)``, with the target ``crossed (C, r + 4)``, and its ``squares
    (C,)``."""

    counts: FloatArray
    unknowns: FloatArray
    crossed: FloatArray
    squares: FloatArray

    @staticmethod
    def of(target: FloatArray, columns: FloatArray, counted: FloatArray | None) -> _Sums:
        counts = np.full(target.shape[1], float(len(target)))
        if counted is not None:
            counts = np.maximum(np.sum(counted, axis=0), 1.0)
            target, columns = counted * target, counted[:, :, None] * columns
        rows = columns.transpose(1, 2, 0)
        crossed = (rows @ target.T[:, :, None])[:, :, 0]
        return _Sums(counts, rows @ rows.transpose(0, 2, 1), crossed, np.sum(target**2, axis=0))

    @property
    def rank(self) -> int:
        return int(self.crossed.shape[1]) - 4

    def normal_equations(self, weights: FloatArray, precision: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Their matrix ``(r + 4 C, r + 4 C)`` and right side ``(r + 4 C,)``, for weights of the channels ``(C,)``."""
        channels, rank = len(weights), self.rank
        weighted, right = weights[:, None, None] * self.unknowns, weights[:, None] * self.crossed
        matrix = np.diag(precision)
        matrix[:rank, :rank] += np.sum(weighted[:, :rank, :rank], axis=0)
        matrix[rank:, :rank] = weighted[:, rank:, :rank].reshape(-1, rank)
        matrix[:rank, rank:] = matrix[rank:, :rank].T
        own, each = matrix[rank:, rank:].reshape(channels, 4, channels, 4), np.arange(channels)
        own[each, :, each] += weighted[:, rank:, rank:]
        return matrix, np.concatenate([np.sum(right[:, :rank], axis=0), right[:, rank:].ravel()])

    def left(self, mean: FloatArray) -> FloatArray:
        """The sum of squares that unknowns ``(r + 4 C,)`` leave at each channel ``(C,)``."""
        channels, rank = len(self.counts), self.rank
        unknowns = np.column_stack([np.tile(mean[:rank], (channels, 1)), mean[rank:].reshape(channels, 4)])
        half = (self.unknowns @ unknowns[:, :, None])[:, :, 0] - 2.0 * self.crossed
        return np.asarray(np.maximum(self.squares + np.sum(unknowns * half, axis=1), 0.0))


def _solved(
    matrix: FloatArray, right: FloatArray, bounded: BoolArray, held: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The most probable unknowns ``(r + 4 C,)``, the precision of those that are free, and which are held at zero."""
    for _ in range(4):
        before = held
        free = np.flatnonzero(~held)
        among = matrix[free[:, None], free]
        mean = np.zeros(len(right))
        mean[free] = definite.solved_anyway(among, right[free])
        pull = right - matrix @ mean  # of what is held: positive if it would become so
        changed = np.where(held, pull <= 0.0, mean < 0.0) & bounded
        if np.array_equal(changed, held):
            break
        held = changed
    return np.where(bounded, np.maximum(mean, 0.0), mean), among, before


def prior_factor(robot: Robot) -> FloatArray:
    """A factor ``(D, D)`` of the covariance of what the URDF may be wrong by: every link's shape and mass, and a
    payload at each end of a chain."""
    bodies = np.array([body.parameters for body in robot.bodies])
    manifold = ParameterManifold(len(bodies), 0, np.zeros(0))
    blocks, _ = manifold.jacobian(manifold.point(bodies.ravel()))
    factor = np.zeros((bodies.size, bodies.size))
    for index, body in enumerate(robot.bodies):
        covariance = (SPREAD * blocks[index]) @ (SPREAD * blocks[index]).T
        if len(robot.subtree(body.name)) == 1:
            payload = payload_factor(bodies, index)
            covariance += payload @ payload.T
        values, vectors = np.linalg.eigh(covariance)
        factor[10 * index : 10 * index + 10, 10 * index : 10 * index + 10] = vectors * np.sqrt(np.maximum(values, 0.0))
    return factor


def payload_factor(bodies: FloatArray, carrier: int) -> FloatArray:
    """A factor ``(10, 10)`` of the covariance of what the link ``carrier`` may carry: robots carry what their URDF does
    not say."""
    blocks, _ = ONE_BODY.jacobian(ONE_BODY.point(usual_payload(bodies, carrier)))
    return np.asarray(SPREAD_OF_PAYLOADS * blocks[0])
