"""Motions that decide between rival named effects of the same finding: each effect predicts different efforts, even
after all other parameters are refitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import block_diag

from geomid_ros.estimation.tolerances import ROUNDING_OF_PRODUCTS
from geomid_ros.excitation.belief import ROWS_PER_SECOND, Belief
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.excitation.search import FEASIBILITY_EVALUATIONS, Search, random_motion
from geomid_ros.model.dynamics import Dynamics
from geomid_ros.model.effects import Effect, MotionEffect, OnLink, Place, Situation, SituationEffect, Values
from geomid_ros.model.effects.situation import Derivatives, OfLoad
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import SIGN, Samples, samples_of
from geomid_ros.types import FloatArray

DECIDED = 20.0
"""Difference of -2 log p that decides between two named effects."""
_RATE = 20.0  # [Hz] of the samples
_RANDOM = 24
_STEPS = 150
_FIRST, _GROWTH = 0.3, 1.5  # size of the first random step, and its growth after a success
_REFERENCE = 0.5  # size of the motion on which rivals are fitted first, as a fraction of the largest within limits


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """A named effect that may explain a finding: any of its ``variants`` at a ``place``. It counts as so many
    ``parameters`` (BIC)."""

    variants: tuple[Effect, ...]
    place: Place
    label: str
    parameters: float = 1.0

    def is_case_of(self, other: NamedEffect) -> bool:
        """True if it is a special case of the ``other``, which then explains it too and is only less simple."""
        case, richer = self.variants[0], other.variants[0]
        return self.place == other.place and case != richer and (richer.contains == case.name or case in richer.parts)


@dataclass(frozen=True, eq=False)
class Ambiguity:
    """A ``found`` effect with its ``coefficients (k,)`` for ``variants[0]``, and its ``rivals``."""

    found: NamedEffect
    coefficients: FloatArray
    rivals: tuple[NamedEffect, ...]


def responses(
    model: MeasurementModel, states: FloatArray, period: float, effects: Sequence[tuple[Effect, Place]]
) -> list[FloatArray]:
    """Efforts ``(N, J, k)`` per unit of each coefficient, for each effect. The robot is as its URDF describes it, at
    ``states (3, N, J)`` sampled every ``period`` [s]."""
    samples = samples_of(states, len(model.sensors))
    situation = cache(lambda: _situation(model, samples, period))  # slow, and not always needed

    def part_columns(part: Effect, place: Place) -> FloatArray:
        if isinstance(part, SituationEffect):
            return part.columns(situation(), place)[:, : states.shape[2]]
        if isinstance(part, MotionEffect):
            return part.efforts(samples.motion, place)[:, :, None]
        return np.zeros((*states.shape[1:], 0))

    def columns(effect: Effect, place: Place) -> FloatArray:
        if isinstance(place, OnLink):
            first = 10 * place.link
            return model.rows(samples).coefficients[:, : states.shape[2], first : first + 10]
        return np.concatenate([part_columns(part, place) for part in effect.parts], axis=2)

    return [columns(effect, place) for effect, place in effects]


def _situation(model: MeasurementModel, samples: Samples, period: float) -> Situation:
    dynamics = Dynamics(model, np.array([body.parameters for body in model.robot.bodies]))
    load = dynamics.efforts(samples)
    value, rate, acceleration = _derivatives(load[..., None], period)

    def of_load(function: OfLoad) -> Derivatives:
        return _derivatives(function(load, period), period)

    return Situation(
        sign=samples.column(SIGN),
        predicted=load,
        load=value[..., 0],
        load_rate=rate[..., 0],
        load_acceleration=acceleration[..., 0],
        transmitted=load,
        gravity=model.robot.gravity,
        coefficients={},
        from_load_history=of_load,
        **vars(dynamics.sensitivity(samples)),
    )


def _derivatives(values: FloatArray, period: float) -> Derivatives:
    """Values and their first two derivatives by time, by central differences."""
    rate = np.gradient(values, period, axis=0)
    return values, rate, np.gradient(rate, period, axis=0)


def coefficients_of(effect: type[Effect], values: Values, parts: Sequence[Effect]) -> FloatArray:
    """Coefficients ``(k,)`` of an effect with these parameters, in the order of its ``parts``."""
    by_part = effect.coefficients(values)
    return np.concatenate([np.array(by_part.get(part, (0.0,) * part.count)) for part in parts])


class DiscriminationCriterion:
    """Criterion of how well a motion discriminates between the rivals of each ambiguity."""

    def __init__(self, belief: Belief, ambiguities: Sequence[Ambiguity]) -> None:
        self._knowledge, self.ambiguities = belief, ambiguities
        self.imitations: dict[tuple[int, int], tuple[int, FloatArray]] = {}
        """Index of the variant and coefficients with which a rival imitates the finding, by ambiguity and rival."""

    def prepare(self, reference: ExcitingMotion) -> None:
        """Fit each rival to its finding on a ``reference`` motion, and scale it to leave as much effort unexplained."""
        rows, columns = self._at(reference)
        for i, dispute in enumerate(self.ambiguities):
            target, nuisance = columns(dispute.found)[0] @ dispute.coefficients, self._nuisance(rows, columns, dispute)
            for j, rival in enumerate(dispute.rivals):
                fits = [nuisance.fit(variant, target) for variant in columns(rival)]
                best = int(np.argmin([residual for residual, _ in fits]))
                imitated = nuisance.unexplained(columns(rival)[best] @ fits[best][1])
                size = np.sqrt(nuisance.unexplained(target) / max(imitated, np.finfo(float).tiny))
                self.imitations[i, j] = best, size * fits[best][1]

    def differences(self, motion: ExcitingMotion) -> list[list[float]]:
        """Smallest expected difference of -2 log p, for each ambiguity and rival, whichever of the two is true.
        An effect with more parameters has to make up for them (BIC)."""
        rows, columns = self._at(motion)
        penalty = float(np.log(ROWS_PER_SECOND * motion.form.duration * len(motion.start)))
        by_dispute = []
        for i, dispute in enumerate(self.ambiguities):
            found_columns, nuisance = columns(dispute.found), self._nuisance(rows, columns, dispute)
            by_rival = []
            for j, rival in enumerate(dispute.rivals):
                variant, coefficients = self.imitations[i, j]
                rival_columns = columns(rival)
                bic = penalty * (dispute.found.parameters - rival.parameters)
                differences = []
                if not dispute.found.is_case_of(rival):
                    differences.append(nuisance.least(rival_columns, found_columns[0] @ dispute.coefficients) - bic)
                if not rival.is_case_of(dispute.found):
                    differences.append(nuisance.least(found_columns, rival_columns[variant] @ coefficients) + bic)
                by_rival.append(min(differences))
            by_dispute.append(by_rival)
        return by_dispute

    def smallest_difference(self, motion: ExcitingMotion) -> float:
        """Smallest difference of all ambiguities and rivals."""
        return min(difference for differences in self.differences(motion) for difference in differences)

    def _nuisance(
        self, rows: FloatArray, columns: Callable[[NamedEffect], list[FloatArray]], dispute: Ambiguity
    ) -> _Nuisance:
        """Nuisance parameters, refitted with either effect: inertias, and the other findings near their sizes."""
        findings = [finding for finding in self.ambiguities if finding is not dispute]
        finding_columns = [columns(finding.found)[0] for finding in findings]
        sizes = np.concatenate([np.zeros(0), *(finding.coefficients for finding in findings)])
        precision = np.diag(1.0 / np.maximum(sizes**2, np.finfo(float).tiny))
        return _Nuisance(np.column_stack([rows, *finding_columns]), block_diag(self._knowledge.precision, precision))

    def _at(self, motion: ExcitingMotion) -> tuple[FloatArray, Callable[[NamedEffect], list[FloatArray]]]:
        """Weighted regressor ``(n, D)`` of a motion; a function for the weighted columns ``(n, k)`` of variants."""
        count = int(np.ceil(_RATE * motion.form.period))
        step = motion.form.period / count
        states = motion.at(np.asarray((np.arange(count) + 0.5) * step))[:3]
        weights = np.sqrt(ROWS_PER_SECOND * motion.form.duration / count) / self._knowledge.sigmas[: states.shape[2]]
        rows = self._knowledge.rows(states)[:, : states.shape[2]] * weights[:, None]
        effects = [name for dispute in self.ambiguities for name in (dispute.found, *dispute.rivals)]
        pairs = dict.fromkeys((variant, name.place) for name in effects for variant in name.variants)
        by_pair = dict(zip(pairs, responses(self._knowledge.model, states, step, [*pairs]), strict=True))

        def columns(name: NamedEffect) -> list[FloatArray]:
            weighted = (by_pair[variant, name.place] * weights[:, None] for variant in name.variants)
            return [column.reshape(-1, column.shape[2]) for column in weighted]

        return rows.reshape(-1, rows.shape[2]), columns


@dataclass(frozen=True, eq=False)
class _Nuisance:
    """Weighted rows ``(n, D)`` of nuisance parameters, whose prior has that ``precision (D, D)``."""

    rows: FloatArray
    precision: FloatArray

    def least(self, variants: Sequence[FloatArray], target: FloatArray) -> float:
        """Smallest squared residual of a target ``(n,)`` over the variants of columns."""
        return min(self.fit(columns, target)[0] for columns in variants)

    def unexplained(self, target: FloatArray) -> float:
        """Squared residual of a target after fitting these parameters alone."""
        return self.fit(np.zeros((len(target), 0)), target)[0]

    def fit(self, columns: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
        """Squared residual (with prior) of fitting ``columns (n, k)`` and these parameters, and the coefficients."""
        size = self.rows.shape[1]
        design = np.column_stack([self.rows, columns])
        normal, moments = design.T @ design, design.T @ target
        normal[:size, :size] += self.precision
        units = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
        scaled = normal * np.outer(units, units) + ROUNDING_OF_PRODUCTS * np.eye(len(units))
        solution = units * np.linalg.solve(scaled, units * moments)
        return max(float(target @ target - moments @ solution), 0.0), solution[size:]


def discriminating_motion(
    feasibility: Feasibility,
    form: MotionForm,
    criterion: DiscriminationCriterion,
    random: np.random.Generator,
    progress: Callable[[float], None] = lambda _: None,
) -> ExcitingMotion:
    """Find a feasible motion whose smallest difference, by the ``criterion``, is large: take the best of random
    motions, and climb from there by random steps."""
    criterion.prepare(random_motion(feasibility, form, random).scaled(_REFERENCE))
    costs = Search(feasibility, form, evaluations=FEASIBILITY_EVALUATIONS)

    def value(motion: ExcitingMotion) -> float:
        difference = criterion.smallest_difference(motion)
        # The logarithm above 1, continued linearly below.
        gain = np.log(difference) if difference > 1.0 else difference - 1.0
        return costs.cost(motion) - float(gain)

    best = min((random_motion(feasibility, form, random) for _ in range(_RANDOM)), key=value)
    lowest, step = value(best), _FIRST
    for index in range(_STEPS):
        progress(index / _STEPS)
        direction = random_motion(feasibility, form, random)
        candidate = feasibility.within_limits(
            ExcitingMotion(form, best.start, best.coefficients + step * direction.coefficients)
        )
        cost = value(candidate)
        better = cost < lowest
        if better:
            best, lowest = candidate, cost
        # One success in five keeps the size of the step (Rechenberg 1973).
        step *= _GROWTH if better else _GROWTH**-0.25
    # Bending a motion into the limits may lose the discrimination. Shrinking keeps its shape.
    return max((feasibility.shrunk_to_feasible(best), costs.improved(best)), key=criterion.smallest_difference)
