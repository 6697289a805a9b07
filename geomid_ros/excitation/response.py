"""What effects would add to the efforts of a motion that has not been run yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.dynamics import Dynamics
from geomid_ros.model.effects import Effect, MotionEffect, OnLink, Place, Situation, SituationEffect, Values
from geomid_ros.model.effects.situation import Derivatives, OfLoad
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import SIGN, samples_of
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class Responses:
    """Columns of effects at instants that are one ``period`` apart, of a robot with ``inertias (all bodies, 10)``."""

    model: MeasurementModel
    inertias: FloatArray

    def columns(self, states: FloatArray, period: float, effects: Sequence[tuple[Effect, Place]]) -> list[FloatArray]:
        """Efforts ``(N, J, k)`` per unit of each coefficient of each effect, at ``states (3, N, J)``."""
        samples = samples_of(states, len(self.model.sensors))
        needed = any(isinstance(part, SituationEffect) for effect, _ in effects for part in effect.parts)
        situation = self._situation(states, period) if needed else None
        found = []
        for effect, place in effects:
            if isinstance(place, OnLink):
                first = 10 * place.link
                found.append(self.model.rows(samples).coefficients[:, : states.shape[2], first : first + 10])
                continue
            own = [self._part(part, place, states, situation) for part in effect.parts]
            found.append(np.concatenate(own, axis=2))
        return found

    def _part(self, part: Effect, place: Place, states: FloatArray, situation: Situation | None) -> FloatArray:
        if isinstance(part, SituationEffect) and situation is not None:
            return part.columns(situation, place)[:, : states.shape[2]]
        if isinstance(part, MotionEffect):
            return part.efforts(samples_of(states).motion, place)[:, :, None]
        return np.zeros((*states.shape[1:], 0))

    def _situation(self, states: FloatArray, period: float) -> Situation:
        samples = samples_of(states, len(self.model.sensors))
        dynamics = Dynamics(self.model, self.inertias)
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
            gravity=self.model.robot.gravity,
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
