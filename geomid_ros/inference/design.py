"""Products of all columns that compete for the explanation of each channel, with the remainder integrated out."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.profile_objective import LEAST_SHARE
from geomid_ros.inference.hypothesis import Hypothesis
from geomid_ros.inference.remainder import Marginal, Remainder
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

BLOCKS = 8  # of time, whose scatter shows how far rows are independent
_LEAST_SIZE = 1e-4  # a mean square of whitened features: those of what hardly occurs are not made large
USUAL_SHARE = 0.3
"""Prior standard deviation of a coefficient, as a share of what is measured, where nothing else is known of it."""


@dataclass(frozen=True, eq=False)
class ChannelRows:
    """Whitened rows of a channel: ``columns (N, K + 1)`` with the target as the last, ``features (N, m)`` of a
    remainder in their ``block (m,)``, which are ``scale (m,)`` times those given: a draw of a block with variance 1 has
    a mean square of 1; ``place`` of each term among the columns, and ``links (D,)`` of the inertial columns of all
    channels, -1 where they are absent; ``before``: what is left unsure of the features' coefficients by other
    recordings, see :class:`Remainder`, and what these ``expected (m,)``, which is taken off the target."""

    columns: FloatArray
    features: FloatArray
    scale: FloatArray
    block: IntArray
    place: Mapping[Any, int]
    links: IntArray
    before: FloatArray | None = None
    expected: FloatArray | None = None

    @staticmethod
    def of(
        columns: FloatArray,
        features: FloatArray,
        block: IntArray,
        place: Mapping[Any, int],
        links: IntArray,
        before: FloatArray | None = None,
        expected: FloatArray | None = None,
    ) -> ChannelRows:
        """With features of any scale."""
        sizes = np.bincount(block, np.sum(features**2, axis=0)) / max(len(columns), 1)
        scale = 1.0 / np.sqrt(np.maximum(sizes, _LEAST_SIZE))[block]
        return ChannelRows(
            columns,
            features * scale,
            scale,
            block,
            place,
            links=links,
            before=None if before is None else before / np.outer(scale, scale),
            expected=None if expected is None else expected / scale,
        )

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.columns)

    @cached_property
    def products(self) -> FloatArray:
        """Of the columns ``(K + 2, K + 2)``; the last row is zero, for what does not reach the channel."""
        return np.pad(self.columns.T @ self.columns, ((0, 1), (0, 1)))

    @cached_property
    def there(self) -> BoolArray:
        """Which columns ``(K + 2,)`` reach the channel."""
        return np.asarray(np.diag(self.products) > 0.0)

    @cached_property
    def remainder(self) -> Remainder:
        """Products with the features."""
        crossed = np.pad(self.features.T @ self.columns, ((0, 0), (0, 1)))
        return Remainder(self.features.T @ self.features, crossed, self.block, self.count, self.before)

    def whitened(self, vector: FloatArray, taken: IntArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Columns ``(N, n)`` that are ``taken`` and their sum with a ``vector (n,)``, white beside the remainder."""
        padded = np.pad(self.columns, ((0, 0), (0, 1)))[:, taken]
        rows = np.column_stack([padded, padded @ vector])
        if len(self.block):
            drawn = self.features @ self.remainder.root(variances)
            directions, sizes, _ = np.linalg.svd(drawn, full_matrices=False)
            rows -= directions @ ((1.0 - 1.0 / np.sqrt(1.0 + sizes**2))[:, None] * (directions.T @ rows))
        return rows[:, :-1], rows[:, -1]


@dataclass(frozen=True, eq=False)
class Lack:
    """What a channel's remainder is: ``coefficients (m,)`` of the features that were given, the share of the residual's
    squares that each block ``explained (blocks,)``, its sum of squares (``power``; beside other recordings what is new,
    if that is less than all), for how many parameters it counts (``freedom``), and the ``triangle (m, m)`` of which
    ``T'T`` is the coefficients' covariance."""

    coefficients: FloatArray
    triangle: FloatArray
    explained: FloatArray
    power: float
    freedom: float


@dataclass(frozen=True, eq=False)
class CandidateProducts:
    """Products in one channel of the k columns of those candidates that reach it, ``which (g,)``: ``crossed`` with the
    n columns of a fit and its target ``(g, k, n + 1)``, ``squared`` with each other ``(g, k, k)``."""

    which: IntArray
    crossed: FloatArray
    squared: FloatArray


@dataclass(frozen=True, eq=False)
class Design:
    """Rows of all channels, for ``dimension`` inertial columns, and the ``variances`` of each channel's remainder."""

    channels: tuple[ChannelRows, ...]
    dimension: int
    variances: tuple[FloatArray, ...]
    _known_places: dict[Hypothesis[Any], IntArray] = field(default_factory=dict, repr=False)
    _known_scales: dict[Any, float] = field(default_factory=dict, repr=False)
    _known_terms: dict[Any, IntArray] = field(default_factory=dict, repr=False)
    _known_trust: dict[Hypothesis[Any], FloatArray] = field(default_factory=dict, repr=False)
    _known_reach: dict[Hypothesis[Any], list[int]] = field(default_factory=dict, repr=False)
    _products: dict[tuple[int, bytes], Marginal] = field(default_factory=dict, repr=False)
    _gathered: dict[int, tuple[bytes, FloatArray]] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(channels: Sequence[ChannelRows], dimension: int) -> Design:
        """With the usual remainder."""
        return Design(tuple(channels), dimension, tuple(channel.remainder.usual for channel in channels))

    def given(self, variances: Sequence[FloatArray]) -> Design:
        """The same beside a remainder of these ``variances``, of each channel's blocks: products of channels that keep
        theirs are taken over."""
        kept = {key: self._products[key] for key in self._keys if key in self._products}
        return replace(self, variances=tuple(variances), _products=kept, _gathered={})

    @property
    def _keys(self) -> list[tuple[int, bytes]]:
        """What the products of each channel are found by."""
        return [(place, variances.tobytes()) for place, variances in enumerate(self.variances)]

    @cached_property
    def _marginalised(self) -> list[Marginal]:
        """Of each channel."""
        found = []
        for key, channel, variances in zip(self._keys, self.channels, self.variances, strict=True):
            if key not in self._products:
                self._products[key] = channel.remainder.marginalised(channel.products, variances)
            found.append(self._products[key])
        return found

    @property
    def is_told(self) -> bool:
        """Whether other recordings tell what a channel lacks."""
        return any(channel.before is not None for channel in self.channels)

    @property
    def cost(self) -> float:
        """What the remainder adds to minus twice the log likelihood."""
        return sum(each.cost for each in self._marginalised)

    @cached_property
    def counts(self) -> FloatArray:
        """Rows of each channel."""
        return frozen(np.array([float(channel.count) for channel in self.channels]))

    @cached_property
    def floors(self) -> FloatArray:
        """Least noise of each channel ``(C,)``, by what was measured. What the remainder leaves of it is no measure of
        rounding: the better a name fits, the larger the remainder beside it may be, and of few rows nothing is left."""
        return np.array([np.sqrt(LEAST_SHARE * c.products[-2, -2] / max(c.count, 1)) for c in self.channels])

    def scales(self, terms: Sequence[Any]) -> FloatArray:
        """Of each coefficient: the one with which its column is as large as the target in some channel, and smaller in
        the others."""
        return np.array([self._scale(term) for term in terms])

    def _scale(self, term: Any) -> float:
        if term not in self._known_scales:
            places = zip(self.channels, self._places_of_term(term), strict=True)
            squares = np.array([[c.products[-2, -2], c.products[place, place]] for c, place in places])
            target, own = squares[squares[:, 1] > 0.0].T
            scale = float(np.sqrt(np.min(target / own, initial=np.inf)))
            self._known_scales[term] = scale if np.isfinite(scale) and scale > 0.0 else 1.0
        return self._known_scales[term]

    def trust(self, candidate: Hypothesis[Any]) -> FloatArray:
        """Weights ``(k,)`` of a candidate's coefficients in their prior."""
        if candidate not in self._known_trust:
            usual = zip(candidate.usual, self.scales(candidate.terms), strict=True)
            self._known_trust[candidate] = np.array([std or USUAL_SHARE * scale for std, scale in usual]) ** -2.0
        return self._known_trust[candidate]

    def gather(self, bodies: Sequence[int], terms: Sequence[Any]) -> ChannelProducts:
        """Products of the inertial columns, once more those of each link of ``bodies``, the terms' and the target's."""
        places = self.places(bodies, terms)

        def gathered() -> Iterator[tuple[IntArray, FloatArray]]:
            for place, (channel, taken) in enumerate(zip(self.channels, places, strict=True)):
                there = channel.there[taken]
                there[-1] = True
                yield np.flatnonzero(there), self._block(place, taken[there])

        return ChannelProducts.of(places.shape[1], gathered())

    def _block(self, place: int, own: IntArray) -> FloatArray:
        """Products of some columns of a channel; those of the last time again, as most fits differ in few channels."""
        key = own.tobytes()
        if place not in self._gathered or self._gathered[place][0] != key:
            self._gathered[place] = key, self._marginalised[place].products[own[:, None], own]
        return self._gathered[place][1]

    def settled(
        self,
        bodies: Sequence[int],
        terms: Sequence[Any],
        parameters: FloatArray,
        named: FloatArray,
        among: Collection[int] | None = None,
        near: Sequence[FloatArray] | None = None,
    ) -> Design:
        """Beside the remainder that is most likely for these ``parameters (D,)`` of the columns of :meth:`gather`, and
        what is ``named (C,)`` in each channel, see :meth:`Remainder.settled`; of all channels unless ``among`` some.
        Where each channel's variances are ``near`` those given, the search begins there alone."""
        among, variances = range(len(self.channels)) if among is None else list(among), list(self.variances)
        left = self._residuals(bodies, terms, parameters, among)
        for place, own in zip(among, left, strict=True):
            begun = None if near is None else near[place]
            variances[place] = self.channels[place].remainder.settled(*own, float(named[place]), begun)
        return self.given(variances)

    def remainders(self, bodies: Sequence[int], terms: Sequence[Any], parameters: FloatArray) -> list[Lack]:
        """What each channel's remainder is, beside these ``parameters (D,)``."""
        left = self._residuals(bodies, terms, parameters, range(len(self.channels)))
        found = []
        for channel, (vector, square), marginal in zip(self.channels, left, self._marginalised, strict=True):
            squared, whitener = channel.remainder.squared, marginal.whitener
            white = whitener @ (channel.remainder.crossed @ vector)
            mean = -white @ whitener
            own = np.where(channel.block[:, None] == np.arange(len(channel.remainder.usual)), mean[:, None], 0.0)
            explained = np.sum(own * (squared @ own), axis=0)
            freedom = float(np.sum((whitener @ squared) * whitener))
            wholes = [mean] if channel.expected is None else [mean, mean + channel.expected]
            power = min(float(whole @ squared @ whole) for whole in wholes)
            noise = max(square - float(white @ white), 0.0) / max(channel.count, 1)
            triangle = np.sqrt(noise) * channel.scale * whitener
            found.append(Lack(channel.scale * mean, triangle, explained / max(square, 1e-300), power, freedom))
        return found

    def powers(self, columns: Hypothesis[Any] | int, values: FloatArray) -> FloatArray:
        """Sums of squares ``(C,)`` of what the columns of a candidate, or of a link, with these ``values (k,)`` add to
        each channel."""
        places = self._places_of_link(columns) if isinstance(columns, int) else self._own_places(columns)
        own = zip(self.channels, places, strict=True)
        return np.array([float(values @ c.products[np.ix_(place, place)] @ values) for c, place in own])

    def _residuals(
        self, bodies: Sequence[int], terms: Sequence[Any], parameters: FloatArray, among: Sequence[int]
    ) -> list[tuple[FloatArray, float]]:
        """Of channels, the residual as a sum of its columns ``(K,)``, and its sum of squares."""
        vector, places, found = np.append(parameters, -1.0), self.places(bodies, terms), []
        for channel, own in ((self.channels[place], places[place]) for place in among):
            whole = np.zeros(len(channel.products))
            np.add.at(whole, own, vector)
            whole[-1] = 0.0
            found.append((whole, float(whole @ channel.products @ whole)))
        return found

    def places(self, bodies: Sequence[int], terms: Sequence[Any]) -> IntArray:
        """In each channel ``(C, n)``, of the inertial columns, those of each link of ``bodies``, the terms' and the
        target's."""
        own = [place for body in bodies for place in self._places_of_link(body).T]
        own += [self._places_of_term(term) for term in terms]
        found = np.full((len(self.channels), self.dimension + len(own) + 1), -2)
        found[:, : self.dimension] = self._links
        if own:
            found[:, self.dimension : -1] = np.array(own).T
        return found

    def _places_of_term(self, term: Any) -> IntArray:
        """In each channel ``(C,)``; that of the zero row where it is absent."""
        if term not in self._known_terms:
            self._known_terms[term] = np.array([channel.place.get(term, -1) for channel in self.channels])
        return self._known_terms[term]

    def reached(self, candidate: Hypothesis[Any]) -> list[int]:
        """The channels that a candidate can change."""
        if candidate.payload is not None:
            return list(range(len(self.channels)))
        if candidate not in self._known_reach:
            own = [i for i, c in enumerate(self.channels) if any(term in c.place for term in candidate.terms)]
            self._known_reach[candidate] = own
        return self._known_reach[candidate]

    def own(self, alike: Sequence[Hypothesis[Any]], places: Mapping[int, IntArray]) -> list[CandidateProducts]:
        """Of some channels, the products of the columns of candidates, each of which has as many, with those of a fit,
        by their ``places`` in each."""
        every, found = np.array([self._own_places(candidate) for candidate in alike]), []
        reached = np.any(every >= 0, axis=2)
        for channel, beside in places.items():
            products, which = self._marginalised[channel].products, np.flatnonzero(reached[:, channel])
            mine = every[which, channel]
            crossed, squared = products[mine][:, :, beside], products[mine[:, :, None], mine[:, None]]
            found.append(CandidateProducts(which, crossed, squared))
        return found

    def _own_places(self, candidate: Hypothesis[Any]) -> IntArray:
        """Places of a candidate's columns in each channel ``(C, k)``."""
        if candidate not in self._known_places:
            body, own = candidate.payload, [self._places_of_term(term) for term in candidate.terms]
            self._known_places[candidate] = np.column_stack(own) if body is None else self._places_of_link(body)
        return self._known_places[candidate]

    def _places_of_link(self, link: int) -> IntArray:
        """Places of a link's columns in each channel ``(C, 10)``."""
        return self._links[:, 10 * link : 10 * link + 10]

    @cached_property
    def _links(self) -> IntArray:
        """Places of the inertial columns in each channel ``(C, dimension)``."""
        return np.array([channel.links for channel in self.channels]).reshape(len(self.channels), self.dimension)
