"""Search for an exciting motion: gradient descent from the best of random motions.

The criterion and the penalties near limits are differentiated by positions, speeds and accelerations of samples. These
are linear in the coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.excitation.belief import ROWS_PER_SECOND, covariance_of
from geomid_ros.excitation.feasibility import HALVINGS, Feasibility
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.model.dynamics import STEP
from geomid_ros.types import FloatArray

_RATE = 6.0  # [Hz] of samples
_RANDOM = 12  # initial motions
_STEPS = 70  # maximum number of evaluations
FEASIBILITY_EVALUATIONS = 50
"""Maximum number of evaluations in the search for a feasible motion."""
_FEW = 5  # evaluations, and halvings, where a typical motion suffices
_USED = 0.97  # fraction of a limit above which a penalty begins
_COST = 300.0  # penalty of exceeding a limit by 100 % at every sample; it grows with the square
_NEAR = 2.0  # distances below so many clearances are penalised

Criterion = Callable[[FloatArray], tuple[float, FloatArray]]
"""From rows ``(N, C, D)`` in units of the noise to the logarithm of the squared error to minimise, and its gradient."""


def random_motion(feasibility: Feasibility, form: MotionForm, random: np.random.Generator) -> ExcitingMotion:
    """Draw a random motion, each joint as large as its limits allow."""
    motion = ExcitingMotion(form, feasibility.start, random.standard_normal((form.size, len(feasibility.start))))
    return motion.scaled(feasibility.largest_scale(motion))


def expected_error(feasibility: Feasibility, weight: FloatArray, form: MotionForm) -> Criterion:
    """Criterion: log of the trace of a ``weight (D, D)`` times the covariance after a motion of that form."""
    knowledge = feasibility.belief
    precision = knowledge.precision

    def criterion(rows: FloatArray) -> tuple[float, FloatArray]:
        information = knowledge.information_of(rows, form.duration)
        covariance = covariance_of(precision + information)
        slope = covariance @ weight @ covariance
        value = float(np.sum(weight * covariance))
        per_row = ROWS_PER_SECOND * form.duration / len(rows)
        return np.log(value), -2.0 * per_row / value * (rows @ slope)

    return criterion


def typical_motions(
    feasibility: Feasibility, form: MotionForm, random: np.random.Generator, count: int
) -> list[ExcitingMotion]:
    """Draw ``count`` random motions that the robot can make. In a tight place, motions within joint limits alone are
    far larger, and an error on them means nothing. The motions are bent a little before they are shrunk: motions only
    shrunk are far smaller than the robot can make, and a design for them says little about others."""
    search = Search(feasibility, form, evaluations=_FEW, halvings=_FEW)
    return [search.improved(random_motion(feasibility, form, random)) for _ in range(count)]


def random_feasible(feasibility: Feasibility, form: MotionForm, random: np.random.Generator) -> ExcitingMotion:
    """Draw a random motion, bend it where it comes too close to a limit or a body, and make it feasible."""
    return Search(feasibility, form, evaluations=FEASIBILITY_EVALUATIONS).improved(
        random_motion(feasibility, form, random)
    )


@dataclass(frozen=True, eq=False)
class Search:
    """Search for motions of a form; without a criterion, for feasible ones.

    Attributes:
        feasibility: the limits that they must keep.
        form: of the motions.
        criterion: to minimise.
        evaluations: maximum number.
        halvings: of the interval that contains the largest feasible size of a motion.
    """

    feasibility: Feasibility
    form: MotionForm
    criterion: Criterion | None = None
    evaluations: int = _STEPS
    halvings: int = HALVINGS

    def run(self, random: np.random.Generator, progress: Callable[[float], None] = lambda _: None) -> ExcitingMotion:
        """Find a feasible motion with a small criterion."""
        initial = [random_motion(self.feasibility, self.form, random) for _ in range(_RANDOM)]
        costs = [self.cost(motion) for motion in initial]
        return self.improved(initial[int(np.argmin(costs))], progress)

    def improved(self, motion: ExcitingMotion, progress: Callable[[float], None] = lambda _: None) -> ExcitingMotion:
        """Descend from a motion, and make the result feasible."""
        units, done = self._units, 0

        def objective(vector: FloatArray) -> tuple[float, FloatArray]:
            nonlocal done
            done += 1
            progress(min(done / self.evaluations, 1.0))
            value, slope = self._value_and_slope(
                ExcitingMotion(self.form, motion.start, units * vector.reshape(units.shape))
            )
            return value, (units * slope).ravel()

        initial = (motion.coefficients / np.where(units > 0.0, units, 1.0)).ravel()
        options = {"maxfun": self.evaluations, "maxcor": 20}
        optimum = minimize(objective, initial, jac=True, method="L-BFGS-B", options=options)
        bent = ExcitingMotion(self.form, motion.start, units * optimum.x.reshape(units.shape))
        return self.feasibility.shrunk_to_feasible(bent, self.halvings)

    @cached_property
    def _units(self) -> FloatArray:
        """Scales of the coefficients ``(size, J)``: each alone moves a joint as far as its limits allow."""
        start = self.feasibility.start
        units = np.eye(self.form.size)[:, :, None] * np.ones(len(start))
        return np.array([self.feasibility.largest_scale(ExcitingMotion(self.form, start, unit)) for unit in units])

    @cached_property
    def _basis(self) -> FloatArray:
        count = int(np.ceil(_RATE * self.form.period))
        return self.form.basis((np.arange(count) + 0.5) * self.form.period / count)

    def _states(self, motion: ExcitingMotion) -> FloatArray:
        states = np.array(self._basis @ motion.coefficients)
        states[0] += motion.start
        return states

    def cost(self, motion: ExcitingMotion) -> float:
        """Criterion of a motion, plus its penalties near limits and bodies."""
        states = self._states(motion)
        value = self._of_limits(states)[0] + self._of_distances(states)[0]
        if self.criterion is not None:
            rows = self.feasibility.belief.rows(states[:3])
            value += self.criterion(rows / self.feasibility.belief.sigmas[:, None])[0] + self._of_efforts(rows)[0]
        return value

    def _value_and_slope(self, motion: ExcitingMotion) -> tuple[float, FloatArray]:
        """Cost of a motion, and its gradient ``(size, J)`` by the coefficients."""
        states = self._states(motion)
        value, slopes = 0.0, np.zeros_like(states)
        for term, by_states in (self._of_limits(states), self._of_distances(states), self._of_rows(states)):
            value += term
            slopes[: len(by_states)] += by_states
        return value, np.einsum("onm,onj->mj", self._basis, slopes)

    def _of_rows(self, states: FloatArray) -> tuple[float, FloatArray]:
        """Criterion plus the penalty of efforts, and the gradient ``(3, N, J)`` by the states."""
        if self.criterion is None:
            return 0.0, np.zeros_like(states[:3])
        knowledge, (count, joints) = self.feasibility.belief, states.shape[1:]
        nearby = self._rows_nearby(states)
        rows = nearby[0] @ knowledge.posterior.jacobian
        value, by_rows = self.criterion(rows / knowledge.sigmas[:, None])
        cost, by_efforts = self._of_efforts(rows)
        row_gradient = by_rows / knowledge.sigmas[:, None]
        row_gradient[:, :joints] += by_efforts[..., None] * self._whitened_parameters
        directional = np.einsum("ancd,ncd->an", nearby, row_gradient @ knowledge.posterior.jacobian.T)
        slopes = (directional[1:] - directional[0]) / STEP
        return value + cost, slopes.reshape(3, joints, count).swapaxes(1, 2)

    @cached_property
    def _whitened_parameters(self) -> FloatArray:
        """Parameters in tangent coordinates ``(D,)``: tangent rows times these are efforts."""
        posterior = self.feasibility.belief.posterior
        return np.asarray(np.linalg.solve(posterior.jacobian, posterior.parameters))

    def _rows_nearby(self, states: FloatArray) -> FloatArray:
        """Regressors ``(1 + 3 J, N, C, D)`` of the parameters at ``states``, and one step of each joint's position,
        speed and acceleration away."""
        count, joints = states.shape[1:]
        steps = STEP * np.eye(3 * joints).reshape(3 * joints, 3, 1, joints)
        near = np.concatenate([states[None, :3], states[None, :3] + steps]).swapaxes(0, 1).reshape(3, -1, joints)
        rows = self.feasibility.belief.rows_of_parameters(near)
        return rows.reshape(3 * joints + 1, count, *rows.shape[1:])

    def _of_limits(self, states: FloatArray) -> tuple[float, FloatArray]:
        """Penalty of positions, speeds, accelerations and jerks near limits, and its gradient ``(4, N, J)``."""
        limits, feasibility = self.feasibility.limits, self.feasibility
        low, high = limits.position.T
        half = np.where(np.isfinite(high - low), 0.5 * (high - low), np.pi)
        centre = np.where(np.isfinite(high - low), 0.5 * (high + low), feasibility.start)
        scales = np.concatenate([half[None] - feasibility.edge, limits.derivatives])
        away = states.copy()
        away[0] -= centre
        return _hinge(away / scales[:, None], 1.0 / scales[:, None])

    def _of_efforts(self, rows: FloatArray) -> tuple[float, FloatArray]:
        """Penalty of efforts near limits, and its gradient ``(N, J)``; their uncertainty is taken as constant."""
        knowledge, limit = self.feasibility.belief, self.feasibility.limits.effort
        rows = rows[:, : len(limit)]
        available = np.maximum(limit - STDS_OF_95 * knowledge.prediction_stds(rows), 0.05 * limit)
        return _hinge(rows @ self._whitened_parameters / available, 1.0 / available)

    def _of_distances(self, states: FloatArray) -> tuple[float, FloatArray]:
        """Penalty of pairs of bodies that come close, and its gradient ``(4, N, J)``."""
        slopes, cost, collision = np.zeros_like(states), 0.0, self.feasibility.collision
        if collision is None:
            return cost, slopes
        threshold = _NEAR * self.feasibility.clearances
        close = collision.distances(states[0]) < threshold
        for sample in np.flatnonzero(np.any(close, axis=1)):
            pairs = np.flatnonzero(close[sample])
            values, by_position = collision.gradients(states[0, sample], pairs)
            shortfall = np.maximum(1.0 - values / threshold[pairs], 0.0)
            cost += _COST / states.shape[1] * float(np.sum(shortfall**2))
            slopes[0, sample] -= 2.0 * _COST / states.shape[1] * ((shortfall / threshold[pairs]) @ by_position)
        return cost, slopes


def _hinge(fractions: FloatArray, per_unit: FloatArray) -> tuple[float, FloatArray]:
    """Penalty of used fractions of limits ``(..., N, J)``, and its gradient by the quantity of which a unit uses the
    fraction ``per_unit``."""
    over = np.maximum(np.abs(fractions) - _USED, 0.0)
    cost = _COST / fractions.shape[-2]
    return cost * float(np.sum(over**2)), 2.0 * cost * over * np.sign(fractions) * per_unit
