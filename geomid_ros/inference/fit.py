"""The joint fit: all inertias under the geometric prior, payloads and effects, for channels of unknown noise.

Minus twice the log likelihood, maximised over each channel's variance, is ``sum_c N_c log S_c`` with the sums of
squares S_c. The prior on a link is Gaussian in geodesic distance. Its standard deviation is estimated for each link:
marginal likelihood in Laplace's approximation (MacKay 1992), inverse-gamma prior around the default. So large inertial
errors widen the prior instead of passing for an effect, and one wrong link loosens no other.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.fit import prior_std_cost, reestimated_prior_stds
from geomid_ros.estimation.link_priors import alike_rows, individual_std_cost, reestimated_individual_stds
from geomid_ros.estimation.problem import held_mass_rows
from geomid_ros.estimation.profile_objective import Profile, ProfileObjective, fit_scales
from geomid_ros.estimation.uncertainty import with_enlarged_prior
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.spd import Packed
from geomid_ros.inference import prior as priors
from geomid_ros.inference.candidates import Candidate, EffectTerm, passivity_constraints
from geomid_ros.inference.design import BLOCKS, Design, RemainderFit
from geomid_ros.inference.prior import Prior
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class JointFit:
    """The minimum for a set of candidates.

    Attributes:
        chosen: the candidates.
        terms: the fitted coefficients: those of the model, then those of the candidates.
        point, manifold: the D parameters: inertias of links and payloads, then the coefficients.
        score: minus twice the log marginal likelihood, plus the candidates' costs.
        squares: whitened sums of squares ``(C,)``.
        packed: the :attr:`information`, packed because a search keeps hundreds of fits.
        weights: the prior's part of its diagonal ``(D,)``, other recordings excluded.
        prior_stds: prior standard deviations of the links' errors ``(links,)``, geodesic distances.
        inflation: factor on the variances of the other recordings.
        separate_prior_stds: prior standard deviations of the individual errors of the links that are alike ``(n,)``.
        identified: True if the prior's links were identified, not guessed.
        changes: change ``(k,)`` of each candidate's coefficients from their known values, or its body's parameters.
    """

    chosen: tuple[Candidate, ...] = ()
    terms: tuple[EffectTerm, ...]
    point: Point
    manifold: ParameterManifold
    score: float
    squares: FloatArray
    packed: Packed
    weights: FloatArray
    prior_stds: FloatArray
    inflation: float
    separate_prior_stds: FloatArray
    identified: bool
    changes: Mapping[Candidate, FloatArray] = field(default_factory=dict)

    @property
    def information(self) -> FloatArray:
        """Hessian ``(D, D)`` of half the score in tangent coordinates."""
        return self.packed.full

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
        """Parameters ``(links, 10)`` of the links with their payloads."""
        inertias = self.inertias
        for carrier, payload in zip(self.bodies, self.point.pseudo_inertias[len(inertias) :], strict=True):
            inertias[carrier] += pseudo_inertia.to_parameters(payload)
        return inertias

    @cached_property
    def inverse(self) -> FloatArray:
        """Inverse of the information ``(D, D)``."""
        return spd.inverse(self.information)

    @cached_property
    def inverse_from_data(self) -> FloatArray:
        """Inverse of the information ``(D, D)`` if the prior errors of links that were not identified were three times
        as large: a body that is known even then is known from the data, not from the URDF's other links."""
        if self.identified:
            return self.inverse
        links = 10 * len(self.prior_stds)
        from_links = np.sqrt(self.weights[:links]) * self.inverse[:, :links]
        return with_enlarged_prior(self.inverse, from_links @ from_links.T)

    def body_covariance(self, place: int) -> FloatArray:
        """Covariance ``(10, 10)`` of the parameters of a body, from the data."""
        rows, jacobian = self.manifold.link(place), self.manifold.jacobian(self.point)[0][place]
        return np.asarray(jacobian @ self.inverse_from_data[rows, rows] @ jacobian.T)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters ``(D, D)``."""
        blocks, diagonal = self.manifold.jacobian(self.point)
        transposed = blocks.swapaxes(1, 2)
        half = self.manifold.by_blocks(self.inverse, transposed, diagonal)
        return self.manifold.by_blocks(half.T, transposed, diagonal)

    def covariance_of(self, terms: Sequence[EffectTerm]) -> FloatArray:
        """Covariance of some coefficients ``(k, k)``."""
        indices = [self._places[term] for term in terms]
        places, scales = int(self.manifold.real.start) + np.array(indices, dtype=np.intp), self.manifold.scales[indices]
        return np.asarray(self.inverse[places[:, None], places] * np.outer(scales, scales))

    def with_fitted_remainder(self, design: Design, among: Collection[int] | None = None) -> Design:
        """Return the design with the most likely remainder at this fit, for all channels or those in ``among``."""
        named = np.zeros(len(design.channels))
        for candidate, values in self.changes.items():
            named += design.powers(candidate, values) / self.squares
        return design.with_fitted_remainder(self.bodies, self.terms, self.point.parameters, named, among)

    def remainders(self, design: Design) -> list[RemainderFit]:
        """Remainder of each channel at this fit."""
        return design.remainders(self.bodies, self.terms, self.point.parameters)

    def gains_of_features(self, design: Design, place: int, names: Sequence[str]) -> dict[str, float]:
        """Evidence for the features of each name, see :meth:`Design.gains_of_features`."""
        return design.gains_of_features(self.bodies, self.terms, self.point.parameters, place, names)

    def parameters_by_channel(self, design: Design) -> FloatArray:
        """Effective number of parameters of each channel ``(C,)``: trace of its information times the covariance."""
        products = design.gather(self.bodies, self.terms)
        covariance = np.pad(self.covariance, (0, 1))  # of the target, too
        pairs = zip(products.places, products.blocks, strict=True)
        traces = [float(np.sum(block * covariance[columns[:, None], columns])) for columns, block in pairs]
        return np.asarray(design.counts / self.squares * traces)

    def value(self, term: EffectTerm) -> float:
        """Value of a coefficient."""
        return float(self.point.reals[self._places[term]])

    def place(self, term: EffectTerm) -> int:
        """Index of a coefficient among the parameters."""
        return int(self.manifold.real.start) + self._places[term]

    @cached_property
    def _places(self) -> dict[EffectTerm, int]:
        return {term: place for place, term in enumerate(self.terms)}


def fit(
    design: Design,
    prior: Prior,
    chosen: Sequence[Candidate],
    start: JointFit | None = None,
    prior_std: float | FloatArray | None = None,
) -> JointFit:
    """Fit the chosen candidates together with all known parameters, from an earlier fit if one is given.

    The links' prior stds and the trust in other recordings are estimated, unless a ``prior_std`` fixes the prior std of
    all links, or of each. Recordings that contradict each other give two minima: either the others are right and the
    present measurement is mostly error, or the reverse. At first the others count nothing. Unless they are trusted in
    the end, both are searched; the more likely one is returned. A start that trusts the others does so when more
    candidates explain the present measurement, too.
    """
    others = prior.other_recordings
    trusted = start is not None and start.inflation == 1.0 and set(start.chosen) < set(chosen)
    if others is None or prior_std is not None or trusted or others.trusted:
        return _fit(design, prior, chosen, start, prior_std)
    loose = _fit(design, prior, chosen, start, inflation=np.inf)
    if loose.inflation == 1.0:
        return loose
    return min(loose, _fit(design, prior, chosen, start), key=lambda fitted: fitted.score)


def _fit(
    design: Design,
    prior: Prior,
    chosen: Sequence[Candidate],
    start: JointFit | None,
    prior_std: float | FloatArray | None = None,
    inflation: float = 1.0,
) -> JointFit:
    """Return the minimum reached from the start, in which dry friction drives no joint. The search begins with this
    ``inflation`` of the other recordings."""
    free = _free_fit(design, prior, chosen, start, prior_std, inflation)
    rows = passivity_constraints(free.terms, free.point.reals)
    if not len(rows):
        return free
    return _free_fit(design, prior, chosen, free, prior_std, free.inflation, constraints=rows)


def _free_fit(
    design: Design,
    prior: Prior,
    chosen: Sequence[Candidate],
    start: JointFit | None,
    prior_std: float | FloatArray | None,
    inflation: float,
    constraints: FloatArray | None = None,
) -> JointFit:
    """Return the minimum reached from the start; ``constraints``: rows ``(r, terms)`` of coefficients fixed at zero."""
    bodies = [c.payload for c in chosen if c.payload is not None]
    terms = tuple(dict.fromkeys([*prior.terms, *(term for c in chosen for term in c.terms)]))
    products = design.gather(bodies, terms)
    scales = design.scales(terms)
    manifold = ParameterManifold(len(prior.inertias) // 10 + len(bodies), 0, scales)
    prior_point = _known(manifold, prior, bodies)
    payloads_at = len(prior.inertias)
    known_stds = dict(zip(prior.terms, prior.prior_stds.tolist(), strict=True))
    known_stds |= {term: std for c in chosen for term, std in zip(c.terms, design.prior_stds(c), strict=True)}
    weights = np.ones(manifold.dimension)
    weights[manifold.real] = (scales / np.array([known_stds[term] for term in terms])) ** 2
    weights[payloads_at : manifold.inertial.stop] = priors.PAYLOAD_PRIOR_STD**-2
    rows, cost = _known_rows(prior, chosen, manifold)
    earlier = _products(manifold.offset_rows(prior_point, rows[:, :-1]), rows[:, -1])
    zeros: FloatArray | float = 0.0
    if constraints is not None:
        zero_rows = np.column_stack([np.zeros((len(constraints), manifold.real.start)), constraints])
        zeros = _products(manifold.offset_rows(prior_point, zero_rows), constraints @ prior_point.reals)
    from_scratch = start is None or set(bodies) != set(start.bodies)
    fixed = prior_std is not None
    link_stds = np.full(payloads_at // 10, prior.link_prior_stds if prior_std is None else prior_std)
    if start is not None and not (fixed or from_scratch):
        link_stds = start.prior_stds
    profile = Profile(manifold, products, design.counts, prior_point, design.floors)
    point = _first_point(manifold, prior_point, None if from_scratch else start, bodies, terms)

    individual_stds = prior.separate_prior_stds if start is None else start.separate_prior_stds
    ends = [len(link_stds), len(link_stds) + 1]

    masses_held = np.array(prior.masses_held, dtype=np.int64)
    trusted = prior.other_recordings is not None and prior.other_recordings.trusted

    def objective(prior_scales: FloatArray) -> ProfileObjective:
        links, inflation, individual = np.split(prior_scales, ends)
        precision = np.append(np.repeat(links, 10) ** -2.0, weights[payloads_at:])
        masses = held_mass_rows(prior_point, masses_held, prior.link_prior_stds, links)
        alike = alike_rows(prior.alike, individual, manifold.dimension)
        held = np.concatenate([alike, manifold.offset_rows(prior_point, masses)])
        return ProfileObjective(profile, precision, earlier / inflation + zeros + _products(held, np.zeros(len(held))))

    def likely(point: Point, hessian: FloatArray, previous: FloatArray) -> FloatArray:
        tangent, root = manifold.log(prior_point, point)[:payloads_at], spd.roots(hessian, payloads_at)
        link_stds = reestimated_prior_stds(tangent, np.sum(root**2, axis=1), prior.link_prior_stds, prior.certainty)
        individual = reestimated_individual_stds(prior.alike, np.split(previous, ends)[2], tangent, root)
        inflation = 1.0 if trusted else priors.inflation_of(rows, manifold, point, prior_point, root)
        return np.concatenate([link_stds, [inflation], individual])

    begin = np.concatenate([link_stds, [inflation], individual_stds])
    if from_scratch and bodies:
        point = priors.centred_payloads(objective(begin), point, len(bodies))
    solution = fit_scales(objective, point, begin, None if fixed else likely)
    link_stds, (inflation,), individual_stds = np.split(solution.scales, ends)
    point = solution.point
    score = solution.score + design.cost + prior_std_cost(link_stds, prior.link_prior_stds, prior.certainty)
    score += (
        cost
        + priors.cost_of_inflation(rows, inflation)
        + prior.cost
        + individual_std_cost(prior.alike, individual_stds)
    )
    score += sum(c.cost for c in chosen)
    places = {term: place for place, term in enumerate(terms)}
    payloads = iter(point.parameters[payloads_at : manifold.inertial.stop].reshape(-1, 10))
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
        packed=Packed.of(solution.hessian),
        weights=solution.objective.weights,
        prior_stds=link_stds,
        inflation=inflation,
        separate_prior_stds=individual_stds,
        identified=prior.identified,
        changes=changes,
    )


def _products(rows: FloatArray, residuals: FloatArray) -> FloatArray:
    """Products of the columns ``(N, D)`` and residuals of rows ``(D + 1, D + 1)``."""
    augmented = np.column_stack([rows, residuals])
    return np.asarray(augmented.T @ augmented)


def _known_rows(prior: Prior, chosen: Sequence[Candidate], manifold: ParameterManifold) -> tuple[FloatArray, float]:
    """Rows of other recordings and their cost, none without any; see :meth:`OtherRecordings.present_rows`. Coefficients
    of the chosen candidates have changed since then."""
    if prior.other_recordings is None:
        return np.zeros((0, manifold.dimension + 1)), 0.0
    named = {term for c in chosen for term in c.terms}
    triples = zip(prior.terms, prior.prior_stds.tolist(), prior.other_recordings.changes, strict=False)
    others = {place: prior_std for place, (term, prior_std, _) in enumerate(triples) if term in named}
    return prior.other_recordings.present_rows(manifold.dimension, int(manifold.real.start), others)


def fit_of_prior(prior: Prior) -> JointFit:
    """The prior as a fit to no data."""
    manifold = ParameterManifold(len(prior.inertias) // 10, 0, np.ones(len(prior.values)))
    size = manifold.dimension
    return JointFit(
        terms=prior.terms,
        point=manifold.point(np.concatenate([prior.inertias, prior.values])),
        manifold=manifold,
        score=np.inf,
        squares=np.zeros(0),
        packed=Packed.of(np.eye(size)),
        weights=np.ones(size),
        prior_stds=prior.link_prior_stds,
        inflation=1.0,
        separate_prior_stds=prior.separate_prior_stds,
        identified=prior.identified,
    )


def _known(manifold: ParameterManifold, prior: Prior, bodies: Sequence[int]) -> Point:
    links = prior.inertias.reshape(-1, 10)
    payloads = [priors.default_payload(links, body) for body in bodies]
    reals = np.zeros(len(manifold.scales))
    reals[: len(prior.values)] = prior.values
    return manifold.point(np.concatenate([prior.inertias, *payloads, reals]))


def _first_point(
    manifold: ParameterManifold,
    prior_point: Point,
    start: JointFit | None,
    bodies: Sequence[int],
    terms: Sequence[EffectTerm],
) -> Point:
    """Point of an earlier fit with the same bodies, if there is one; its other terms have the prior's values."""
    if start is None:
        return prior_point
    links = manifold.links - len(bodies)
    order = [*range(links), *(links + start.bodies.index(body) for body in bodies)]
    fitted = set(start.terms)
    reals = [start.value(t) if t in fitted else float(prior_point.reals[i]) for i, t in enumerate(terms)]
    return Point(start.point.pseudo_inertias[order], np.zeros(0), np.array(reals))


def scattered(design: Design, found: JointFit) -> JointFit:
    """Enlarge the standard deviations of a fit to at least the scatter between blocks of time.

    If the model has errors, blocks differ by more than noise explains. The covariance of the tangent coordinates is
    then ``H^-1 sum_b(s_b s_b^T) H^-1`` with the slopes s_b of the blocks about their mean (Liang and Zeger,
    "Longitudinal data analysis using generalized linear models", 1986).
    """
    slopes = np.zeros((BLOCKS, found.manifold.dimension))
    vector, places = np.append(found.point.parameters, -1.0), design.places(found.bodies, found.terms)
    weights = design.counts / found.squares
    for channel, indices, variances, weight in zip(design.channels, places, design.variances, weights, strict=True):
        columns, residual = channel.whitened(vector, indices, variances)
        for block, rows in enumerate(np.array_split(np.arange(len(residual)), BLOCKS)):
            slopes[block] += weight * (residual[rows] @ columns[rows, :-1])
    slopes = found.manifold.whiten(found.point, slopes)
    moved = (slopes - np.mean(slopes, axis=0)) @ found.inverse
    squares = BLOCKS / (BLOCKS - 1.0) * np.sum(moved**2, axis=0)
    factors = np.sqrt(np.maximum(squares / np.diag(found.inverse), 1.0))
    packed = Packed.of(found.information / np.outer(factors, factors))
    return replace(found, packed=packed, weights=found.weights / factors**2)
