"""Which motion decides between names for the same thing: the one whose efforts each name predicts differently, however
well the others are fitted to it anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from geomid_ros.estimation.tolerances import ROUNDING_OF_PRODUCTS
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.knowledge import ROWS_PER_SECOND, Belief
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.excitation.search import BENDS, Search, random_motion
from geomid_ros.model.dynamics import Dynamics
from geomid_ros.model.effects import Effect, MotionEffect, OnLink, Place, Situation, SituationEffect, Values
from geomid_ros.model.effects.situation import Derivatives, OfLoad
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import SIGN, Samples, samples_of
from geomid_ros.types import FloatArray

DECIDED = 20.0
"""Difference of -2 log p by which two names are told apart."""
_RATE = 20.0  # [Hz] of the instants
_RANDOM = 24
_STEPS = 150
_FIRST, _GROWTH = 0.3, 1.5  # size of the first random step, and by how much it grows with success
_REFERENCE = 0.5  # share of the limits' reach of the motion on which a rival is fitted for the first time


@dataclass(frozen=True, eq=False)
class Name:
    """One name for what was found: an effect, of any of its ``variants``, at a place, which counts for so many
    ``parameters``."""

    variants: tuple[Effect, ...]
    place: Place
    label: str
    parameters: float = 1.0

    def is_case_of(self, other: Name) -> bool:
        """Whether it is a special case of the ``other``, which then explains it, too, and is only less simple."""
        own, richer = self.variants[0], other.variants[0]
        return self.place == other.place and own != richer and (richer.contains == own.name or own in richer.parts)


@dataclass(frozen=True, eq=False)
class Ambiguity:
    """A ``found`` name with its ``coefficients (k,)`` at the effect ``variants[0]``, and its ``rivals``."""

    found: Name
    coefficients: FloatArray
    rivals: tuple[Name, ...]


def responses(
    model: MeasurementModel, states: FloatArray, period: float, effects: Sequence[tuple[Effect, Place]]
) -> list[FloatArray]:
    """Efforts ``(N, J, k)`` per unit of each coefficient of each effect, of a robot as its URDF says, at ``states (3,
    N, J)`` at instants that are one ``period`` apart."""
    samples = samples_of(states, len(model.sensors))
    needed = any(isinstance(part, SituationEffect) for effect, _ in effects for part in effect.parts)
    situation = _situation(model, samples, period) if needed else None

    def of_part(part: Effect, place: Place) -> FloatArray:
        if isinstance(part, SituationEffect) and situation is not None:
            return part.columns(situation, place)[:, : states.shape[2]]
        if isinstance(part, MotionEffect):
            return part.efforts(samples.motion, place)[:, :, None]
        return np.zeros((*states.shape[1:], 0))

    def of(effect: Effect, place: Place) -> FloatArray:
        if isinstance(place, OnLink):
            first = 10 * place.link
            return model.rows(samples).coefficients[:, : states.shape[2], first : first + 10]
        return np.concatenate([of_part(part, place) for part in effect.parts], axis=2)

    return [of(effect, place) for effect, place in effects]


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
        of_load=of_load,
        **vars(dynamics.sensitivity(samples)),
    )


def _derivatives(values: FloatArray, period: float) -> Derivatives:
    """Values and their first two derivatives by time, by central differences."""
    rate = np.gradient(values, period, axis=0)
    return values, rate, np.gradient(rate, period, axis=0)


def coefficients_of(effect: type[Effect], values: Values, parts: Sequence[Effect]) -> FloatArray:
    """The coefficients ``(k,)`` of an effect with these parameters, in the order of its ``parts``."""
    known = effect.coefficients(values)
    return np.concatenate([np.array(known.get(part, (0.0,) * part.count)) for part in parts])


class DiscriminationCriterion:
    """What a motion would say of disputes."""

    def __init__(self, knowledge: Belief, disputes: Sequence[Ambiguity]) -> None:
        self._knowledge, self.disputes = knowledge, disputes
        self.imitations: dict[tuple[int, int], tuple[int, FloatArray]] = {}
        """The variant and the coefficients of each rival that look like what was found, by dispute and rival."""

    def prepare(self, reference: ExcitingMotion) -> None:
        """Find how large rivals are that look like what was found, in some motion: so that as much is unexplained."""
        rows, own = self._at(reference)
        for place, dispute in enumerate(self.disputes):
            target, known = own(dispute.found)[0] @ dispute.coefficients, self._beside(rows, own, dispute)
            for index, rival in enumerate(dispute.rivals):
                fits = [known.fit(columns, target) for columns in own(rival)]
                best = int(np.argmin([left for left, _ in fits]))
                looks = known.unexplained(own(rival)[best] @ fits[best][1])
                size = np.sqrt(known.unexplained(target) / max(looks, np.finfo(float).tiny))
                self.imitations[place, index] = best, size * fits[best][1]

    def differences(self, motion: ExcitingMotion) -> list[list[float]]:
        """Of each dispute and rival: the least expected difference of -2 log p, whichever of both is true; a name with
        more parameters has to make up for them (BIC)."""
        rows, own = self._at(motion)
        each = float(np.log(ROWS_PER_SECOND * motion.form.duration * len(motion.start)))
        found = []
        for place, dispute in enumerate(self.disputes):
            columns, known = own(dispute.found), self._beside(rows, own, dispute)
            least = []
            for index, rival in enumerate(dispute.rivals):
                variant, coefficients = self.imitations[place, index]
                others = own(rival)
                handicap = each * (dispute.found.parameters - rival.parameters)
                differences = []
                if not dispute.found.is_case_of(rival):
                    differences.append(known.least(others, columns[0] @ dispute.coefficients) - handicap)
                if not rival.is_case_of(dispute.found):
                    differences.append(known.least(columns, others[variant] @ coefficients) + handicap)
                least.append(min(differences))
            found.append(least)
        return found

    def least(self, motion: ExcitingMotion) -> float:
        """The least of all differences."""
        return min(difference for differences in self.differences(motion) for difference in differences)

    def _beside(self, rows: FloatArray, own: Callable[[Name], list[FloatArray]], dispute: Ambiguity) -> _Known:
        """What is fitted anew with either name: the inertias, and the other findings about as large as they are."""
        others = [other for other in self.disputes if other is not dispute]
        columns = [own(other.found)[0] for other in others]
        sizes = np.concatenate([np.zeros(0), *(other.coefficients for other in others)])
        precision = np.diag(1.0 / np.maximum(sizes**2, np.finfo(float).tiny))
        return _Known(np.column_stack([rows, *columns]), block_diag(self._knowledge.precision, precision))

    def _at(self, motion: ExcitingMotion) -> tuple[FloatArray, Callable[[Name], list[FloatArray]]]:
        """Weighted rows ``(n, D)`` of a motion, and the weighted columns ``(n, k)`` of each variant of a name."""
        duration = motion.form.period
        count = int(np.ceil(_RATE * duration))
        period = duration / count
        states = motion.at(np.asarray((np.arange(count) + 0.5) * period))[:3]
        weights = np.sqrt(ROWS_PER_SECOND * motion.form.duration / count) / self._knowledge.sigmas[: states.shape[2]]
        rows = self._knowledge.rows(states)[:, : states.shape[2]] * weights[:, None]
        asked = [name for dispute in self.disputes for name in (dispute.found, *dispute.rivals)]
        pairs = dict.fromkeys((variant, name.place) for name in asked for variant in name.variants)
        columns = dict(zip(pairs, responses(self._knowledge.model, states, period, [*pairs]), strict=True))

        def own(name: Name) -> list[FloatArray]:
            found = (columns[variant, name.place] * weights[:, None] for variant in name.variants)
            return [column.reshape(-1, column.shape[2]) for column in found]

        return rows.reshape(-1, rows.shape[2]), own


@dataclass(frozen=True, eq=False)
class _Known:
    """Weighted rows ``(n, D)`` of parameters with a prior of that ``precision (D, D)``."""

    rows: FloatArray
    precision: FloatArray

    def least(self, variants: Sequence[FloatArray], target: FloatArray) -> float:
        """What is left of a target ``(n,)``, squared, by the variant of columns that explains it best."""
        return min(self.fit(columns, target)[0] for columns in variants)

    def unexplained(self, target: FloatArray) -> float:
        """What these parameters leave of a target, squared."""
        return self.fit(np.zeros((len(target), 0)), target)[0]

    def fit(self, columns: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
        """What ``columns (n, k)`` and these parameters leave of a target, squared, and the columns' coefficients."""
        size = self.rows.shape[1]
        both = np.column_stack([self.rows, columns])
        normal, right = both.T @ both, both.T @ target
        normal[:size, :size] += self.precision
        units = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
        scaled = normal * np.outer(units, units) + ROUNDING_OF_PRODUCTS * np.eye(len(units))
        solution = units * np.linalg.solve(scaled, units * right)
        return max(float(target @ target - right @ solution), 0.0), solution[size:]


def deciding_motion(
    feasibility: Feasibility,
    form: MotionForm,
    judge: DiscriminationCriterion,
    random: np.random.Generator,
    progress: Callable[[float], None] = lambda _: None,
) -> ExcitingMotion:
    """A feasible motion after which the least of a judge's differences is large: the best of random ones, and from
    there uphill by random steps."""
    judge.prepare(random_motion(feasibility, form, random).scaled(_REFERENCE))
    costs = Search(feasibility, form, evaluations=BENDS)

    def value(motion: ExcitingMotion) -> float:
        difference = judge.least(motion)
        # As the logarithm, and on where there is none.
        gain = np.log(difference) if difference > 1.0 else difference - 1.0
        return costs.cost(motion) - float(gain)

    best = min((random_motion(feasibility, form, random) for _ in range(_RANDOM)), key=value)
    lowest, step = value(best), _FIRST
    for index in range(_STEPS):
        progress(index / _STEPS)
        other = random_motion(feasibility, form, random)
        tried = feasibility.within_limits(
            ExcitingMotion(form, best.start, best.coefficients + step * other.coefficients)
        )
        cost = value(tried)
        better = cost < lowest
        if better:
            best, lowest = tried, cost
        # One success in five keeps the size of the step (Rechenberg 1973).
        step *= _GROWTH if better else _GROWTH**-0.25
    # What is bent to be feasible may have lost what it was to show; what is shrunk is the same motion, though smaller.
    return max((feasibility.made_feasible(best), costs.improved(best)), key=judge.least)
