"""What one candidate more would bring, without a fit: Rao's score test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple

import numpy as np

from geomid_ros.inference.design import CandidateProducts, Design
from geomid_ros.inference.fit import JointFit
from geomid_ros.inference.hypothesis import Chosen
from geomid_ros.types import BoolArray, FloatArray, IntArray

_LEAST_EIGENVALUE = 1e-7  # a combination of columns of which less is left is one of the others
_DIRECTIONS_OF_BODY = 4.0  # mass and centre: what is said of its inertia is little
_EVERY = -1  # in place of a limb: what reaches several, or none
_LEAST_LEFT = 1e-3  # of a channel's squares: so much the quadratic model may promise


class Trial(NamedTuple, Generic[Chosen]):
    """A candidate's improvement of a fit by the score test, its cost paid, and its separability: the share of its
    columns that the other parameters, within their prior, cannot imitate."""

    candidate: Chosen
    gain: float
    separability: float


def score_tests(design: Design, current: JointFit[Chosen, Any], candidates: Sequence[Chosen]) -> list[Trial[Chosen]]:
    """The score tests: by how much each candidate would improve the current fit, to second order.

    For fixed weights the step and the gain are those of the Gaussian model (Rao's score test); the gain is then taken
    from the sums of squares that the step leads to. Candidates of a limb with equally many columns are tested at once.
    """
    limbs, tests, covariance = _limbs(current), dict[int, _Test[Chosen]](), current.covariance
    every = np.append(limbs, _EVERY)  # of a channel with nothing but the target
    of_channel = [every[places[0]] for places in design.gather(current.bodies, current.terms).places]
    by_kind: dict[tuple[int, int], list[Chosen]] = {}
    for candidate in candidates:
        reached = {of_channel[channel] for channel in design.reached(candidate)}
        limb = reached.pop() if len(reached) == 1 else _EVERY
        by_kind.setdefault((limb, len(candidate.terms)), []).append(candidate)
    found: dict[Chosen, Trial[Chosen]] = {}
    for (limb, _), alike in by_kind.items():
        if limb not in tests:
            tests[limb] = _Test(design, current, covariance, np.flatnonzero((limbs == limb) | (limb == _EVERY)))
        found |= tests[limb].of(alike)
    return [found[candidate] for candidate in candidates]


def _limbs(current: JointFit[Any, Any]) -> IntArray:
    """Of each parameter ``(D,)`` the first one with which it is connected, by rows or priors, through any others: what
    an arm has in common with no leg tells nothing of it."""
    connected = current.information != 0.0
    first = np.arange(len(connected))
    connected[current.manifold.links_blocks] = True
    before = first + 1
    while not np.array_equal(first, before):
        before, first = first, np.min(np.where(connected, first, len(first)), axis=1)
    return first


def score_test(design: Design, current: JointFit[Chosen, Any], candidate: Chosen) -> Trial[Chosen]:
    """The score test of one candidate."""
    return score_tests(design, current, [candidate])[0]


class _Test(Generic[Chosen]):
    """What the score tests beside one fit share: G candidates of k columns in the C channels that have some of D
    parameters, and no others."""

    def __init__(
        self, design: Design, current: JointFit[Chosen, Any], covariance: FloatArray, parameters: IntArray
    ) -> None:
        self._design = design
        self._current = current
        self._columns = np.append(parameters, len(covariance))  # with the target's
        self._vector = np.append(current.point.parameters, -1.0)[self._columns]
        self._covariance = covariance[parameters[:, None], parameters]
        products = design.gather(current.bodies, current.terms)
        place = np.full(products.size, -1)
        place[self._columns] = np.arange(len(self._columns))
        self._channels = [c for c, places in enumerate(products.places) if place[places[0]] >= 0]
        self._counts, self._squares = design.counts[self._channels], current.squares[self._channels]
        self._weights = self._counts / self._squares
        self._by_channel = [(place[products.places[c]], products.blocks[c]) for c in self._channels]
        self._moved = np.zeros((len(self._channels), len(self._vector)))
        for into, (places, own) in zip(self._moved, self._by_channel, strict=True):
            into[places] = own @ self._vector[places]
        self._values = dict(zip(current.terms, current.point.reals.tolist(), strict=True))

    def of(self, alike: Sequence[Chosen]) -> dict[Chosen, Trial[Chosen]]:
        """The score tests of candidates with equally many columns."""
        every = self._design.places(self._current.bodies, self._current.terms)
        own = self._design.own(alike, {channel: every[channel, self._columns] for channel in self._channels})
        trust = self._trust(alike)
        mixed = np.zeros((*trust.shape, len(self._vector)))
        squared = np.zeros((*trust.shape, trust.shape[1]))
        for channel, weight in zip(own, self._weights, strict=True):
            mixed[channel.which] += weight * channel.crossed
            squared[channel.which] += weight * channel.squared
        flat = mixed.reshape(-1, len(self._vector))  # one product instead of one for each candidate
        solved = (flat[:, :-1] @ self._covariance).reshape(*trust.shape, -1)
        left = squared - mixed[..., :-1] @ solved.swapaxes(1, 2)
        width = left + trust[:, :, None] * np.eye(trust.shape[1])
        step, largest = _steps((flat @ self._vector).reshape(trust.shape), squared, left, width)
        energy = np.einsum("gk,gkl,gl->g", step, squared, step)
        share = np.einsum("gk,gkl,gl->g", step, left, step)
        gain = self._gain(own, step, -(step[:, None] @ solved)[:, 0])
        gain -= energy - share  # what the others' own step takes
        separability = np.divide(share, energy, out=np.zeros_like(energy), where=energy > 0.0)
        separability[largest <= _LEAST_EIGENVALUE] = 0.0
        impossible = self._is_impossible(alike, step)
        separability[impossible] = largest[impossible]
        gain[impossible | (largest <= _LEAST_EIGENVALUE)] = -np.inf
        gain -= np.sum(trust * step**2, axis=1) + np.array([candidate.cost for candidate in alike])
        gain -= self._narrowed(alike, width, trust)
        return {c: Trial(c, g, s) for c, g, s in zip(alike, gain.tolist(), separability.tolist(), strict=True)}

    def _trust(self, alike: Sequence[Chosen]) -> FloatArray:
        """Weights ``(G, k)`` of the candidates' coefficients in their prior; of bodies next to none."""
        if alike[0].payload is not None:
            return np.full((len(alike), 10), 1e-12)
        return np.array([self._design.trust(candidate) for candidate in alike])

    def _narrowed(self, alike: Sequence[Chosen], width: FloatArray, trust: FloatArray) -> FloatArray:
        """By how much the data narrow the coefficients, as minus twice a logarithm ``(G,)``; of bodies by a rule of
        thumb."""
        if alike[0].payload is not None:
            return np.full(len(alike), _DIRECTIONS_OF_BODY * np.log(np.max(self._design.counts)))
        return np.asarray(np.linalg.slogdet(width)[1] - np.sum(np.log(trust), axis=1))

    def _gain(self, own: Sequence[CandidateProducts], step: FloatArray, moved: FloatArray) -> FloatArray:
        """What steps of the candidates' coefficients ``(G, k)`` and of all other parameters ``(G, D)`` gain ``(G,)``,
        but for half of what the latter take in their quadratic model."""
        squares, weights = self._squares, self._weights
        longer = np.zeros((len(moved), len(self._vector)))
        longer[:, :-1] = moved
        slopes = longer @ self._moved.T
        curvatures = np.stack(
            [np.sum((longer[:, at] @ own) * longer[:, at], axis=1) for at, own in self._by_channel], 1
        )
        left = squares + 2.0 * slopes + curvatures
        for place, channel in enumerate(own):
            steps, vectors = step[channel.which], self._vector + longer[channel.which]
            along = 2.0 * np.einsum("gkn,gn->gk", channel.crossed, vectors)
            along += np.einsum("gkl,gl->gk", channel.squared, steps)
            left[channel.which, place] += np.sum(along * steps, axis=1)
        gain = np.log(squares / np.maximum(left, _LEAST_LEFT * squares)) @ self._counts
        # At the minimum the prior's slope is the opposite of the data's.
        gain += 2.0 * slopes @ weights + curvatures @ weights
        return np.asarray(gain)

    def _is_impossible(self, alike: Sequence[Chosen], step: FloatArray) -> BoolArray:
        """Whether a coefficient that cannot be negative would become so ``(G,)``."""
        if alike[0].payload is not None:
            return np.zeros(len(alike), dtype=bool)
        found = np.zeros(len(alike), dtype=bool)
        for index in np.flatnonzero(np.any(step < 0.0, axis=1)).tolist():
            terms = alike[index].terms[: alike[index].positives]
            found[index] = any(
                self._values.get(t, 0.0) + s < 0.0 for t, s in zip(terms, step[index].tolist(), strict=False)
            )
        return found


def _steps(
    slope: FloatArray, squared: FloatArray, left: FloatArray, width: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The steps ``(G, k)`` to the minimum of quadratic models of ``width (G, k, k)``, and the largest eigenvalue of
    what is ``left`` of the columns, relative to their ``squared`` sizes, ``(G,)``."""
    size = np.sqrt(np.maximum(np.diagonal(squared, axis1=1, axis2=2), 1e-300))
    values = np.linalg.eigvalsh(left / (size[:, :, None] * size[:, None, :]))
    step = -np.linalg.solve(width + 1e-12 * size[:, :, None] ** 2 * np.eye(size.shape[1]), slope[:, :, None])
    return np.asarray(step[:, :, 0]), np.max(values, axis=1)
