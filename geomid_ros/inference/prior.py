"""What is known before the joint fit: of links and effects, of payloads, and from other recordings.

Other recordings are those from which a model was identified before, beside the recordings at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np

from geomid_ros.estimation.link_priors import common_spreads
from geomid_ros.estimation.profile_objective import ProfileObjective, StraightManifold
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.inference.hypothesis import Term
from geomid_ros.model.alike_parts import OWN_SPREAD, AlikeParts
from geomid_ros.types import FloatArray, IntArray

GAIN = 0.03
"""Standard deviation of the efforts' common gain, relative, unless it is known: of torques from motor currents."""
SPREAD_OF_PAYLOADS = 3.0
"""Of a payload about the usual one, a geodesic distance: next to nothing is known."""
_PAYLOAD_MASS = 0.2  # of the mean link's mass
_PAYLOAD_SIZE = 0.1  # [m]
_CENTRINGS = 5
_SPREAD_OF_CHANGED = 0.5  # of a link that has been changed, a geodesic distance
_CERTAINTY = 4.0
"""That they are as exact as they say counts as much as so many of their rows."""


@dataclass(frozen=True, eq=False)
class OtherRecordings:
    """What other recordings say of links, and of effects that were identified together with them.

    ``|residuals + rows x|^2`` is minus twice the logarithm of their likelihood at parameters x off the prior, up to a
    constant.

    Attributes:
        rows: ``(r, 10 links + k)`` of the links and of the first k coefficients that the prior has.
        residuals: ``(r,)``.
        changes: ``(k,)`` standard deviations of what each coefficient has changed by since then.
    """

    rows: FloatArray
    residuals: FloatArray
    changes: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def links(self) -> int:
        """How many of the rows' columns are of links."""
        return int(self.rows.shape[1]) - len(self.changes)

    def of_coefficients(self, places: IntArray, changes: FloatArray) -> OtherRecordings:
        """The same of those of its coefficients at some places ``(n,)``, with what they have changed by ``(n,)``."""
        columns = np.append(np.arange(self.links), self.links + places)
        return replace(self, rows=self.rows[:, columns], changes=changes)

    def beside(self, columns: FloatArray) -> tuple[OtherRecordings, float]:
        """The same beside further unknowns of unit variance, of which the residuals have ``columns (r, n)``; and what
        that adds to minus twice the logarithm of the likelihood."""
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        shorter = directions * (1.0 / np.hypot(1.0, sizes) - 1.0)
        rows, residuals = (each + shorter @ (directions.T @ each) for each in (self.rows, self.residuals))
        return replace(self, rows=rows, residuals=residuals), float(np.sum(np.log1p(sizes**2)))

    def trusted(self, inflation: float) -> OtherRecordings:
        """The same with variances that are larger by a factor."""
        root = np.sqrt(inflation)
        return OtherRecordings(self.rows / root, self.residuals / root, self.changes * root)

    @cached_property
    def _changed(self) -> tuple[OtherRecordings, float]:
        return self.beside(self.rows[:, self.links :] * self.changes)

    def of_now(self, dimension: int, first: int, others: Mapping[int, float]) -> tuple[FloatArray, float]:
        """Rows for the D parameters of now, of which coefficients begin with the ``first``; as the last column their
        residuals at the prior ``(r, D + 1)``. And what the changes since then add to minus twice the logarithm of the
        likelihood. Some coefficients, by their places, are others now: of these nothing is said, and what they were
        then is known as well as these standard deviations say, and the rows."""
        own, cost = self._changed
        gone = [self.links + place for place in others]
        own, more = own.beside(own.rows[:, gone] * [*others.values()])
        told = own.rows.copy()
        told[:, gone] = 0.0
        rows = np.zeros((len(told), dimension + 1))
        rows[:, : self.links], rows[:, -1] = told[:, : self.links], own.residuals
        rows[:, first : first + len(self.changes)] = told[:, self.links :]
        return rows, cost + more


def nothing_held(_: Sequence[object], values: FloatArray) -> FloatArray:
    """No rows for ``values (k,)``."""
    return np.zeros((0, len(values)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Prior(Generic[Term]):
    """What is known before the fit.

    Attributes:
        inertias: the links' parameters ``(10 links,)``.
        spread: the usual size of their errors, a geodesic distance.
        terms, values, spreads: the coefficients ``(k,)`` of the effects that the model already has.
        certainty: how many directions of a link's error the usual spread counts as much as.
        identified: whether all this was identified before, not guessed.
        known: what other recordings say of the links, and of effects.
        changed_link: one that is another now than in the other recordings.
        cost: minus twice the logarithm of what this makes of the other recordings' probability.
        alike: links whose errors are mostly the same ones.
        held: rows ``(r, k)`` that hold combinations of coefficients at zero, for their terms and values.
    """

    inertias: FloatArray
    spread: float
    terms: tuple[Term, ...]
    values: FloatArray
    spreads: FloatArray
    certainty: float
    identified: bool = False
    known: OtherRecordings | None = None
    changed_link: int | None = None
    cost: float = 0.0
    alike: Sequence[AlikeParts] = ()
    held: Callable[[Sequence[Term], FloatArray], FloatArray] = nothing_held

    @property
    def by_itself(self) -> Prior[Term]:
        """The prior without other recordings, with what these and it say of each effect by itself."""
        if self.known is None:
            return self
        manifold = StraightManifold(len(self.inertias) // 10, 0, np.ones(0))
        links = manifold.whiten(manifold.point(self.inertias), self.known.rows[:, : self.known.links])
        rows = np.column_stack([links * self.spread, self.known.rows[:, self.known.links :]])
        told = len(self.known.changes)
        rows[:, self.known.links :] *= self.spreads[:told]
        share = np.diag(np.linalg.inv(rows.T @ rows + np.eye(rows.shape[1])))[self.known.links :]
        then = np.append(np.sqrt(share) * self.spreads[:told], self.spreads[told:])
        spreads = np.hypot(then, np.append(self.known.changes, np.zeros(len(then) - told)))
        return replace(self, known=None, spreads=spreads)

    @property
    def link_spreads(self) -> FloatArray:
        """The usual size of each link's error ``(links,)``."""
        spreads = common_spreads(self.alike, np.full(len(self.inertias) // 10, self.spread))
        if self.changed_link is not None:
            spreads[self.changed_link] = _SPREAD_OF_CHANGED
        return spreads

    @property
    def own_spreads(self) -> FloatArray:
        """The usual size of the part of their errors that each of the n links has by itself that are alike ``(n,)``."""
        return np.full(sum(len(group.members) for group in self.alike), OWN_SPREAD)

    def with_changed(self, link: int) -> Prior[Term]:
        """The same of a robot of which a link has been changed since the other recordings: these say of the other links
        what they say whatever that one was, whose error has the usual spread."""
        if self.known is None:
            return self
        manifold, places = StraightManifold(len(self.inertias) // 10, 0, np.ones(0)), slice(10 * link, 10 * link + 10)
        links = self.known.rows[:, : self.known.links]
        own = self.spread * manifold.whiten(manifold.point(self.inertias), links)[:, places]
        known, cost = self.known.beside(own)
        rows = known.rows.copy()
        rows[:, places] = 0.0
        return replace(self, known=replace(known, rows=rows), changed_link=link, cost=cost)

    def value(self, term: Term) -> float:
        """A coefficient as the model has it, 0 if it has none."""
        return float(self.values[self.terms.index(term)]) if term in self.terms else 0.0


def usual_payload(links: FloatArray, carrier: int) -> FloatArray:
    """Parameters ``(10,)`` of the body that a payload of one of the ``links (n, 10)`` usually is."""
    return _ball(_PAYLOAD_MASS * float(np.mean(links[:, 0])), links[carrier, 1:4] / links[carrier, 0])


def _ball(mass: float, centre: FloatArray) -> FloatArray:
    """Parameters ``(10,)`` of a body of a payload's usual size."""
    pseudo = mass * np.diag([_PAYLOAD_SIZE**2] * 3 + [1.0])
    pseudo[:3, :3] += mass * np.outer(centre, centre)
    pseudo[:3, 3] = pseudo[3, :3] = mass * centre
    return pseudo_inertia.to_parameters(pseudo)


def centred_payloads(objective: ProfileObjective, point: Point, payloads: int) -> Point:
    """With the last bodies where least squares that knows no cone wants their masses and centres.

    From elsewhere a body gets there by growing thin, and then hardly moves any more.
    """
    manifold = objective.manifold
    places = slice(manifold.inertial.stop - 10 * payloads, manifold.inertial.stop)
    evaluation = objective.evaluate(point)
    for _ in range(_CENTRINGS):
        hessian = evaluation.information + np.diag(objective.weights)
        step = -np.linalg.solve(hessian, evaluation.gradient)
        parameters = point.parameters.copy()
        wanted = parameters + manifold.whiten(point, np.eye(manifold.dimension)) @ step
        bodies = wanted[places].reshape(-1, 10)
        if np.any(bodies[:, 0] <= 0.0):
            break
        parameters[places] = np.concatenate([_ball(body[0], body[1:4] / body[0]) for body in bodies])
        candidate = manifold.point(parameters)
        if not _is_body(candidate.pseudo_inertias):
            break
        trial = objective.evaluate(candidate)
        if not trial.value < evaluation.value:  # nor a number
            break
        point, evaluation = candidate, trial
    return point


def _is_body(pseudo_inertias: FloatArray) -> bool:
    """Whether rounding leaves bodies ``(n, 4, 4)`` what bodies can be: of a few grams far away it does not."""
    if not np.all(np.isfinite(pseudo_inertias)):
        return False
    sizes = np.linalg.eigvalsh(pseudo_inertias)
    return bool(np.all(sizes[:, 0] > np.finfo(np.float64).eps * sizes[:, -1]))


def inflation_of(rows: FloatArray, manifold: ParameterManifold, point: Point, prior: Point, root: FloatArray) -> float:
    """By how much the variances of ``rows (r, D + 1)`` of the links are larger than they say, at least 1, as a fit
    shows whose covariance of the links has the ``root (10 links, D)``: their model had errors, too.

    MacKay's re-estimate, as of the prior's spread: mean square of the residuals, the fit's uncertainty included.
    """
    if not len(rows):
        return 1.0
    off = rows @ np.append(point.parameters - prior.parameters, 1.0)
    normals = manifold.whiten(point, rows[:, :-1])
    unsure = float(np.sum((normals[:, : len(root)] @ root) ** 2))
    return max(1.0, (float(off @ off) + unsure + _CERTAINTY) / (_telling(rows) + _CERTAINTY))


def contradiction(rows: FloatArray, off: FloatArray) -> float:
    """The inflation, at least 1, with which the rows are as wrong as they say at parameters that are ``off (D,)`` the
    prior."""
    return max(1.0, float(np.sum((rows @ np.append(off, 1.0)) ** 2)) / max(1, _telling(rows)))


def cost_of_inflation(rows: FloatArray, inflation: float) -> float:
    """Minus twice the logarithm of its probability, beside that of the rows' residuals in units of the enlarged
    standard deviations."""
    return (_telling(rows) + _CERTAINTY) * float(np.log(inflation)) + _CERTAINTY * (1.0 / inflation - 1.0)


def _telling(rows: FloatArray) -> int:
    """How many of the rows say something."""
    sizes = np.linalg.norm(rows[:, :-1], axis=1)
    return int(np.count_nonzero(sizes > 1e-6 * np.max(sizes, initial=0.0)))
