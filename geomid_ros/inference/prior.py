"""Prior of the joint fit: links, effects, payloads, and earlier recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.link_priors import common_prior_stds
from geomid_ros.estimation.profile_objective import ProfileObjective
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.inference.candidates import EffectTerm
from geomid_ros.model.alike_parts import ALIKE_PRIOR_STD, AlikeParts
from geomid_ros.types import FloatArray, IntArray

GAIN = 0.03
"""Relative standard deviation of a common gain of all efforts, unless it is known; of torques from motor currents."""
PAYLOAD_PRIOR_STD = 3.0
"""Prior standard deviation of a payload about the default one, a geodesic distance: almost no information."""
_PAYLOAD_MASS = 0.2  # fraction of the mean link mass
_PAYLOAD_SIZE = 0.1  # [m]
_CENTRINGS = 5
_STD_OF_CHANGED = 0.5  # prior standard deviation of a changed link, a geodesic distance
_CERTAINTY = 4.0
"""Weight, in rows, of the prior that other recordings are as exact as they state."""


@dataclass(frozen=True, eq=False)
class OtherRecordings:
    """Information from other recordings on links, and on effects that were identified together with them.

    ``|residuals + rows x|^2`` is minus twice their log likelihood at parameters x relative to the prior, up to a
    constant.

    Attributes:
        rows: ``(r, 10 links + k)`` for the links and the first k coefficients of the prior.
        residuals: ``(r,)``.
        changes: prior standard deviation of the change of each coefficient since then ``(k,)``.
        trusted: True if they are as exact as they state, whatever contradicts them.
    """

    rows: FloatArray
    residuals: FloatArray
    changes: FloatArray = field(default_factory=lambda: np.zeros(0))
    trusted: bool = False

    @property
    def links(self) -> int:
        """Number of columns of ``rows`` that belong to links."""
        return int(self.rows.shape[1]) - len(self.changes)

    def of_coefficients(self, places: IntArray, changes: FloatArray) -> OtherRecordings:
        """Keep only the coefficients at ``places (n,)``, with standard deviations ``changes (n,)``."""
        columns = np.append(np.arange(self.links), self.links + places)
        return replace(self, rows=self.rows[:, columns], changes=changes)

    def marginalised(self, columns: FloatArray) -> tuple[OtherRecordings, float]:
        """Marginalise over further unknowns of unit variance, of which the residuals have ``columns (r, n)``. Return
        the result, and its addition to minus twice the log likelihood."""
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        shrinkage = directions * (1.0 / np.hypot(1.0, sizes) - 1.0)
        rows, residuals = (values + shrinkage @ (directions.T @ values) for values in (self.rows, self.residuals))
        return replace(self, rows=rows, residuals=residuals), float(np.sum(np.log1p(sizes**2)))

    def inflated(self, inflation: float) -> OtherRecordings:
        """Return a copy with all variances multiplied by ``inflation``."""
        root = np.sqrt(inflation)
        return replace(self, rows=self.rows / root, residuals=self.residuals / root, changes=self.changes * root)

    @cached_property
    def _changed(self) -> tuple[OtherRecordings, float]:
        return self.marginalised(self.rows[:, self.links :] * self.changes)

    def present_rows(self, dimension: int, first: int, others: Mapping[int, float]) -> tuple[FloatArray, float]:
        """Return rows for the present D parameters, with the residuals at the prior as last column ``(r, D + 1)``, and
        what the changes since then add to minus twice the log likelihood. Coefficients begin at the parameter
        ``first``. ``others`` are indices of coefficients that are different now, with standard deviations of their
        earlier values: the rows constrain these, but not the present ones."""
        earlier, cost = self._changed
        changed = [self.links + place for place in others]
        earlier, added = earlier.marginalised(earlier.rows[:, changed] * [*others.values()])
        kept = earlier.rows.copy()
        kept[:, changed] = 0.0
        rows = np.zeros((len(kept), dimension + 1))
        rows[:, : self.links], rows[:, -1] = kept[:, : self.links], earlier.residuals
        rows[:, first : first + len(self.changes)] = kept[:, self.links :]
        return rows, cost + added


@dataclass(frozen=True, eq=False, kw_only=True)
class Prior:
    """Knowledge before the fit.

    Attributes:
        inertias: the links' parameters ``(10 links,)``.
        prior_std: prior standard deviation of a link's error, a geodesic distance.
        terms, values, prior_stds: coefficients ``(k,)`` of the effects in the model, and their prior stds.
        certainty: weight of ``prior_std`` when it is re-estimated, in directions of a link's error.
        identified: True if all this was identified, not guessed.
        other_recordings: information from other recordings on the links, and on effects.
        changed_link: link that differs now from the one in the other recordings.
        cost: minus twice the log of the factor that this change puts on the likelihood of the other recordings.
        alike: groups of links that have most of their errors in common.
        masses_held: indices of the links that may leave their prior, but not with their mass.
    """

    inertias: FloatArray
    prior_std: float
    terms: tuple[EffectTerm, ...]
    values: FloatArray
    prior_stds: FloatArray
    certainty: float
    identified: bool = False
    other_recordings: OtherRecordings | None = None
    changed_link: int | None = None
    cost: float = 0.0
    alike: Sequence[AlikeParts] = ()
    masses_held: Sequence[int] = ()

    @property
    def without_other_recordings(self) -> Prior:
        """Prior without other recordings, which are reduced to a standard deviation for each effect."""
        others = self.other_recordings
        if others is None:
            return self
        manifold = ParameterManifold(len(self.inertias) // 10, 0, np.ones(0))
        links = manifold.whiten(manifold.point(self.inertias), others.rows[:, : others.links])
        rows = np.column_stack([links * self.prior_std, others.rows[:, others.links :]])
        count = len(others.changes)
        rows[:, others.links :] *= self.prior_stds[:count]
        variances = np.diag(np.linalg.inv(rows.T @ rows + np.eye(rows.shape[1])))[others.links :]
        earlier = np.append(np.sqrt(variances) * self.prior_stds[:count], self.prior_stds[count:])
        prior_stds = np.hypot(earlier, np.append(others.changes, np.zeros(len(earlier) - count)))
        return replace(self, other_recordings=None, prior_stds=prior_stds)

    @property
    def link_prior_stds(self) -> FloatArray:
        """Prior standard deviation of each link's error ``(links,)``, sqrt(n) times larger for n links that are
        alike."""
        prior_stds = common_prior_stds(self.alike, np.full(len(self.inertias) // 10, self.prior_std))
        if self.changed_link is not None:
            prior_stds[self.changed_link] = _STD_OF_CHANGED
        return prior_stds

    @property
    def separate_prior_stds(self) -> FloatArray:
        """Prior standard deviation of the individual part of each alike link's error ``(n,)``."""
        return np.full(sum(len(group.members) for group in self.alike), ALIKE_PRIOR_STD)

    def with_changed(self, link: int) -> Prior:
        """Return the prior for a robot of which ``link`` has changed since the other recordings. These constrain only
        the other links: the former link is marginalised with the prior std ``prior_std``."""
        if self.other_recordings is None:
            return self
        manifold, places = ParameterManifold(len(self.inertias) // 10, 0, np.ones(0)), slice(10 * link, 10 * link + 10)
        links = self.other_recordings.rows[:, : self.other_recordings.links]
        columns = self.prior_std * manifold.whiten(manifold.point(self.inertias), links)[:, places]
        known, cost = self.other_recordings.marginalised(columns)
        rows = known.rows.copy()
        rows[:, places] = 0.0
        return replace(self, other_recordings=replace(known, rows=rows), changed_link=link, cost=cost)

    def value(self, term: EffectTerm) -> float:
        """Coefficient of ``term`` in the model, 0 if it has none."""
        return float(self.values[self.terms.index(term)]) if term in self.terms else 0.0


def default_payload(links: FloatArray, carrier: int) -> FloatArray:
    """Parameters ``(10,)`` of the default payload on the link ``carrier`` of ``links (n, 10)``."""
    return _ball(_PAYLOAD_MASS * float(np.mean(links[:, 0])), links[carrier, 1:4] / links[carrier, 0])


def _ball(mass: float, centre: FloatArray) -> FloatArray:
    """Parameters ``(10,)`` of a ball of the default payload size."""
    pseudo = mass * np.diag([_PAYLOAD_SIZE**2] * 3 + [1.0])
    pseudo[:3, :3] += mass * np.outer(centre, centre)
    pseudo[:3, 3] = pseudo[3, :3] = mass * centre
    return pseudo_inertia.to_parameters(pseudo)


def centred_payloads(objective: ProfileObjective, point: Point, payloads: int) -> Point:
    """Move the last bodies to the masses and centres of unconstrained least squares.

    From elsewhere a body would get there by becoming thin, and then hardly move any more.
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
        if not trial.value < evaluation.value:  # or NaN
            break
        point, evaluation = candidate, trial
    return point


def _is_body(pseudo_inertias: FloatArray) -> bool:
    """True if bodies ``(n, 4, 4)`` are positive definite after rounding; those of a few grams far away are not."""
    if not np.all(np.isfinite(pseudo_inertias)):
        return False
    sizes = np.linalg.eigvalsh(pseudo_inertias)
    return bool(np.all(sizes[:, 0] > np.finfo(np.float64).eps * sizes[:, -1]))


def inflation_of(rows: FloatArray, manifold: ParameterManifold, point: Point, prior: Point, root: FloatArray) -> float:
    """Return the factor, at least 1, by which the variances of the links' ``rows (r, D + 1)`` must grow to agree with a
    fit whose covariance of the links has the ``root (10 links, D)``: the model of these rows had errors, too.

    MacKay's re-estimate, as for the prior std: mean square of the residuals, including the fit's uncertainty. It is 1
    without rows.
    """
    off = rows @ np.append(point.parameters - prior.parameters, 1.0)
    normals = manifold.whiten(point, rows[:, :-1])
    uncertainty = float(np.sum((normals[:, : len(root)] @ root) ** 2))
    return max(1.0, (float(off @ off) + uncertainty + _CERTAINTY) / (_count_informative(rows) + _CERTAINTY))


def cost_of_inflation(rows: FloatArray, inflation: float) -> float:
    """Minus twice the log prior of the inflation, plus the normalisation of residuals in enlarged stds."""
    return (_count_informative(rows) + _CERTAINTY) * float(np.log(inflation)) + _CERTAINTY * (1.0 / inflation - 1.0)


def _count_informative(rows: FloatArray) -> int:
    """Number of rows that constrain any parameter."""
    sizes = np.linalg.norm(rows[:, :-1], axis=1)
    return int(np.count_nonzero(sizes > 1e-6 * np.max(sizes, initial=0.0)))
