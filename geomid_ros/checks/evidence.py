"""Probability of measurements under a hypothesis, for any plausible links, friction and noise.

For a channel c with targets u (in standard deviations of the measurement, so that a gain costs nothing), ``u = A x + F
f + noise``: x are the links' errors, normal with unit variance, and a channel depends on those outboard of its joint; f
are its separate coefficients, mainly friction (a constant of either sign, the others at least zero). The evidence is
the probability density of u with x and f integrated out; sigma is found per channel by a fixed point.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.tolerances import ROUNDS, SETTLED
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ONE_BODY, ParameterManifold
from geomid_ros.inference.prior import PAYLOAD_PRIOR_STD, default_payload
from geomid_ros.model.robot import Robot
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray

LEAST_SIGMA = 0.1
"""Smallest credible residual, relative to a channel's standard deviation."""
FRICTION = 5
"""Columns of a channel: a constant, viscous friction, dry friction that sets in at once or gradually, rotor inertia."""
LARGEST_RESIDUAL = 0.6
"""Largest residual of a channel that follows the model, as a fraction of its standard deviation."""
MOST = 0.5
"""Fraction of a whole: more is most of it."""
PRIOR_STD = 0.7
"""Prior standard deviation of links (a geodesic distance), of gains, and of curves in units of a channel: a mass may be
half or twice that of the URDF."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Evidence of a hypothesis, and its fit.

    Attributes:
        log_evidence: the log evidence.
        sigmas: ``(C,)`` of the residuals in motion, in standard deviations of the measured channels.
        sticking_sigmas: ``(C,)`` those where a joint sticks, but no smaller ones.
        link_errors: ``(r,)`` the links' errors.
        friction: ``(C, 5)`` its coefficients, in standard deviations of the measured channels.
        precision: ``(r + C k, r + C k)`` of the links' errors and the channels' separate coefficients; 1 for those
            fixed at zero.
        estimates, estimate_deviations: ``(k,)`` sizes of a fault that were estimated with it, and their standard
            deviations.
    """

    log_evidence: float
    sigmas: FloatArray
    sticking_sigmas: FloatArray
    link_errors: FloatArray
    friction: FloatArray
    precision: FloatArray
    estimates: FloatArray = field(default_factory=lambda: np.zeros(0))
    estimate_deviations: FloatArray = field(default_factory=lambda: np.zeros(0))

    def deviations(self) -> FloatArray:
        """Standard deviations ``(r,)`` of the links' errors."""
        return np.sqrt(spd.variances(self.precision, len(self.link_errors)))


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Columns of unknowns in C channels at N samples.

    Attributes:
        links: number r of the links' errors.
        affected_by: by channel, the errors on which it depends ``(m,)``.
        columns: by channel ``(N, m + k)``: those of these errors, and of its k separate unknowns.
        sticking: ``(N, C)`` 1 where a channel's joint sticks: its dry friction has any value within its limits.
    """

    links: int
    affected_by: tuple[IntArray, ...]
    columns: tuple[FloatArray, ...]
    sticking: FloatArray

    @staticmethod
    def of(links: FloatArray, own: FloatArray, sticking: FloatArray | None = None) -> Unknowns:
        """Create from columns ``(N, C, r)`` of the links' errors, and separate ones ``(N, C, k)`` of each channel:
        any others, and last the five of friction. By default nothing sticks."""
        felt = tuple(map(np.flatnonzero, np.any(links, axis=0)))
        columns = [np.column_stack([links[:, c, errors], own[:, c]]) for c, errors in enumerate(felt)]
        sticking = np.zeros(links.shape[:2]) if sticking is None else sticking
        return Unknowns(links.shape[2], felt, tuple(columns), sticking)

    def select(self, chosen: AnyArray | slice) -> Unknowns:
        """Return the columns at some of the samples, chosen by a mask, an index array or a slice."""
        columns = tuple(columns[chosen] for columns in self.columns)
        return replace(self, columns=columns, sticking=self.sticking[chosen])

    def with_separate(self, own: FloatArray) -> Unknowns:
        """Replace the separate columns of each channel by others ``(N, C, k)``."""
        pairs = enumerate(zip(self.affected_by, self.columns, strict=True))
        columns = [np.column_stack([columns[:, : len(felt)], own[:, c]]) for c, (felt, columns) in pairs]
        return replace(self, columns=tuple(columns))

    def with_errors(self, links: FloatArray) -> Unknowns:
        """Append columns ``(N, C, j)`` of further errors."""
        added = [np.flatnonzero(affected) for affected in np.any(links, axis=0)]
        columns = [
            np.column_stack([columns[:, : len(felt)], links[:, c, further], columns[:, len(felt) :]])
            for c, (felt, further, columns) in enumerate(zip(self.affected_by, added, self.columns, strict=True))
        ]
        felt = [
            np.append(errors, self.links + further) for errors, further in zip(self.affected_by, added, strict=True)
        ]
        return Unknowns(self.links + links.shape[2], tuple(felt), tuple(columns), self.sticking)

    def times(self, weights: FloatArray) -> Unknowns:
        """Multiply rows by the ``weights (N, C)`` of their channels."""
        return replace(self, columns=tuple(w[:, None] * rows for w, rows in zip(weights.T, self.columns, strict=True)))

    @cached_property
    def places(self) -> list[IntArray]:
        """Index of each channel's columns among r + C k unknowns."""
        count = self.columns[0].shape[1] - len(self.affected_by[0])
        return [np.append(felt, self.links + count * c + np.arange(count)) for c, felt in enumerate(self.affected_by)]

    @property
    def parts(self) -> FloatArray:
        """Samples ``(2, N, C)`` of each channel in motion, and where its joint sticks: 1 there, 0 at others."""
        return np.stack([1.0 - self.sticking, self.sticking])

    @cached_property
    def products(self) -> list[list[FloatArray]]:
        """Products of each channel's columns, in motion and where its joint sticks."""
        return [
            [columns.T @ (part[:, None] * columns) for part, columns in zip(parts.T, self.columns, strict=True)]
            for parts in self.parts
        ]

    def link_efforts(self, errors: FloatArray) -> FloatArray:
        """Efforts of the links ``(N, C)`` at errors ``(r,)``."""
        pairs = zip(self.affected_by, self.columns, strict=True)
        return np.stack([columns[:, : len(felt)] @ errors[felt] for felt, columns in pairs], axis=1)

    def with_target(self, target: FloatArray, units: FloatArray) -> ChannelProducts:
        """Products of the columns and of a ``target (N, C)``, of all channels in motion, then where their joints stick;
        links' columns are divided by ``units (C,)``."""
        size, blocks = int(self.places[-1][-1]) + 1, []
        places = [np.append(columns, size) for columns in self.places]
        for part, products in zip(self.parts, self.products, strict=True):
            for channel, (felt, columns) in enumerate(zip(self.affected_by, self.columns, strict=True)):
                scales = np.ones(len(products[channel]) + 1)
                scales[: len(felt)] /= units[channel]
                block, measured = np.empty((len(scales), len(scales))), part[:, channel] * target[:, channel]
                block[:-1, :-1], block[-1, -1] = products[channel], measured @ measured
                block[-1, :-1] = block[:-1, -1] = measured @ columns
                blocks.append(scales[:, None] * block * scales)
        return ChannelProducts(size + 1, (*places, *places), tuple(blocks))


def evidence(
    target: FloatArray,
    unknowns: Unknowns,
    tolerated: FloatArray,
    *,
    units: FloatArray | float = 1.0,
    counted: FloatArray | None = None,
    either_sign: BoolArray | bool = False,
    least: float = LEAST_SIGMA,
) -> Evidence:
    """Compute the evidence of a hypothesis.

    Args:
        target: ``(N, C)`` measurement minus prediction of the URDF's links.
        unknowns: their columns.
        units: ``(C,)`` one unit of the target, in those of the links' columns.
        tolerated: ``(C, k)`` prior standard deviations of the coefficients: about what explains all of a channel.
        counted: ``(N, C)`` 1 for the samples that count at a channel, 0 for others; None if all do.
        either_sign: True if viscous and dry friction may be negative, of all channels or of each ``(C,)``.
        least: smallest credible residual.
    """
    counts = np.sum(unknowns.parts * (1.0 if counted is None else counted), axis=1)
    if counted is not None:
        unknowns, target = unknowns.times(counted), counted * target
    sums = unknowns.with_target(target, np.broadcast_to(units, target.shape[1]))
    rank = unknowns.links
    precision = np.concatenate([np.ones(rank), (1.0 / tolerated**2).ravel()])
    nonnegative = np.zeros(tolerated.shape, dtype=bool)
    nonnegative[:, 1 - FRICTION : -1] = ~np.broadcast_to(either_sign, len(tolerated))[:, None]
    nonnegative[:, -1] = True
    bounded = np.concatenate([np.zeros(rank, dtype=bool), nonnegative.ravel()])
    fixed, unknown = np.zeros(len(precision), dtype=bool), np.arange(len(precision))  # none is fixed at zero yet
    sigmas = np.full(counts.shape, 0.5)
    # If efforts are tiny relative to the links' prediction, sums of squares are rounding errors.
    least = max(least**2, float(np.finfo(float).eps * np.max(sums.targets / np.maximum(counts, 1.0).ravel())))
    for _ in range(ROUNDS):
        total = sums.weighed(sigmas.ravel() ** -2.0)
        total[unknown, unknown] += precision
        mean, posterior, fixed = _solve_bounded(total[:-1, :-1], total[:-1, -1], bounded, fixed)
        squares = np.maximum(sums.squares(np.append(mean, -1.0)), 0.0).reshape(counts.shape)
        friction = mean[rank:].reshape(tolerated.shape)[:, -FRICTION:]
        dry = np.maximum(np.sum(friction[:, 2:4], axis=1), 0.0)
        previous, sigmas = sigmas, _sigmas(squares, counts, dry, least, sigmas)
        if np.all(np.abs(np.log(sigmas / previous)) < SETTLED):
            break
    weighted = float(np.sum(squares / sigmas**2) + precision @ mean**2)
    noise = float(np.sum(counts * np.log(2.0 * np.pi * sigmas**2)))
    log_determinant = spd.log_determinant(posterior) - float(np.sum(np.log(precision[~fixed])))
    return Evidence(
        log_evidence=-0.5 * (weighted + noise + log_determinant),
        sigmas=sigmas[0],
        sticking_sigmas=np.maximum(np.sqrt(squares[1] / np.maximum(counts[1], 1.0)), sigmas[0]),
        link_errors=mean[:rank],
        friction=friction,
        precision=posterior,
    )


def _sigmas(squares: FloatArray, counts: FloatArray, dry: FloatArray, least: float, before: FloatArray) -> FloatArray:
    """Standard deviations of the noise ``(2, C)``, in motion and where joints stick: there it includes their dry
    friction, which has any value up to its level of either sign, with equal probability.

    Args:
        squares: ``(2, C)`` sums of the squared residuals, in motion and where joints stick.
        counts: ``(2, C)`` numbers of these samples.
        dry: ``(C,)`` level of dry friction; unknown where a joint does not move.
        least: smallest variance.
        before: ``(2, C)`` the standard deviations of the last round, which weight the samples.
    """
    sticking = np.where(counts[0] > 0.0, dry**2 / 3.0, 0.0)
    share = before[0] ** 2 / (before[0] ** 2 + sticking)
    common = (squares[0] + share**2 * squares[1]) / np.maximum(counts[0] + share * counts[1], 1.0)
    common = np.maximum(common, least)
    return np.asarray(np.sqrt([common, common + sticking]))


def _solve_bounded(
    matrix: FloatArray, right: FloatArray, bounded: BoolArray, fixed: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the most probable unknowns ``(r + C k,)``, the precision of free ones (1 for others), and which are
    fixed."""
    for _ in range(4):
        previous, free = fixed, matrix.copy()
        free[fixed] = free[:, fixed] = 0.0
        free[fixed, fixed] = 1.0
        mean = spd.solve_or_least_squares(free, np.where(fixed, 0.0, right))
        gradient = right - matrix @ mean  # of a fixed one: positive if it would become positive
        changed = np.where(fixed, gradient <= 0.0, mean < 0.0) & bounded
        if np.array_equal(changed, fixed):
            break
        fixed = changed
    return np.where(bounded, np.maximum(mean, 0.0), mean), free, previous


def follows(correlations: FloatArray) -> BoolArray:
    """True for channels that follow the model, by their correlations with it ``(C,)``."""
    return np.asarray(correlations > np.sqrt(1.0 - LARGEST_RESIDUAL**2))


def prior_factor(robot: Robot) -> FloatArray:
    """Factor ``(bodies, 10, 10)`` of the URDF's error covariance: each link's shape and mass, payloads at chain
    ends."""
    bodies = np.array([body.parameters for body in robot.bodies])
    manifold = ParameterManifold(len(bodies), 0, np.zeros(0))
    blocks, _ = manifold.jacobian(manifold.point(bodies.ravel()))
    covariance = PRIOR_STD**2 * blocks @ blocks.transpose(0, 2, 1)
    for index, body in enumerate(robot.bodies):
        if len(robot.subtree(body.name)) == 1:
            payload = payload_factor(bodies, index)
            covariance[index] += payload @ payload.T
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None])


def payload_factor(bodies: FloatArray, carrier: int) -> FloatArray:
    """Factor ``(10, 10)`` of the covariance of a payload on the link ``carrier``, which the URDF does not contain."""
    blocks, _ = ONE_BODY.jacobian(ONE_BODY.point(default_payload(bodies, carrier)))
    return np.asarray(PAYLOAD_PRIOR_STD * blocks[0])
