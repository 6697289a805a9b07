"""The search for a motion: random ones, the best of them, and from there downhill.

The criterion and what it costs to come close to a limit are differentiated by positions, speeds and accelerations at
some instants, and these by the coefficients, in which they are linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from geomid_ros.estimation.uncertain_inertia import STDS_OF_95
from geomid_ros.excitation.feasibility import HALVINGS, Feasibility
from geomid_ros.excitation.knowledge import covariance_of
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.model.dynamics import STEP
from geomid_ros.types import FloatArray

_RATE = 6.0  # [Hz] of instants
_RANDOM = 12  # motions to begin with
_STEPS = 70  # evaluations at most
BENDS = 50
"""Evaluations at most of the search for a feasible motion."""
_FEW = 5  # evaluations, and halvings, where a motion need not be more than typical
_USED = 0.97  # of a limit, before it costs anything
_COST = 300.0  # of exceeding a limit by all of it, squared, at every instant
_NEAR = 2.0  # clearances within which distances cost something

Criterion = Callable[[FloatArray], tuple[float, FloatArray]]
"""Of rows ``(N, C, D)`` in units of the noise: the logarithm of what is to be small, and its derivatives by them."""


def random_motion(feasibility: Feasibility, form: MotionForm, random: np.random.Generator) -> ExcitingMotion:
    """A random motion, each joint's as large as its own limits allow."""
    motion = ExcitingMotion(form, feasibility.start, random.standard_normal((form.size, len(feasibility.start))))
    return motion.scaled(feasibility.largest_scale(motion))


def expected_error(feasibility: Feasibility, weight: FloatArray, form: MotionForm) -> Criterion:
    """The trace of a ``weight (D, D)`` times the covariance after a motion of that form."""
    knowledge = feasibility.knowledge
    precision = knowledge.precision

    def criterion(rows: FloatArray) -> tuple[float, FloatArray]:
        information = knowledge.information_of(rows, form.duration)
        covariance = covariance_of(precision + information)
        spread = covariance @ weight @ covariance
        value = float(np.sum(weight * covariance))
        share = knowledge.information_of(np.eye(rows.shape[-1])[None], form.duration)[0, 0] / len(rows)
        return np.log(value), -2.0 * share / value * (rows @ spread)

    return criterion


def other_motions(
    feasibility: Feasibility, form: MotionForm, random: np.random.Generator, count: int
) -> list[ExcitingMotion]:
    """So many random motions that the robot can make: in a tight place those within its limits are far larger, and an
    error on them means nothing. They are bent a little before they are shrunk: those that are shrunk alone are far
    smaller than what the robot can make, and a design for them tells little of others."""
    search = Search(feasibility, form, evaluations=_FEW, halvings=_FEW)
    return [search.improved(random_motion(feasibility, form, random)) for _ in range(count)]


def random_feasible(feasibility: Feasibility, form: MotionForm, random: np.random.Generator) -> ExcitingMotion:
    """A random motion, bent where it comes too close to something, and then made feasible."""
    return Search(feasibility, form, evaluations=BENDS).improved(random_motion(feasibility, form, random))


@dataclass(frozen=True, eq=False)
class Search:
    """The search for motions of a form; without a criterion, for feasible ones.

    Attributes:
        feasibility: what they must hold.
        form: theirs.
        criterion: what they make small.
        evaluations: at most.
        halvings: of the interval in which the largest feasible size of a motion lies.
    """

    feasibility: Feasibility
    form: MotionForm
    criterion: Criterion | None = None
    evaluations: int = _STEPS
    halvings: int = HALVINGS

    def run(self, random: np.random.Generator, progress: Callable[[float], None] = lambda _: None) -> ExcitingMotion:
        """A feasible motion that makes the criterion small."""
        begun = [random_motion(self.feasibility, self.form, random) for _ in range(_RANDOM)]
        costs = [self.cost(motion) for motion in begun]
        return self.improved(begun[int(np.argmin(costs))], progress)

    def improved(self, motion: ExcitingMotion, progress: Callable[[float], None] = lambda _: None) -> ExcitingMotion:
        """A feasible motion, downhill from another."""
        units, done = self._units, 0

        def at(vector: FloatArray) -> tuple[float, FloatArray]:
            nonlocal done
            done += 1
            progress(min(done / self.evaluations, 1.0))
            value, slope = self._value_and_slope(
                ExcitingMotion(self.form, motion.start, units * vector.reshape(units.shape))
            )
            return value, (units * slope).ravel()

        begin = (motion.coefficients / np.where(units > 0.0, units, 1.0)).ravel()
        options = {"maxfun": self.evaluations, "maxcor": 20}
        found = minimize(at, begin, jac=True, method="L-BFGS-B", options=options)
        bent = ExcitingMotion(self.form, motion.start, units * found.x.reshape(units.shape))
        return self.feasibility.made_feasible(bent, self.halvings)

    @cached_property
    def _units(self) -> FloatArray:
        """Of the coefficients ``(size, J)``: each by itself goes as far as the joint's limits allow."""
        return np.array([self.feasibility.largest_scale(self._unit_motion(place)) for place in range(self.form.size)])

    def _unit_motion(self, place: int) -> ExcitingMotion:
        coefficients = np.zeros((self.form.size, len(self.feasibility.start)))
        coefficients[place] = 1.0
        return ExcitingMotion(self.form, self.feasibility.start, coefficients)

    @cached_property
    def _basis(self) -> FloatArray:
        count = int(np.ceil(_RATE * self.form.period))
        return self.form.basis((np.arange(count) + 0.5) * self.form.period / count)

    def _states(self, motion: ExcitingMotion) -> FloatArray:
        states = np.array(self._basis @ motion.coefficients)
        states[0] += motion.start
        return states

    def cost(self, motion: ExcitingMotion) -> float:
        """What a motion costs: the criterion, and what it comes too close to."""
        states = self._states(motion)
        value = self._of_limits(states)[0] + self._of_distances(states)[0]
        if self.criterion is not None:
            rows = self.feasibility.knowledge.rows(states[:3])
            value += self.criterion(rows / self.feasibility.knowledge.sigmas[:, None])[0] + self._of_efforts(rows)[0]
        return value

    def _value_and_slope(self, motion: ExcitingMotion) -> tuple[float, FloatArray]:
        """The same, and its derivatives ``(size, J)`` by the coefficients."""
        states = self._states(motion)
        value, slopes = 0.0, np.zeros_like(states)
        for more, by_states in (self._of_limits(states), self._of_distances(states), self._of_rows(states)):
            value += more
            slopes[: len(by_states)] += by_states
        return value, np.einsum("onm,onj->mj", self._basis, slopes)

    def _of_rows(self, states: FloatArray) -> tuple[float, FloatArray]:
        """The criterion and what efforts cost, and the derivatives ``(3, N, J)``."""
        if self.criterion is None:
            return 0.0, np.zeros_like(states[:3])
        knowledge, (count, joints) = self.feasibility.knowledge, states.shape[1:]
        nearby = self._rows_nearby(states)
        rows = nearby[0] @ knowledge.posterior.jacobian
        value, by_rows = self.criterion(rows / knowledge.sigmas[:, None])
        cost, by_efforts = self._of_efforts(rows)
        pull = by_rows / knowledge.sigmas[:, None]
        pull[:, :joints] += by_efforts[..., None] * self._whitened_parameters
        along = np.einsum("ancd,ncd->an", nearby, pull @ knowledge.posterior.jacobian.T)
        slopes = (along[1:] - along[0]) / STEP
        return value + cost, slopes.reshape(3, joints, count).swapaxes(1, 2)

    @cached_property
    def _whitened_parameters(self) -> FloatArray:
        """Tangent coordinates ``(D,)`` by which rows make efforts."""
        posterior = self.feasibility.knowledge.posterior
        return np.asarray(np.linalg.solve(posterior.jacobian, posterior.parameters))

    def _rows_nearby(self, states: FloatArray) -> FloatArray:
        """Rows ``(1 + 3 J, N, C, D)`` by the parameters: there, and a step of each joint's position, speed and
        acceleration away."""
        count, joints = states.shape[1:]
        steps = STEP * np.eye(3 * joints).reshape(3 * joints, 3, 1, joints)
        near = np.concatenate([states[None, :3], states[None, :3] + steps]).swapaxes(0, 1).reshape(3, -1, joints)
        rows = self.feasibility.knowledge.rows_of_parameters(near)
        return rows.reshape(3 * joints + 1, count, *rows.shape[1:])

    def _of_limits(self, states: FloatArray) -> tuple[float, FloatArray]:
        """What positions, speeds, accelerations and jerks cost, and the derivatives ``(4, N, J)``."""
        limits, feasibility = self.feasibility.limits, self.feasibility
        low, high = limits.position.T
        half = np.where(np.isfinite(high - low), 0.5 * (high - low), np.pi)
        centre = np.where(np.isfinite(high - low), 0.5 * (high + low), feasibility.start)
        scales = np.concatenate([half[None] - feasibility.edge, limits.derivatives])
        away = states.copy()
        away[0] -= centre
        return _hinge(away / scales[:, None], 1.0 / scales[:, None])

    def _of_efforts(self, rows: FloatArray) -> tuple[float, FloatArray]:
        """What efforts cost, and the derivatives ``(N, J)`` by them; their uncertainty counts as it is."""
        knowledge, limit = self.feasibility.knowledge, self.feasibility.limits.effort
        rows = rows[:, : len(limit)]
        left = np.maximum(limit - STDS_OF_95 * knowledge.deviations_of(rows), 0.05 * limit)
        return _hinge(rows @ self._whitened_parameters / left, 1.0 / left)

    def _of_distances(self, states: FloatArray) -> tuple[float, FloatArray]:
        """What pairs cost that come close, and the derivatives ``(4, N, J)``."""
        slopes, cost, collision = np.zeros_like(states), 0.0, self.feasibility.collision
        if collision is None:
            return cost, slopes
        wanted = _NEAR * self.feasibility.clearances
        close = collision.distances(states[0]) < wanted
        for instant in np.flatnonzero(np.any(close, axis=1)):
            pairs = np.flatnonzero(close[instant])
            values, by_position = collision.gradients(states[0, instant], pairs)
            lack = np.maximum(1.0 - values / wanted[pairs], 0.0)
            cost += _COST / states.shape[1] * float(np.sum(lack**2))
            slopes[0, instant] -= 2.0 * _COST / states.shape[1] * ((lack / wanted[pairs]) @ by_position)
        return cost, slopes


def _hinge(shares: FloatArray, per_unit: FloatArray) -> tuple[float, FloatArray]:
    """The cost of shares of limits ``(..., N, J)`` that are used, and its derivatives by what is ``per_unit`` of a
    share."""
    over = np.maximum(np.abs(shares) - _USED, 0.0)
    cost = _COST / shares.shape[-2]
    return cost * float(np.sum(over**2)), 2.0 * cost * over * np.sign(shares) * per_unit
