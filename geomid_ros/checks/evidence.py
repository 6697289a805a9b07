"""How probable measurements are under a hypothesis, whatever the links, friction and noise are within reason.

For a channel c with targets u (in units of the standard deviation of what was measured, so that a gain costs nothing),
``u = A x + F f + noise``: x are the links' errors, normal with unit variance, f friction (a constant of either sign,
the others at least zero). The evidence is the probability density of u with x and f integrated out; sigma is found per
channel by a fixed point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.geometry import definite
from geomid_ros.types import BoolArray, FloatArray

LEAST_SIGMA = 0.1
"""Of a channel's standard deviation: no model is believed to be better."""
SURE = 3.0
"""Standard deviations within which sizes agree."""
_ROUNDS = 12
_SETTLED = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class Products:
    """Sums over instants of products, by channel: all that the evidence needs.

    Attributes:
        counts: ``(C,)`` instants.
        unknowns: ``(C, r + 4, r + 4)`` of the columns: r of the links, four of friction.
        crossed: ``(C, r + 4)`` of the columns and the targets.
        squares: ``(C,)`` of the targets.
    """

    counts: FloatArray
    unknowns: FloatArray
    crossed: FloatArray
    squares: FloatArray

    @cached_property
    def of_links(self) -> FloatArray:
        """Those of the links' columns ``(C, r r)``."""
        rank = self.crossed.shape[1] - 4
        return self.unknowns[:, :rank, :rank].reshape(len(self.counts), -1)


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


def evidence(products: Products, tolerated: FloatArray, *, either_sign: bool = False) -> Evidence:
    """The evidence of a hypothesis.

    Args:
        products: of the columns and targets that it says.
        tolerated: ``(C, 4)`` standard deviations of friction's coefficients: about what explains all of a channel.
        either_sign: whether viscous and dry friction may be below zero.
    """
    channels, size = products.crossed.shape
    rank = size - 4
    precision = np.concatenate([np.ones(rank), (1.0 / tolerated**2).ravel()])
    of_friction = [False, not either_sign, not either_sign, True]
    bounded = np.concatenate([np.zeros(rank, dtype=bool), np.tile(of_friction, channels)])
    held = np.zeros(len(precision), dtype=bool)  # coefficients that are held at zero
    sigmas = np.full(channels, 0.5)
    for _ in range(_ROUNDS):
        mean, posterior, held = _solved(products, sigmas, precision, bounded, held)
        squares = _squares(products, mean)
        before, sigmas = sigmas, np.sqrt(np.maximum(squares / products.counts, LEAST_SIGMA**2))
        if np.all(np.abs(np.log(sigmas / before)) < _SETTLED):
            break
    weighted = float(np.sum(squares / sigmas**2) + precision @ mean**2)
    noise = float(products.counts @ np.log(2.0 * np.pi * sigmas**2))
    log_determinant = float(np.linalg.slogdet(posterior)[1] - np.sum(np.log(precision[~held])))
    return Evidence(
        log=-0.5 * (weighted + noise + log_determinant),
        sigmas=sigmas,
        links=mean[:rank],
        friction=mean[rank:].reshape(channels, 4),
        precision=posterior,
    )


def _solved(
    products: Products, sigmas: FloatArray, precision: FloatArray, bounded: BoolArray, held: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The most probable unknowns ``(r + 4 C,)``, the precision of those that are free, and which are held at zero."""
    matrix, right = _normal_equations(products, sigmas**-2.0, precision)
    for _ in range(4):
        before = held
        free = np.flatnonzero(~held)
        among = matrix[free[:, None], free] if np.any(held) else matrix
        mean = np.zeros(len(precision))
        mean[free] = definite.solved_anyway(among, right[free])
        pull = right - matrix @ mean  # of what is held: positive if it would become so
        changed = np.where(held, pull <= 0.0, mean < 0.0) & bounded
        if np.array_equal(changed, held):
            break
        held = changed
    return np.where(bounded, np.maximum(mean, 0.0), mean), among, before


def _normal_equations(products: Products, weights: FloatArray, precision: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Their matrix ``(r + 4 C, r + 4 C)`` and right side ``(r + 4 C,)``, for weights of the channels ``(C,)``."""
    channels, size = products.crossed.shape
    rank = size - 4
    matrix, right = np.diag(precision), np.empty(len(precision))
    matrix[:rank, :rank] += (weights @ products.of_links).reshape(rank, rank)
    coupling = (weights[:, None, None] * products.unknowns[:, rank:, :rank]).reshape(-1, rank)
    matrix[rank:, :rank], matrix[:rank, rank:] = coupling, coupling.T
    own = matrix[rank:, rank:].reshape(channels, 4, channels, 4)
    each = np.arange(channels)
    own[each, :, each] += weights[:, None, None] * products.unknowns[:, rank:, rank:]
    right[:rank] = weights @ products.crossed[:, :rank]
    right[rank:] = (weights[:, None] * products.crossed[:, rank:]).ravel()
    return matrix, right


def _squares(products: Products, mean: FloatArray) -> FloatArray:
    """The sum of squares that is left at each channel ``(C,)``."""
    channels, size = products.crossed.shape
    rank = size - 4
    unknowns = np.empty((channels, size))
    unknowns[:, :rank], unknowns[:, rank:] = mean[:rank], mean[rank:].reshape(channels, 4)
    half = (products.unknowns @ unknowns[:, :, None])[:, :, 0] - 2.0 * products.crossed
    left = products.squares + np.sum(unknowns * half, axis=1)
    return np.asarray(np.maximum(left, 0.0))
