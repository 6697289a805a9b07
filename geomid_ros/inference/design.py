"""Products of all columns that compete to explain each channel, with the remainder integrated out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from typing import Any, Protocol, TypeVar

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.profile_objective import LEAST_SHARE
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.remainder import Marginal, Remainder
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

_Owner = TypeVar("_Owner", bound="Remembering")
_Key = TypeVar("_Key")
_Value = TypeVar("_Value")
BLOCKS = 8  # of time; their scatter shows how dependent the rows are
_LEAST_SIZE = 1e-4  # mean square of whitened features: those that hardly occur are not scaled up


class ChannelRows:
    """Whitened rows of a channel: ``columns (N, K + 1)``, the target last, and ``features (N, m)`` of the remainder in
    their ``block (m,)``. The features are ``scale (m,)`` times the given ones: a draw of a block with variance 1 has a
    mean square of 1. ``place`` and ``links (D,)``: indices of the terms and of the inertial columns of all channels, -1
    if absent. Given other recordings, the features' coefficients have the covariance ``prior_covariance``, see
    :class:`Remainder`, and the mean ``prior_mean (m,)``, which is taken off the target."""

    def __init__(
        self,
        columns: FloatArray,
        features: FloatArray,
        block: IntArray,
        place: Mapping[EffectTerm, int],
        links: IntArray,
        before: FloatArray | None = None,
        expected: FloatArray | None = None,
    ) -> None:
        """Create from features of any scale, whose coefficients have the covariance ``before (m, m)`` and the mean
        ``expected (m,)``."""
        self.columns, self.block, self.place, self.links = columns, block, place, links
        sizes = np.bincount(block, np.sum(features**2, axis=0)) / max(len(columns), 1)
        self.scale = 1.0 / np.sqrt(np.maximum(sizes, _LEAST_SIZE))[block]
        self.features = features * self.scale
        self.prior_covariance = None if before is None else before / np.outer(self.scale, self.scale)
        self.prior_mean = None if expected is None else expected / self.scale
        self._last: tuple[bytes, Marginal] | None = None

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.columns)

    @cached_property
    def products(self) -> FloatArray:
        """Products of the columns ``(K + 2, K + 2)``; the last row is zero and stands for absent columns."""
        return np.pad(self.columns.T @ self.columns, ((0, 1), (0, 1)))

    @cached_property
    def present(self) -> BoolArray:
        """True for the columns ``(K + 2,)`` that affect the channel."""
        return np.asarray(np.diag(self.products) > 0.0)

    @cached_property
    def remainder(self) -> Remainder:
        """Products with the features."""
        crossed = np.pad(self.features.T @ self.columns, ((0, 0), (0, 1)))
        return Remainder(self.features.T @ self.features, crossed, self.block, self.count, self.prior_covariance)

    def marginalised(self, variances: FloatArray) -> Marginal:
        """Integrate the remainder out; the last products are kept, because most designs differ in few channels."""
        key = variances.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.remainder.marginalised(self.products, variances)
        return self._last[1]

    def whitened(self, vector: FloatArray, taken: IntArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the columns ``(N, n)`` that are ``taken`` and their sum weighted by ``vector (n,)``, both whitened
        given the remainder."""
        padded = np.pad(self.columns, ((0, 0), (0, 1)))[:, taken]
        rows = np.column_stack([padded, padded @ vector])
        if len(self.block):
            drawn = self.features @ self.remainder.root(variances)
            directions, sizes, _ = np.linalg.svd(drawn, full_matrices=False)
            rows -= directions @ ((1.0 - 1.0 / np.sqrt(1.0 + sizes**2))[:, None] * (directions.T @ rows))
        return rows[:, :-1], rows[:, -1]


@dataclass(frozen=True, eq=False)
class RemainderFit:
    """Remainder of a channel: ``coefficients (m,)`` of the given features, the ``triangle (m, m)`` T with their
    covariance ``T'T``, the fraction of the residual's squares that it ``explained``, and the effective number of
    parameters, ``freedom``. ``power`` is its sum of squares; given other recordings, that of the new part if this is
    less."""

    coefficients: FloatArray
    triangle: FloatArray
    explained: float
    power: float
    freedom: float


@dataclass(frozen=True, eq=False)
class CandidateProducts:
    """Products in one channel of the k columns of the candidates that affect it, at indices ``which (g,)``: ``crossed
    (g, k, n + 1)`` with the n columns of a fit and its target, ``squared (g, k, k)`` with each other."""

    which: IntArray
    crossed: FloatArray
    squared: FloatArray


class Remembering(Protocol):
    """An object with what its :func:`remembered` methods have returned."""

    @property
    def known(self) -> dict[str, dict[Any, Any]]:
        """Results by method and argument."""


def remembered(method: Callable[[_Owner, _Key], _Value]) -> Callable[[_Owner, _Key], _Value]:
    """Remember what a method returns for each argument."""

    @wraps(method)
    def looked_up(owner: _Owner, key: _Key) -> _Value:
        results: dict[_Key, _Value] = owner.known.setdefault(method.__name__, {})
        try:
            return results[key]
        except KeyError:
            return results.setdefault(key, method(owner, key))

    return looked_up


@dataclass(frozen=True, eq=False)
class Design:
    """Rows of all channels, with ``dimension`` inertial columns, and the ``variances`` of their remainders' blocks.
    Designs of the same rows share what is ``known`` of these."""

    channels: tuple[ChannelRows, ...]
    dimension: int
    variances: tuple[FloatArray, ...]
    known: dict[str, dict[Any, Any]] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(channels: Sequence[ChannelRows], dimension: int) -> Design:
        """Create with the default remainder."""
        return Design(tuple(channels), dimension, tuple(channel.remainder.default_variances for channel in channels))

    def given(self, variances: Sequence[FloatArray]) -> Design:
        """Return the design with other ``variances`` of the remainders."""
        return replace(self, variances=tuple(variances))

    @cached_property
    def _marginalised(self) -> list[Marginal]:
        """Products of each channel with the remainder integrated out."""
        pairs = zip(self.channels, self.variances, strict=True)
        return [channel.marginalised(variances) for channel, variances in pairs]

    @property
    def cost(self) -> float:
        """Addition of the remainder to minus twice the log likelihood."""
        return sum(marginal.cost for marginal in self._marginalised)

    @cached_property
    def counts(self) -> FloatArray:
        """Number of rows of each channel ``(C,)``."""
        return frozen(np.array([float(channel.count) for channel in self.channels]))

    @cached_property
    def floors(self) -> FloatArray:
        """Least noise of each channel ``(C,)``, a fraction of the measurement. What the remainder leaves of it is no
        reference for rounding: the better an effect fits, the larger the remainder may be, and few rows leave
        nothing."""
        return np.array([np.sqrt(LEAST_SHARE * c.products[-2, -2] / max(c.count, 1)) for c in self.channels])

    def scales(self, terms: Sequence[EffectTerm]) -> FloatArray:
        """Scale of each coefficient: its column is as large as the target in one channel, smaller in the others."""
        return np.array([self._scale(term) for term in terms])

    @remembered
    def _scale(self, term: EffectTerm) -> float:
        places = zip(self.channels, self._places_of_term(term), strict=True)
        squares = np.array([[c.products[-2, -2], c.products[place, place]] for c, place in places])
        target, column = squares[squares[:, 1] > 0.0].T
        scale = float(np.sqrt(np.min(target / column, initial=np.inf)))
        return scale if np.isfinite(scale) and scale > 0.0 else 1.0

    @remembered
    def prior_stds(self, candidate: Candidate) -> FloatArray:
        """Prior standard deviations ``(k,)`` of a candidate's coefficients."""
        return candidate.prior_stds(self.scales(candidate.terms))

    def gather(self, bodies: Sequence[int], terms: Sequence[EffectTerm]) -> ChannelProducts:
        """Products of the inertial columns, those of each link of ``bodies`` again, the terms and the target."""
        places, blocks = self.places(bodies, terms), []
        for channel, marginal, columns in zip(self.channels, self._marginalised, places, strict=True):
            present = channel.present[columns]
            present[-1] = True
            chosen = columns[present]
            blocks.append((np.flatnonzero(present), marginal.products[chosen[:, None], chosen]))
        return ChannelProducts.of(places.shape[1], blocks)

    def with_fitted_remainder(
        self,
        bodies: Sequence[int],
        terms: Sequence[EffectTerm],
        parameters: FloatArray,
        named: FloatArray,
        among: Collection[int] | None = None,
        near: Sequence[FloatArray] | None = None,
    ) -> Design:
        """Return the design with the most likely remainder at ``parameters (D,)`` of the columns of :meth:`gather`, for
        a power ``named (C,)`` of the named effects, see :meth:`Remainder.fitted_variances`. Channels not in ``among``
        keep theirs. The search begins only at the variances ``near``, if these are given."""
        among, variances = range(len(self.channels)) if among is None else list(among), list(self.variances)
        residuals = self._residuals(bodies, terms, parameters, among)
        for place, residual in zip(among, residuals, strict=True):
            start = None if near is None else near[place]
            variances[place] = self.channels[place].remainder.fitted_variances(*residual, float(named[place]), start)
        return self.given(variances)

    def remainders(
        self, bodies: Sequence[int], terms: Sequence[EffectTerm], parameters: FloatArray
    ) -> list[RemainderFit]:
        """Remainder of each channel at these ``parameters (D,)``."""
        residuals = self._residuals(bodies, terms, parameters, range(len(self.channels)))
        lacks = []
        for channel, (vector, square), marginal in zip(self.channels, residuals, self._marginalised, strict=True):
            squared, whitener = channel.remainder.squared, marginal.whitener
            white = whitener @ (channel.remainder.crossed @ vector)
            mean = -white @ whitener
            explained = float(mean @ squared @ mean) / max(square, 1e-300)
            freedom = float(np.sum((whitener @ squared) * whitener))
            totals = [mean] if channel.prior_mean is None else [mean, mean + channel.prior_mean]
            power = min(float(total @ squared @ total) for total in totals)
            noise = max(square - float(white @ white), 0.0) / max(channel.count, 1)
            triangle = np.sqrt(noise) * channel.scale * whitener
            lacks.append(RemainderFit(channel.scale * mean, triangle, explained, power, freedom))
        return lacks

    def gains_of_features(
        self,
        bodies: Sequence[int],
        terms: Sequence[EffectTerm],
        parameters: FloatArray,
        place: int,
        names: Sequence[str],
    ) -> dict[str, float]:
        """Gain of twice the log likelihood of channel number ``place`` at ``parameters (D,)`` by the features of each
        name alone, as its only remainder; ``names``: of the blocks of features."""
        remainder, named = self.channels[place].remainder, np.array(names)
        ((vector, square),) = self._residuals(bodies, terms, parameters, [place])
        of_features = {name: remainder.of_features((named == name)[remainder.block]) for name in dict.fromkeys(names)}
        return {name: alone.gain(vector, square) for name, alone in of_features.items()}

    def powers(self, columns: Candidate | int, values: FloatArray) -> FloatArray:
        """Sums of squares ``(C,)`` that a candidate's or a link's columns add to the channels at ``values (k,)``."""
        places = self._places_of_link(columns) if isinstance(columns, int) else self._candidate_places(columns)
        pairs = zip(self.channels, places, strict=True)
        return np.array([float(values @ c.products[np.ix_(place, place)] @ values) for c, place in pairs])

    def _residuals(
        self, bodies: Sequence[int], terms: Sequence[EffectTerm], parameters: FloatArray, among: Sequence[int]
    ) -> list[tuple[FloatArray, float]]:
        """Residual of each channel in ``among``, as weights of its columns ``(K + 2,)``, and its sum of squares."""
        vector, places, residuals = np.append(parameters, -1.0), self.places(bodies, terms), []
        for channel, columns in ((self.channels[place], places[place]) for place in among):
            weights = np.zeros(len(channel.products))
            np.add.at(weights, columns, vector)
            weights[-1] = 0.0
            residuals.append((weights, float(weights @ channel.products @ weights)))
        return residuals

    def places(self, bodies: Sequence[int], terms: Sequence[EffectTerm]) -> IntArray:
        """Column indices by channel ``(C, n)``: inertial, those of each link of ``bodies`` again, terms, target."""
        columns = [place for body in bodies for place in self._places_of_link(body).T]
        columns += [self._places_of_term(term) for term in terms]
        indices = np.full((len(self.channels), self.dimension + len(columns) + 1), -2)
        indices[:, : self.dimension] = self._links
        if columns:
            indices[:, self.dimension : -1] = np.array(columns).T
        return indices

    @remembered
    def _places_of_term(self, term: EffectTerm) -> IntArray:
        """Index of a term's column in each channel ``(C,)``, -1 (the zero column) where it is absent."""
        return np.array([channel.place.get(term, -1) for channel in self.channels])

    @remembered
    def affected_channels(self, candidate: Candidate) -> list[int]:
        """Channels that a candidate affects."""
        if candidate.payload is not None:
            return list(range(len(self.channels)))
        return [i for i, c in enumerate(self.channels) if any(term in c.place for term in candidate.terms)]

    def candidate_products(self, alike: Sequence[Candidate], places: Mapping[int, IntArray]) -> list[CandidateProducts]:
        """Products of the columns of candidates, which have equally many, with those of a fit at ``places`` in some
        channels."""
        indices, products_by_channel = np.array([self._candidate_places(candidate) for candidate in alike]), []
        reached = np.any(indices >= 0, axis=2)
        for channel, fit_columns in places.items():
            products, which = self._marginalised[channel].products, np.flatnonzero(reached[:, channel])
            columns = indices[which, channel]
            crossed, squared = products[columns][:, :, fit_columns], products[columns[:, :, None], columns[:, None]]
            products_by_channel.append(CandidateProducts(which, crossed, squared))
        return products_by_channel

    @remembered
    def _candidate_places(self, candidate: Candidate) -> IntArray:
        """Index of each of a candidate's columns in each channel ``(C, k)``."""
        if candidate.payload is not None:
            return self._places_of_link(candidate.payload)
        return np.column_stack([self._places_of_term(term) for term in candidate.terms])

    def _places_of_link(self, link: int) -> IntArray:
        """Index of each of a link's columns in each channel ``(C, 10)``."""
        return self._links[:, 10 * link : 10 * link + 10]

    @cached_property
    def _links(self) -> IntArray:
        """Index of each inertial column in each channel ``(C, dimension)``."""
        return np.array([channel.links for channel in self.channels]).reshape(len(self.channels), self.dimension)
