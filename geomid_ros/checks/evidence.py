"""How probable measurements are under a hypothesis, whatever the links, friction and noise are within reason.

For a channel c with targets u (in units of the standard deviation of what was measured, so that a gain costs nothing),
``u = A x + F f + noise``: x are the links' errors, normal with unit variance, of which a channel feels those behind its
joint; f is its own, friction above all (a constant of either sign, the others at least zero). The evidence is the
probability density of u with x and f integrated out; sigma is found per channel by a fixed point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.tolerances import ROUNDS
from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import ONE_BODY, ParameterManifold
from geomid_ros.inference.prior import SPREAD_OF_PAYLOADS, usual_payload
from geomid_ros.model.robot import Robot
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray

LEAST_SIGMA = 0.1
"""Of a channel's standard deviation: no model is believed to be better."""
FRICTION = 5
"""Columns of a channel: a constant, viscous friction, dry friction that sets in at once or slowly, rotor inertia."""
FOLLOWS = 0.6
"""A channel follows the model if no more than this share of its standard deviation is left."""
HALF = 0.5
"""Of a whole: more is most of it."""
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
        friction: ``(C, 5)`` its coefficients, in standard deviations of the measured channels.
        precision: ``(r + C k, r + C k)`` of the links' errors and the channels' own coefficients; 1 of those that are
            held at zero.
    """

    log: float
    sigmas: FloatArray
    links: FloatArray
    friction: FloatArray
    precision: FloatArray

    def deviations(self) -> FloatArray:
        """Standard deviations ``(r,)`` of the links' errors."""
        return np.sqrt(definite.variances(self.precision, len(self.links)))


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What unknowns add to C channels at N instants.

    Attributes:
        links: number r of the links' errors.
        felt: of each channel the errors that it feels ``(m,)``.
        columns: of each channel ``(N, m + k)``: of these, and of the k unknowns that it has for itself.
    """

    links: int
    felt: tuple[IntArray, ...]
    columns: tuple[FloatArray, ...]

    @staticmethod
    def of(links: FloatArray, own: FloatArray) -> Unknowns:
        """Columns ``(N, C, r)`` of the links' errors, and ``(N, C, k)`` that each channel has for itself: others, then
        the five of friction."""
        felt = tuple(map(np.flatnonzero, np.any(links, axis=0)))
        columns = [np.column_stack([links[:, c, own_links], own[:, c]]) for c, own_links in enumerate(felt)]
        return Unknowns(links.shape[2], felt, tuple(columns))

    def part(self, chosen: AnyArray | slice) -> Unknowns:
        """The same at some of the instants, chosen by a mask, an index array or a slice."""
        return replace(self, columns=tuple(own[chosen] for own in self.columns))

    def with_own(self, own: FloatArray) -> Unknowns:
        """The same links, and other columns ``(N, C, k)`` that each channel has for itself."""
        pairs = enumerate(zip(self.felt, self.columns, strict=True))
        columns = [np.column_stack([columns[:, : len(felt)], own[:, c]]) for c, (felt, columns) in pairs]
        return replace(self, columns=tuple(columns))

    def with_more(self, links: FloatArray) -> Unknowns:
        """The same, and columns ``(N, C, j)`` of more errors, which are the last ones."""
        more = [np.flatnonzero(told) for told in np.any(links, axis=0)]
        columns = [
            np.column_stack([columns[:, : len(felt)], links[:, c, new], columns[:, len(felt) :]])
            for c, (felt, new, columns) in enumerate(zip(self.felt, more, self.columns, strict=True))
        ]
        felt = [np.append(own, self.links + new) for own, new in zip(self.felt, more, strict=True)]
        return Unknowns(self.links + links.shape[2], tuple(felt), tuple(columns))

    def times(self, weights: FloatArray) -> Unknowns:
        """Rows times the ``weights (N, C)`` of their channels."""
        return replace(self, columns=tuple(w[:, None] * own for w, own in zip(weights.T, self.columns, strict=True)))

    @cached_property
    def places(self) -> list[IntArray]:
        """The columns of each channel among r + C k unknowns."""
        count = self.columns[0].shape[1] - len(self.felt[0])
        return [np.append(own, self.links + count * c + np.arange(count)) for c, own in enumerate(self.felt)]

    @cached_property
    def products(self) -> list[FloatArray]:
        """The columns of each channel by each other."""
        return [own.T @ own for own in self.columns]

    def taken(self, errors: FloatArray) -> FloatArray:
        """What the links take at errors ``(r,)``, ``(N, C)``."""
        pairs = zip(self.felt, self.columns, strict=True)
        return np.stack([own[:, : len(felt)] @ errors[felt] for felt, own in pairs], axis=1)

    def with_target(self, target: FloatArray, units: FloatArray) -> ChannelProducts:
        """Products of the columns and of a ``target (N, C)``, those of links in ``units (C,)`` of the channels."""
        size, blocks = int(self.places[-1][-1]) + 1, []
        for channel, (felt, own, products) in enumerate(zip(self.felt, self.columns, self.products, strict=True)):
            scales = np.ones(len(products) + 1)
            scales[: len(felt)] /= units[channel]
            block, measured = np.empty((len(scales), len(scales))), target[:, channel]
            block[:-1, :-1], block[-1, -1] = products, measured @ measured
            block[-1, :-1] = block[:-1, -1] = measured @ own
            blocks.append(scales[:, None] * block * scales)
        return ChannelProducts(size + 1, tuple(np.append(own, size) for own in self.places), tuple(blocks))


def evidence(
    target: FloatArray,
    unknowns: Unknowns,
    tolerated: FloatArray,
    *,
    units: FloatArray | float = 1.0,
    counted: FloatArray | None = None,
    either_sign: BoolArray | bool = False,
) -> Evidence:
    """The evidence of a hypothesis.

    Args:
        target: ``(N, C)`` what is measured beside what the URDF's links predict.
        unknowns: what they add.
        units: ``(C,)`` what one of the target is in those of the links' columns.
        tolerated: ``(C, k)`` standard deviations of their coefficients: about what explains all of a channel.
        counted: ``(N, C)`` 1 for the instants that count at a channel, 0 for others; None if all do.
        either_sign: whether viscous and dry friction may be below zero, of all channels or of each ``(C,)``.
    """
    counts = np.full(target.shape[1], float(len(target)))
    if counted is not None:
        unknowns, target, counts = unknowns.times(counted), counted * target, np.maximum(np.sum(counted, axis=0), 1.0)
    sums = unknowns.with_target(target, np.broadcast_to(units, counts.shape))
    rank = unknowns.links
    precision = np.concatenate([np.ones(rank), (1.0 / tolerated**2).ravel()])
    of_own = np.zeros(tolerated.shape, dtype=bool)
    of_own[:, 1 - FRICTION : -1] = ~np.broadcast_to(either_sign, len(tolerated))[:, None]
    of_own[:, -1] = True
    bounded = np.concatenate([np.zeros(rank, dtype=bool), of_own.ravel()])
    held = np.zeros(len(precision), dtype=bool)  # coefficients that are held at zero
    sigmas = np.full(len(tolerated), 0.5)
    # Of efforts next to nothing, beside what the links predict, sums of squares leave their rounding errors.
    least = max(LEAST_SIGMA**2, float(np.finfo(float).eps * np.max(sums.targets / counts)))
    for _ in range(ROUNDS):
        whole = sums.weighed(sigmas**-2.0)
        mean, posterior, held = _solved(whole[:-1, :-1] + np.diag(precision), whole[:-1, -1], bounded, held)
        squares = np.maximum(sums.squares(np.append(mean, -1.0)), 0.0)
        before, sigmas = sigmas, np.sqrt(np.maximum(squares / counts, least))
        if np.all(np.abs(np.log(sigmas / before)) < _SETTLED):
            break
    weighted = float(np.sum(squares / sigmas**2) + precision @ mean**2)
    noise = float(counts @ np.log(2.0 * np.pi * sigmas**2))
    log_determinant = definite.log_determinant(posterior) - float(np.sum(np.log(precision[~held])))
    return Evidence(
        log=-0.5 * (weighted + noise + log_determinant),
        sigmas=sigmas,
        links=mean[:rank],
        friction=mean[rank:].reshape(tolerated.shape)[:, -FRICTION:],
        precision=posterior,
    )


def _solved(
    matrix: FloatArray, right: FloatArray, bounded: BoolArray, held: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The most probable unknowns ``(r + C k,)``, the precision of those that are free, 1 of others, and which are held
    at zero."""
    for _ in range(4):
        before, among = held, matrix.copy()
        among[held] = among[:, held] = 0.0
        among[held, held] = 1.0
        mean = definite.solved_anyway(among, np.where(held, 0.0, right))
        pull = right - matrix @ mean  # of what is held: positive if it would become so
        changed = np.where(held, pull <= 0.0, mean < 0.0) & bounded
        if np.array_equal(changed, held):
            break
        held = changed
    return np.where(bounded, np.maximum(mean, 0.0), mean), among, before


def prior_factor(robot: Robot) -> FloatArray:
    """A factor ``(bodies, 10, 10)`` of the covariance of what the URDF may be wrong by: every link's shape and mass,
    and a payload at each end of a chain."""
    bodies = np.array([body.parameters for body in robot.bodies])
    manifold = ParameterManifold(len(bodies), 0, np.zeros(0))
    blocks, _ = manifold.jacobian(manifold.point(bodies.ravel()))
    covariance = SPREAD**2 * blocks @ blocks.transpose(0, 2, 1)
    for index, body in enumerate(robot.bodies):
        if len(robot.subtree(body.name)) == 1:
            payload = payload_factor(bodies, index)
            covariance[index] += payload @ payload.T
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None])


def payload_factor(bodies: FloatArray, carrier: int) -> FloatArray:
    """A factor ``(10, 10)`` of the covariance of what the link ``carrier`` may carry: robots carry what their URDF does
    not say."""
    blocks, _ = ONE_BODY.jacobian(ONE_BODY.point(usual_payload(bodies, carrier)))
    return np.asarray(SPREAD_OF_PAYLOADS * blocks[0])
