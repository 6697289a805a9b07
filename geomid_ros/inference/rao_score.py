"""Gain from one more candidate, without a fit: Rao's score test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple

import numpy as np

from geomid_ros.inference.design import CandidateProducts, Design
from geomid_ros.inference.fit import JointFit
from geomid_ros.inference.prior import Chosen
from geomid_ros.types import BoolArray, FloatArray, IntArray

_LEAST_EIGENVALUE = 1e-7  # columns with a smaller remaining part are a combination of the others
_DIRECTIONS_OF_BODY = 4.0  # mass and centre; the data hardly constrain its inertia
_EVERY = -1  # in place of a limb: affects several, or none
_LEAST_LEFT = 1e-3  # fraction of a channel's squares that remains: bounds the promise of the quadratic model


class ScoreTest(NamedTuple, Generic[Chosen]):
    """Score test of a candidate: ``gain``, its improvement of a fit less its cost, and ``separability``, the fraction
    of its columns that the other parameters, within their prior, cannot imitate."""

    candidate: Chosen
    gain: float
    separability: float


def score_tests(
    design: Design, current: JointFit[Chosen, Any], candidates: Sequence[Chosen]
) -> list[ScoreTest[Chosen]]:
    """Compute by how much each candidate would improve the current fit, to second order.

    For fixed weights the step and the gain are those of the Gaussian model (Rao's score test); the gain is then taken
    from the sums of squares after the step. Candidates of a limb with equally many columns are tested at once.
    """
    limbs, tests, covariance = _limbs(current), dict[int, _Test[Chosen]](), current.covariance
    limb_of_column = np.append(limbs, _EVERY)  # last: a channel with nothing but the target
    of_channel = [limb_of_column[places[0]] for places in design.gather(current.bodies, current.terms).places]
    by_kind: dict[tuple[int, int], list[Chosen]] = {}
    for candidate in candidates:
        reached = {of_channel[channel] for channel in design.affected_channels(candidate)}
        limb = reached.pop() if len(reached) == 1 else _EVERY
        by_kind.setdefault((limb, len(candidate.terms)), []).append(candidate)
    trials: dict[Chosen, ScoreTest[Chosen]] = {}
    for (limb, _), group in by_kind.items():
        if limb not in tests:
            tests[limb] = _Test(design, current, covariance, np.flatnonzero((limbs == limb) | (limb == _EVERY)))
        trials |= tests[limb].of(group)
    return [trials[candidate] for candidate in candidates]


def _limbs(current: JointFit[Any, Any]) -> IntArray:
    """Label of each parameter ``(D,)``: the first one that rows or priors connect it with, directly or through others.
    Limbs that share no link, such as an arm and a leg, do not inform on each other."""
    connected = current.information != 0.0
    first = np.arange(len(connected))
    connected[current.manifold.links_blocks] = True
    before = first + 1
    while not np.array_equal(first, before):
        before, first = first, np.min(np.where(connected, first, len(first)), axis=1)
    return first


class _Test(Generic[Chosen]):
    """Data that the score tests at one fit share: G candidates of k columns, in the C channels that depend on some of D
    parameters and on no others."""

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
        for row, (places, block) in zip(self._moved, self._by_channel, strict=True):
            row[places] = block @ self._vector[places]
        self._values = dict(zip(current.terms, current.point.reals.tolist(), strict=True))

    def of(self, alike: Sequence[Chosen]) -> dict[Chosen, ScoreTest[Chosen]]:
        """Compute the score tests of candidates with equally many columns."""
        places = self._design.places(self._current.bodies, self._current.terms)
        products = self._design.candidate_products(
            alike, {channel: places[channel, self._columns] for channel in self._channels}
        )
        trust = self._trust(alike)
        crossed = np.zeros((*trust.shape, len(self._vector)))
        squared = np.zeros((*trust.shape, trust.shape[1]))
        for channel, weight in zip(products, self._weights, strict=True):
            crossed[channel.which] += weight * channel.crossed
            squared[channel.which] += weight * channel.squared
        flat = crossed.reshape(-1, len(self._vector))  # one matrix product for all candidates
        solved = (flat[:, :-1] @ self._covariance).reshape(*trust.shape, -1)
        separate_part = squared - crossed[..., :-1] @ solved.swapaxes(1, 2)
        precision = separate_part + trust[:, :, None] * np.eye(trust.shape[1])
        step, largest = _steps((flat @ self._vector).reshape(trust.shape), squared, separate_part, precision)
        energy = np.einsum("gk,gkl,gl->g", step, squared, step)
        separate_energy = np.einsum("gk,gkl,gl->g", step, separate_part, step)
        gain = self._gain(products, step, -(step[:, None] @ solved)[:, 0])
        gain -= energy - separate_energy  # the quadratic term of the others' step
        separability = np.divide(separate_energy, energy, out=np.zeros_like(energy), where=energy > 0.0)
        separability[largest <= _LEAST_EIGENVALUE] = 0.0
        impossible = self._is_impossible(alike, step)
        separability[impossible] = largest[impossible]
        gain[impossible | (largest <= _LEAST_EIGENVALUE)] = -np.inf
        gain -= np.sum(trust * step**2, axis=1) + np.array([candidate.cost for candidate in alike])
        gain -= self._log_narrowing(alike, precision, trust)
        return {c: ScoreTest(c, g, s) for c, g, s in zip(alike, gain.tolist(), separability.tolist(), strict=True)}

    def _trust(self, alike: Sequence[Chosen]) -> FloatArray:
        """Prior precisions ``(G, k)`` of the candidates' coefficients; of bodies almost zero."""
        if alike[0].payload is not None:
            return np.full((len(alike), 10), 1e-12)
        return np.array([self._design.prior_stds(candidate) for candidate in alike]) ** -2.0

    def _log_narrowing(self, alike: Sequence[Chosen], precision: FloatArray, trust: FloatArray) -> FloatArray:
        """Twice the log of how much the data narrow the coefficients ``(G,)``; of bodies by a rule of thumb."""
        if alike[0].payload is not None:
            return np.full(len(alike), _DIRECTIONS_OF_BODY * np.log(np.max(self._design.counts)))
        return np.asarray(np.linalg.slogdet(precision)[1] - np.sum(np.log(trust), axis=1))

    def _gain(self, products: Sequence[CandidateProducts], step: FloatArray, moved: FloatArray) -> FloatArray:
        """Gain ``(G,)`` of steps of the candidates' coefficients ``(G, k)`` and of all other parameters ``(G, D)``,
        without the quadratic term of the latter."""
        squares, weights = self._squares, self._weights
        padded = np.zeros((len(moved), len(self._vector)))
        padded[:, :-1] = moved
        slopes = padded @ self._moved.T
        curvatures = np.stack(
            [np.sum((padded[:, at] @ products) * padded[:, at], axis=1) for at, products in self._by_channel], 1
        )
        squares_after = squares + 2.0 * slopes + curvatures
        for place, channel in enumerate(products):
            steps, vectors = step[channel.which], self._vector + padded[channel.which]
            along = 2.0 * np.einsum("gkn,gn->gk", channel.crossed, vectors)
            along += np.einsum("gkl,gl->gk", channel.squared, steps)
            squares_after[channel.which, place] += np.sum(along * steps, axis=1)
        gain = np.log(squares / np.maximum(squares_after, _LEAST_LEFT * squares)) @ self._counts
        # At the minimum the prior's slope is the opposite of the data's.
        gain += 2.0 * slopes @ weights + curvatures @ weights
        return np.asarray(gain)

    def _is_impossible(self, alike: Sequence[Chosen], step: FloatArray) -> BoolArray:
        """True if a coefficient that cannot be negative would become so ``(G,)``."""
        impossible = np.zeros(len(alike), dtype=bool)
        for index in np.flatnonzero(np.any(step < 0.0, axis=1)).tolist():
            terms = alike[index].terms[: alike[index].positives]
            impossible[index] = any(
                self._values.get(t, 0.0) + s < 0.0 for t, s in zip(terms, step[index].tolist(), strict=False)
            )
        return impossible


def _steps(
    slope: FloatArray, squared: FloatArray, separate_part: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the steps ``(G, k)`` to the minimum of quadratic models with Hessians ``precision (G, k, k)``, and the
    largest eigenvalue of the columns' ``separate_part``, relative to their ``squared`` sizes, ``(G,)``."""
    size = np.sqrt(np.maximum(np.diagonal(squared, axis1=1, axis2=2), 1e-300))
    values = np.linalg.eigvalsh(separate_part / (size[:, :, None] * size[:, None, :]))
    step = -np.linalg.solve(precision + 1e-12 * size[:, :, None] ** 2 * np.eye(size.shape[1]), slope[:, :, None])
    return np.asarray(step[:, :, 0]), np.max(values, axis=1)
