"""How probable measurements are under a hypothesis, whatever the links, friction and noise are within reason.

For a channel c with targets u (in units of the standard deviation of what was measured, so that a gain costs nothing),
``u = A x + F f + noise``: x are the links' errors, normal with unit variance, f friction (a constant of either sign,
the others at least zero). The evidence is the probability density of u with x and f integrated out; sigma is found per
channel by a fixed point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.geometry import definite
from geomid_ros.model.moving import STILL
from geomid_ros.types import BoolArray, FloatArray

LEAST_SIGMA = 0.1
"""Of a channel's standard deviation: no model is believed to be better."""
FOLLOWS = 0.6
"""A channel follows the model if no more than this share of its standard deviation is left."""
_ROUNDS = 12
_SETTLED = 1e-3
_SLOW = 0.05  # of a joint's largest speed: below it stiction holds whatever it likes
SPREAD = 0.7
"""Of links, a geodesic distance, of gains, and of curves in units of a channel: a mass may be half or twice that of the
URDF."""
_FLOOR = np.finfo(float).tiny


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
    # Of efforts next to nothing, beside what the links predict, sums of squares leave their rounding errors.
    least = max(LEAST_SIGMA**2, float(np.finfo(float).eps * np.max(products.squares / products.counts)))
    for _ in range(_ROUNDS):
        mean, posterior, held = _solved(products, sigmas, precision, bounded, held)
        squares = _squares(products, mean)
        before, sigmas = sigmas, np.sqrt(np.maximum(squares / products.counts, least))
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Gain:
    """What more columns explain.

    Attributes:
        per_instant: gain of log evidence [nats].
        ratios: ``(C,)`` of what is left, over what is left without the columns.
        coefficients, deviations: ``(k,)`` of the columns.
        rigid: ``(N, C)`` what the links take beside them.
    """

    per_instant: float
    ratios: FloatArray
    coefficients: FloatArray
    deviations: FloatArray
    rigid: FloatArray

    def beyond(self, other: Gain) -> Gain:
        """What these columns explain more than others do."""
        return replace(self, per_instant=self.per_instant - other.per_instant, ratios=self.ratios / other.ratios)


class FlexibleFit:
    """Links, friction and curves fitted to the efforts of C joints at the instants at which each of them moves."""

    def __init__(
        self,
        *,
        measured: FloatArray,
        predicted: FloatArray,
        columns: FloatArray,
        tolerated: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
    ) -> None:
        """
        Args:
            measured, predicted: ``(N, C)`` the efforts, and those of the URDF's links.
            columns: ``(N, C, r + 4)`` of the links' errors and of friction.
            tolerated: ``(C, 4)`` standard deviations of friction's coefficients.
            position, velocity: ``(N, C)`` of the joints.
        """
        self.measured, self._predicted, self._tolerated = measured, predicted, tolerated
        self.spread = np.std(measured, axis=0)
        links, friction = columns[:, :, :-4], columns[:, :, -4:]
        self._rank = links.shape[2]
        self._moving = moving(velocity).astype(np.float64)
        self._counts = np.maximum(np.sum(self._moving, axis=0), 1.0)
        self.instants = float(np.mean(self._counts))
        """How many instants there are, on average over channels."""
        curves = by_channel(_curves(position, friction, predicted) * self.spread[:, None])
        self._columns = np.concatenate([links, curves], axis=2)
        self._friction = friction
        self._nominal = self._evidence(self._columns)
        self._weights = self._moving / (self.spread * self._nominal.sigmas)
        self._screen()

    @property
    def rigid(self) -> FloatArray:
        """What the fitted links take ``(N, C)``."""
        return self._rigid(self.links)

    @property
    def links(self) -> FloatArray:
        """The links' errors ``(r,)`` that are found."""
        return self._nominal.links[: self._rank]

    @property
    def nominal(self) -> Evidence:
        """The evidence of nothing else."""
        return self._nominal

    def promise(self, columns: FloatArray) -> float:
        """About the least that :meth:`gain` finds, at the noise that is left without the columns [nats per instant].

        Args:
            columns: ``(N, C, k)`` in units of the efforts, per standard deviation of their coefficients.
        """
        rows = (columns * self._weights[:, :, None]).reshape(-1, columns.shape[2])
        coupling = self._known.T @ rows
        sizes, axes = np.linalg.eigh(rows.T @ rows - coupling.T @ coupling)
        precisions = 1.0 + np.maximum(sizes, 0.0)  # of efforts next to nothing rounding leaves sizes below zero
        pull = rows.T @ self._left
        quadratic = float(np.sum((axes.T @ pull) ** 2 / precisions))
        return 0.5 * (quadratic - float(np.sum(np.log(precisions)))) / self.instants

    def gain(self, columns: FloatArray) -> Gain:
        """What columns explain, as :meth:`promise` takes them."""
        found = self._evidence(np.concatenate([self._columns, columns], axis=2))
        return Gain(
            per_instant=(found.log - self._nominal.log) / self.instants,
            ratios=found.sigmas / self._nominal.sigmas,
            coefficients=found.links[self._columns.shape[2] :],
            deviations=found.deviations()[self._columns.shape[2] :],
            rigid=self._rigid(found.links[: self._rank]),
        )

    def _rigid(self, links: FloatArray) -> FloatArray:
        return np.asarray(self._predicted + self._columns[:, :, : self._rank] @ links)

    def _evidence(self, columns: FloatArray) -> Evidence:
        """The evidence of columns ``(N, C, k)`` whose coefficients have unit variance, and friction."""
        scaled = np.concatenate([columns / self.spread[:, None], self._friction], axis=2) * self._moving[:, :, None]
        scaled = scaled.transpose(1, 2, 0)
        target = (self.measured - self._predicted) / self.spread * self._moving
        products = Products(
            counts=self._counts,
            unknowns=scaled @ scaled.transpose(0, 2, 1),
            crossed=(scaled @ target.T[:, :, None])[:, :, 0],
            squares=np.sum(target**2, axis=0),
        )
        return evidence(products, self._tolerated)

    def _screen(self) -> None:
        """Linearise at what was found, with the friction that may have either sign: the constants alone are."""
        offsets = by_channel(np.broadcast_to(self.spread[None, :, None], (*self.measured.shape, 1)))
        friction = by_channel(self._friction[:, :, 1:] * (self._tolerated[:, 1:] * self.spread[:, None]))
        known = np.concatenate([self._columns, offsets, friction], axis=2)
        known = (known * self._weights[:, :, None]).reshape(-1, known.shape[2])
        # By QR, not from products of the columns, which rounding may leave indefinite: efforts may be next to nothing.
        basis, _ = np.linalg.qr(np.concatenate([np.eye(known.shape[1]), known]))
        self._known = basis[known.shape[1] :]
        target = ((self.measured - self._predicted) * self._weights).ravel()
        self._left = target - self._known @ (self._known.T @ target)


def moving(velocity: FloatArray) -> BoolArray:
    """Whether joints move, so that stiction does not hold whatever it likes ``(N, C)``."""
    speed = np.abs(velocity)
    return np.asarray(speed > np.maximum(STILL, _SLOW * np.max(speed, axis=0)))


def by_channel(columns: FloatArray) -> FloatArray:
    """Columns ``(N, C, k)`` that each channel has for itself, as columns ``(N, C, C k)`` of all."""
    instants, channels, count = columns.shape
    spread = np.zeros((instants, channels, channels, count))
    each = np.arange(channels)
    spread[:, each, each] = columns
    return spread.reshape(instants, channels, channels * count)


def _curves(position: FloatArray, friction: FloatArray, predicted: FloatArray) -> FloatArray:
    """What springs, cables and frictions of other laws may add, in standard deviations ``(N, C, 6)``."""
    place = (position - np.mean(position, axis=0)) / np.maximum(np.std(position, axis=0), _FLOOR)
    speed = friction[:, :, 1] / np.maximum(np.std(friction[:, :, 1], axis=0), _FLOOR)
    sign = friction[:, :, 2]
    load = np.abs(predicted - np.mean(predicted, axis=0)) / np.maximum(np.std(predicted, axis=0), _FLOOR)
    bent, cubic = place**2 - 1.0, place**3 - 3.0 * place
    creeping = sign * np.exp(-(speed**2))
    return SPREAD * np.stack([place, bent, cubic, speed * np.abs(speed), creeping, load * sign], axis=2)
