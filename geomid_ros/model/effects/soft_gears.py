"""Gears between motor and link that give: elastic ones, and such as have play."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.effect import Effect, Hinge, SituationEffect
from geomid_ros.model.effects.parameters import Found, ParameterForm, Values
from geomid_ros.model.effects.situation import Place, Situation, joint_of
from geomid_ros.types import FloatArray

_DAMPING_RATIO = 0.05  # of the link on the elastic gear, the motor held


class JointElasticity(SituationEffect):
    """A gear that gives: the link is behind the measured position by ``c tau``, c the compliance [rad/(N m)]."""

    name = "joint_elasticity"
    label = "an elastic gear"
    meaning = "link position = measured (motor) position - tau/stiffness"
    parameters = (ParameterForm("stiffness", ("N m/rad", "N/m"), above=0.0, mjcf="elasticity/stiffness"),)
    settled_by = "faster motion, or an encoder on the link side"
    adds_up = False
    like_a_payload = True
    largest = 1.0  # [rad/(N m)]

    @property
    def positives(self) -> int:
        """The compliance."""
        return 1

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        loads = (situation.load, situation.load_rate, situation.load_acceleration)
        return situation.behind(joint, *(load[:, joint] for load in loads))

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The stiffness."""
        return 1.0 / coefficients, np.array([[-1.0 / coefficients[0] ** 2]])

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """The compliance."""
        return {cls(): (1.0 / values["stiffness"],)}

    @classmethod
    def hinge(cls, values: Values, carried: float) -> Hinge:
        """A spring between the motor and the link."""
        stiffness = values["stiffness"]
        damping = 2.0 * _DAMPING_RATIO * float(np.sqrt(stiffness * carried))
        return Hinge("elasticity", stiffness=stiffness, damping=damping)


CROSSINGS = tuple(float(time) for time in np.geomspace(0.003, 0.2, 15).round(4))
"""Times [s] that the usual load takes from one side of the play to the other, against the drag in the gear."""


@dataclass(frozen=True)
class Backlash(SituationEffect):
    """Play: the link is behind the measured position by half of c [rad], on the side to which the load has pushed it;
    it crosses the play in :data:`CROSSINGS` of ``crossing``."""

    crossing: int = len(CROSSINGS) // 2

    name = "backlash"
    label = "backlash"
    meaning = "play of gap in all between measured (motor) and link position, crossed at the speed tau/drag"
    parameters = (
        ParameterForm("gap", ("rad", "m"), above=0.0, mjcf="backlash/range"),
        ParameterForm("drag", ("N m s/rad", "N s/m"), above=0.0, optional=True, mjcf="backlash/damping"),
    )
    settled_by = "slow motion in which the load of this joint changes sign"
    largest = 0.2  # [rad]
    adds_up = False

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """One for each of :data:`CROSSINGS`."""
        return tuple(cls(place) for place in range(len(CROSSINGS)))

    @property
    def scanned(self) -> float:
        """The time of a crossing [s]."""
        return CROSSINGS[self.crossing]

    @property
    def positives(self) -> int:
        """The gap."""
        return 1

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        side, rate, acceleration = (each[:, joint, self.crossing] for each in situation.of_load(sides))
        return 0.5 * situation.behind(joint, side, rate, acceleration)

    def constants(self, found: Sequence[Found], unsure: float, usual_load: float) -> list[Found]:
        """The drag, against which the usual load crosses the gap in the time that was scanned."""
        ((gap, std),) = found
        drag = usual_load * self.scanned / gap
        return [(drag, drag * float(np.hypot(unsure, std / gap)))]

    @classmethod
    def from_values(cls, values: Values, usual_load: float = 0.0) -> Backlash:
        """The one whose crossing takes most nearly as long as against this drag."""
        if usual_load <= 0.0 or values["drag"] <= 0.0:
            return cls()
        wanted = values["drag"] * values["gap"] / usual_load
        return cls(int(np.argmin(np.abs(np.log(np.array(CROSSINGS) / wanted)))))

    @classmethod
    def hinge(cls, values: Values, carried: float) -> Hinge:  # noqa: ARG003
        """A hinge with ends, and with the drag between them."""
        return Hinge("backlash", damping=values["drag"], half_range=0.5 * values["gap"])


def sides(load: FloatArray, period: float) -> FloatArray:
    """On which side of their play the gears are.

    The load pushes the link through the play against a drag: its speed is in proportion to the load.

    Args:
        load: of the gears ``(N, J)``, sampled every ``period`` [s].

    Returns:
        from -1 to 1 ``(N, J, K)``, for each of :data:`CROSSINGS`.
    """
    usual = np.maximum(np.std(load, axis=0), 1e-12)
    steps: FloatArray = (load / usual)[:, :, None] * (2.0 * period / np.array(CROSSINGS))
    result = np.empty_like(steps)
    side = np.sign(steps[0])
    for index, step in enumerate(steps):
        side = np.minimum(np.maximum(side + step, -1.0), 1.0)
        result[index] = side
    return result
