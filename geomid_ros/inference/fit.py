"""The joint fit: all inertias under the geometric prior, payloads and effects, for channels of unknown noise.

Minus twice the logarithm of the likelihood, maximised over each channel's variance, is ``sum_c N_c log S_c`` with the
sums of squares S_c. The prior on a link is Gaussian in geodesic distance, of a spread of its own that is estimated:
its marginal likelihood in Laplace's approximation (MacKay 1992) with an inverse-gamma prior around the usual spread.
So large errors of inertias make the prior wide instead of passing for an effect, and one wrong link loosens no other.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic

import numpy as np

from geomid_ros.estimation.fit import cost_of_spreads, likely_spreads
from geomid_ros.estimation.link_priors import cost_of_own, held_together, likely_own
from geomid_ros.estimation.profile_objective import Profile, ProfileObjective, StraightManifold, fit_scales
from geomid_ros.geometry import definite, pseudo_inertia
from geomid_ros.geometry.definite import Packed
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.inference import prior as priors
from geomid_ros.inference.design import BLOCKS, USUAL_SHARE, Design, Lack
from geomid_ros.inference.hypothesis import Chosen, Term
from geomid_ros.inference.prior import Prior
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class JointFit(Generic[Chosen, Term]):
    """The minimum for some candidates.

    Attributes:
        chosen: the candidates.
        terms: the coefficients that were fitted: those of the model, then those of the candidates.
        point, manifold: the D parameters: inertias of links and payloads, then the coefficients.
        score: minus twice the log marginal likelihood, with the parameters' penalty.
        squares: whitened sums of squares ``(C,)``.
        packed: the :attr:`information`; a search keeps hundreds of fits.
        weights: the prior's share of it ``(D,)``, what other recordings say apart.
        spreads: of the links' errors ``(links,)``, geodesic distances.
        inflation: factor on the variances of what other recordings say.
        own_spreads: of the errors that each link has by itself that is alike to others ``(n,)``.
        changes: what each candidate adds to what was known of its coefficients, or the parameters of its body ``(k,)``.
    """

    chosen: tuple[Chosen, ...]
    terms: tuple[Term, ...]
    point: Point
    manifold: ParameterManifold
    score: float
    squares: FloatArray
    packed: Packed
    weights: FloatArray
    spreads: FloatArray
    inflation: float
    own_spreads: FloatArray
    changes: Mapping[Chosen, FloatArray]

    @property
    def information(self) -> FloatArray:
        """Hessian ``(D, D)`` of half the score in tangent coordinates."""
        return self.packed.whole

    @property
    def bodies(self) -> list[int]:
        """Links that carry a payload."""
        return [c.payload for c in self.chosen if c.payload is not None]

    @property
    def inertias(self) -> FloatArray:
        """Parameters ``(links, 10)`` of the links without their payloads."""
        return pseudo_inertia.to_parameters(self.point.pseudo_inertias[: self.manifold.links - len(self.bodies)])

    @property
    def loaded_inertias(self) -> FloatArray:
        """The same with their payloads."""
        inertias = self.inertias
        for carrier, payload in zip(self.bodies, self.point.pseudo_inertias[len(inertias) :], strict=True):
            inertias[carrier] += pseudo_inertia.to_parameters(payload)
        return inertias

    @cached_property
    def inverse(self) -> FloatArray:
        """Inverse of the information ``(D, D)``."""
        return definite.inverse(self.information)

    @property
    def covariance(self) -> FloatArray:
        """Of the parameters ``(D, D)``."""
        blocks, diagonal = self.manifold.jacobian(self.point)

        def moved(matrix: FloatArray) -> FloatArray:
            links, rest = np.split(matrix, [self.manifold.inertial.stop])
            by_link = blocks @ links.reshape(len(blocks), 10, -1)
            return np.concatenate([by_link.reshape(links.shape), diagonal[:, None] * rest])

        return moved(moved(definite.inverse(self.information)).T)

    def covariance_of(self, terms: Sequence[Term]) -> FloatArray:
        """Of some coefficients ``(k, k)``."""
        own = [self._places[term] for term in terms]
        places, scales = int(self.manifold.real.start) + np.array(own, dtype=np.intp), self.manifold.scales[own]
        return np.asarray(self.inverse[places[:, None], places] * np.outer(scales, scales))

    def settled(self, design: Design, among: Collection[int] | None = None) -> Design:
        """The design beside the remainder that is most likely at this fit, of all channels unless ``among`` some."""
        named = np.zeros(len(design.channels))
        for candidate, values in self.changes.items() if design.is_told else ():
            named += design.powers(candidate, values) / self.squares
        return design.settled(self.bodies, self.terms, self.point.parameters, named, among)

    def remainders(self, design: Design) -> list[Lack]:
        """What each channel's remainder is at this fit."""
        return design.remainders(self.bodies, self.terms, self.point.parameters)

    def parameters_by_channel(self, design: Design) -> FloatArray:
        """How many parameters each channel determined, ``(C,)``: the trace of its share of the information."""
        products = design.gather(self.bodies, self.terms)
        covariance = np.pad(self.covariance, (0, 1))  # of the target, too
        pairs = zip(products.places, products.blocks, strict=True)
        traces = [float(np.sum(block * covariance[own[:, None], own])) for own, block in pairs]
        return np.asarray(design.counts / self.squares * traces)

    def value(self, term: Term) -> float:
        """A coefficient."""
        return float(self.point.reals[self._places[term]])

    def place(self, term: Term) -> int:
        """Where a coefficient stands among the parameters."""
        return int(self.manifold.real.start) + self._places[term]

    @cached_property
    def _places(self) -> dict[Term, int]:
        return {term: place for place, term in enumerate(self.terms)}


def fit(
    design: Design,
    prior: Prior[Term],
    chosen: Sequence[Chosen],
    start: JointFit[Chosen, Term] | None = None,
    spread: float | FloatArray | None = None,
) -> JointFit[Chosen, Term]:
    """Fit the chosen candidates together with all that is known, from an earlier fit where one is given.

    The links' spreads are estimated, and so is how far other recordings are trusted, unless a ``spread`` is given for
    all links, or one for each. Recordings that contradict each other leave two minima: in one the others are right and
    what is measured here is mostly error, in the other it is the reverse. Both are looked for, the one that is more
    likely is taken.
    """
    if prior.known is None or spread is not None:
        return _fit(design, prior, chosen, start, spread)
    alone = _fit(design, replace(prior, known=None), chosen, start)
    rows, _ = _known_rows(prior, chosen, alone.manifold)
    off = alone.point.parameters - _known(alone.manifold, prior, alone.bodies).parameters
    loose = replace(alone, inflation=priors.contradiction(rows, off))
    return min((_fit(design, prior, chosen, first) for first in (start, loose)), key=lambda found: found.score)


def _fit(
    design: Design,
    prior: Prior[Term],
    chosen: Sequence[Chosen],
    start: JointFit[Chosen, Term] | None,
    spread: float | FloatArray | None = None,
) -> JointFit[Chosen, Term]:
    """The minimum that is reached from the start, in which what the prior holds at zero is zero."""
    found = _free_fit(design, prior, chosen, start, spread)
    rows = prior.held(found.terms, found.point.reals)
    return _free_fit(design, prior, chosen, found, spread, rows) if len(rows) else found


def _free_fit(
    design: Design,
    prior: Prior[Term],
    chosen: Sequence[Chosen],
    start: JointFit[Chosen, Term] | None,
    spread: float | FloatArray | None,
    driven: FloatArray | None = None,
) -> JointFit[Chosen, Term]:
    """The minimum that is reached from the start; ``driven``: rows ``(r, terms)`` of the coefficients that are zero."""
    bodies = [c.payload for c in chosen if c.payload is not None]
    own = dict.fromkeys(term for c in chosen for term in c.terms)
    terms = (*prior.terms, *(term for term in own if term not in prior.terms))
    products = design.gather(bodies, terms)
    scales = design.scales(terms)
    manifold = StraightManifold(len(prior.inertias) // 10 + len(bodies), 0, scales)
    known = _known(manifold, prior, bodies)
    first = len(prior.inertias)
    usual = {term: std for c in chosen for term, std in zip(c.terms, c.usual, strict=True)}
    stds = [usual.get(term, 0.0) or USUAL_SHARE * scale for term, scale in zip(terms, scales, strict=True)]
    weights = np.ones(manifold.dimension)
    weights[manifold.real] = (scales / np.array(stds)) ** 2
    weights[first : manifold.inertial.stop] = priors.SPREAD_OF_PAYLOADS**-2
    held = np.array([term not in own for term in prior.terms], dtype=bool)
    places = manifold.real.start + np.flatnonzero(held)
    weights[places] = (scales[: len(held)][held] / prior.spreads[held]) ** 2
    rows, cost = _known_rows(prior, chosen, manifold)
    zero = _zero_rows(driven, manifold, known)
    said, zeros = (_products(manifold.rows_off(known, own[:, :-1]), own[:, -1]) for own in (rows, zero))
    afresh = start is None or set(bodies) != set(start.bodies)
    fixed = spread is not None
    inflation = 1.0 if fixed or start is None else start.inflation
    spreads = np.full(first // 10, prior.link_spreads if spread is None else spread)
    if start is not None and not (fixed or afresh):
        spreads = start.spreads
    profile = Profile(manifold, products, design.counts, known, design.floors)
    point = _first_point(manifold, known, None if afresh else start, bodies, terms)

    own_spreads = prior.own_spreads if start is None else start.own_spreads
    ends = [len(spreads), len(spreads) + 1]

    def objective(wide: FloatArray) -> ProfileObjective:
        links, inflation, apart = np.split(wide, ends)
        trusted = np.append(np.repeat(links, 10) ** -2.0, weights[first:])
        held = held_together(prior.alike, apart, manifold.dimension)
        return ProfileObjective(profile, trusted, said / inflation + zeros + _products(held, np.zeros(len(held))))

    def likely(point: Point, hessian: FloatArray, before: FloatArray) -> FloatArray:
        tangent, root = manifold.log(known, point)[:first], definite.roots(hessian, first)
        spreads = likely_spreads(tangent, np.sum(root**2, axis=1), prior.link_spreads, prior.certainty)
        apart = likely_own(prior.alike, np.split(before, ends)[2], tangent, root)
        return np.concatenate([spreads, [priors.inflation_of(rows, manifold, point, known, root)], apart])

    begin = np.concatenate([spreads, [inflation], own_spreads])
    if afresh and bodies:
        point = priors.centred_payloads(objective(begin), point, len(bodies))
    found = fit_scales(objective, point, begin, None if fixed else likely)
    spreads, (inflation,), own_spreads = np.split(found.scales, ends)
    point = found.point
    score = found.score + design.cost + cost_of_spreads(spreads, prior.link_spreads, prior.certainty)
    score += cost + priors.cost_of_inflation(rows, inflation) + prior.cost + cost_of_own(prior.alike, own_spreads)
    score += sum(c.cost for c in chosen)
    places = {term: place for place, term in enumerate(terms)}
    payloads = iter(point.parameters[first : manifold.inertial.stop].reshape(-1, 10))
    changes = {
        c: np.array([point.reals[places[term]] - prior.value(term) for term in c.terms])
        if c.payload is None
        else next(payloads)
        for c in chosen
    }
    return JointFit(
        chosen=tuple(chosen),
        terms=terms,
        point=point,
        manifold=manifold,
        score=score,
        squares=profile.squares(point),
        packed=Packed.of(found.hessian),
        weights=found.objective.weights,
        spreads=spreads,
        inflation=inflation,
        own_spreads=own_spreads,
        changes=changes,
    )


def _products(rows: FloatArray, residuals: FloatArray) -> FloatArray:
    """Of the columns ``(N, D)`` and residuals of rows, ``(D + 1, D + 1)``."""
    augmented = np.column_stack([rows, residuals])
    return np.asarray(augmented.T @ augmented)


def _known_rows(prior: Prior[Term], chosen: Sequence[Chosen], manifold: ParameterManifold) -> tuple[FloatArray, float]:
    """What other recordings say, see :meth:`OtherRecordings.of_now`, where coefficients with names are others now; no
    rows without any."""
    if prior.known is None:
        return np.zeros((0, manifold.dimension + 1)), 0.0
    named = {term for c in chosen for term in c.terms}
    told = zip(prior.terms, prior.spreads.tolist(), prior.known.changes, strict=False)
    others = {place: spread for place, (term, spread, _) in enumerate(told) if term in named}
    return prior.known.of_now(manifold.dimension, int(manifold.real.start), others)


def _zero_rows(driven: FloatArray | None, manifold: ParameterManifold, known: Point) -> FloatArray:
    """Rows for all parameters, and as the last column their residuals at the prior ``(r, D + 1)``."""
    if driven is None:
        return np.zeros((0, manifold.dimension + 1))
    return np.column_stack([np.zeros((len(driven), manifold.real.start)), driven, driven @ known.reals])


def unfitted(prior: Prior[Term]) -> JointFit[Any, Term]:
    """What is known before, as if it were a fit to no data."""
    manifold = StraightManifold(len(prior.inertias) // 10, 0, np.ones(len(prior.values)))
    size = manifold.dimension
    return JointFit(
        chosen=(),
        terms=prior.terms,
        point=manifold.point(np.concatenate([prior.inertias, prior.values])),
        manifold=manifold,
        score=np.inf,
        squares=np.zeros(0),
        packed=Packed.of(np.eye(size)),
        weights=np.ones(size),
        spreads=prior.link_spreads,
        inflation=1.0,
        own_spreads=prior.own_spreads,
        changes={},
    )


def _known(manifold: ParameterManifold, prior: Prior[Any], bodies: Sequence[int]) -> Point:
    links = prior.inertias.reshape(-1, 10)
    payloads = [priors.usual_payload(links, body) for body in bodies]
    reals = np.zeros(len(manifold.scales))
    reals[: len(prior.values)] = prior.values
    return manifold.point(np.concatenate([prior.inertias, *payloads, reals]))


def _first_point(
    manifold: ParameterManifold,
    known: Point,
    start: JointFit[Chosen, Term] | None,
    bodies: Sequence[int],
    terms: Sequence[Term],
) -> Point:
    if start is None:
        return known
    links = manifold.links - len(bodies)
    payloads = [
        start.point.pseudo_inertias[links + start.bodies.index(body)]
        if body in start.bodies
        else known.pseudo_inertias[links + place]
        for place, body in enumerate(bodies)
    ]
    fitted = set(start.terms)
    reals = [start.value(t) if t in fitted else float(known.reals[i]) for i, t in enumerate(terms)]
    inertias = [*start.point.pseudo_inertias[:links], *payloads]
    return Point(np.array(inertias), np.zeros(0), np.array(reals))


def scattered(design: Design, found: JointFit[Chosen, Term]) -> JointFit[Chosen, Term]:
    """A fit with standard deviations at least as large as the scatter of blocks of time says.

    Where the model has errors, what it says of one block differs from what it says of the next by more than noise
    explains. The covariance of the tangent coordinates is then ``H^-1 sum_b(s_b s_b^T) H^-1`` with the slopes s_b of
    the blocks about their mean (Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986).
    """
    slopes = np.zeros((BLOCKS, found.manifold.dimension))
    vector, places = np.append(found.point.parameters, -1.0), design.places(found.bodies, found.terms)
    weights = design.counts / found.squares
    for channel, own, variances, weight in zip(design.channels, places, design.variances, weights, strict=True):
        columns, residual = channel.whitened(vector, own, variances)
        for block, rows in enumerate(np.array_split(np.arange(len(residual)), BLOCKS)):
            slopes[block] += weight * (residual[rows] @ columns[rows, :-1])
    slopes = found.manifold.whiten(found.point, slopes)
    moved = (slopes - np.mean(slopes, axis=0)) @ found.inverse
    squares = BLOCKS / (BLOCKS - 1.0) * np.sum(moved**2, axis=0)
    factors = np.sqrt(np.maximum(squares / np.diag(found.inverse), 1.0))
    return replace(found, packed=Packed.of(found.information / np.outer(factors, factors)))
