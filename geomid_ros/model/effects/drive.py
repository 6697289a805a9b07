"""Between motor and link: rotor inertia, springs, gears that give or have play, and motors that turn two joints."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, Hinge, JointEffect, PairEffect, SituationEffect
from geomid_ros.model.effects.friction import CoulombFriction
from geomid_ros.model.effects.parameters import EFFORT, ByEffect, Found, ParameterForm, Quantities, Values
from geomid_ros.model.effects.sensor_errors import EffortOffset
from geomid_ros.model.effects.situation import JointMotion, Place, Situation, joint_of
from geomid_ros.types import FloatArray


class RotorInertia(JointEffect):
    """Inertia of motor and gears as felt at the joint (armature): effort ``c a``."""

    name = "rotor_inertia"
    label = "rotor inertia"
    meaning = "effort inertia a"
    parameters = (
        ParameterForm(
            "inertia", ("kg m^2", "kg"), above=0.0, mjcf="joint/armature", drake="actuator/drake:rotor_inertia"
        ),
    )
    like_a_payload = True
    before_gear = True
    settled_by = "fast accelerations of this joint alone, with the distal links stretched out and folded"

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.acceleration


_LARGEST_TURN = 12.6  # [rad] between the zero of a joint and the rest of its spring


class Spring(JointEffect):
    """A spring or counterbalance: effort ``k q``; the offset that it comes with, ``-k q_0``, says where it rests."""

    name = "spring"
    label = "a spring"
    meaning = "effort stiffness (q - equilibrium), which the motor supplies against the spring"
    parameters = (
        ParameterForm("stiffness", ("N m/rad", "N/m"), mjcf="joint/stiffness", gazebo="gazebo/springStiffness"),
        ParameterForm(
            "equilibrium", ("rad", "m"), optional=True, mjcf="joint/springref", gazebo="gazebo/springReference"
        ),
    )
    settled_by = "slow sweeps of this joint over its range, in several postures of the others"
    adds_up = False
    contains = "effort_offset"
    like_a_payload = True

    @property
    def positives(self) -> int:
        """The stiffness, as it is found; a file may say a spring that pushes away."""
        return 1

    @property
    def parts(self) -> tuple[Effect, ...]:
        """The stiffness, and the offset."""
        return self, EffortOffset()

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.position

    def is_absurd(self, coefficients: FloatArray) -> bool:
        """Whether it rests more than two turns away."""
        return bool(abs(coefficients[1]) > _LARGEST_TURN * coefficients[0])

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Stiffness, and the position at which the effort is zero."""
        stiffness, offset = coefficients
        derivative = [[1.0, 0.0], [offset / stiffness**2, -1.0 / stiffness]]
        return np.array([stiffness, -offset / stiffness]), np.array(derivative)

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """The stiffness, and the offset of a spring that rests elsewhere than at zero."""
        found: dict[Effect, tuple[float, ...]] = {cls(): (values["stiffness"],)}
        if values["equilibrium"]:
            found[EffortOffset()] = (-values["stiffness"] * values["equilibrium"],)
        return found

    @classmethod
    def refined(cls, known: Quantities, found: ByEffect) -> tuple[Quantities, ByEffect]:
        """The estimated offset has that of the spring in it; the spring keeps its equilibrium."""
        own, left = super().refined(known, found)
        if not {cls.name, EffortOffset.name} <= found.keys() or "equilibrium" not in own:
            return own, left
        offset = left[EffortOffset.name]["offset"]
        rest = offset.value + own["stiffness"].value * own["equilibrium"].value
        return own, {**left, EffortOffset.name: {"offset": replace(offset, value=rest)}}


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


_RATIO = ParameterForm("ratio", ("-", "-"), mjcf="tendon/coef")


@dataclass(frozen=True)
class _CoupledMotor(PairEffect):
    """An effect of a motor that turns by ``q_1 + ratio q_2`` and so is felt at both joints, at the second ``ratio``
    times; ``ratio`` is 1, or -1 where the joints turn against each other."""

    ratio: float = 1.0

    adds_up = False
    before_gear = True
    settled_by: ClassVar[str] = "motion of each joint alone, and of both together"

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """Both directions."""
        return cls(1.0), cls(-1.0)

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        """Both directions."""
        return cls.variants()

    @abstractmethod
    def of_motor(self, motor: JointMotion) -> FloatArray:
        """Effort ``(...)`` of the motor per unit of the coefficient."""

    def columns(self, first: JointMotion, second: JointMotion) -> tuple[FloatArray, FloatArray]:
        effort = self.of_motor(JointMotion(first.states + self.ratio * second.states))
        return effort, self.ratio * effort

    def constants(self, found: object, unsure: float, usual_load: float) -> list[tuple[float, float]]:  # noqa: ARG002
        """The ratio."""
        return [(self.ratio, 0.0)]

    @classmethod
    def from_values(cls, values: Values, usual_load: float = 0.0) -> _CoupledMotor:  # noqa: ARG003
        """With its ratio."""
        return cls(values["ratio"])


class CoupledViscousFriction(_CoupledMotor):
    """Viscous friction of a motor that turns two joints: effort ``c (v_1 + ratio v_2)``."""

    name = "coupled_viscous_friction"
    label = "viscous friction of a motor that turns both joints"
    meaning = "effort coefficient (v_1 + ratio v_2) at the first joint, ratio times as much at the second"
    parameters = (ParameterForm("coefficient", ("N m s/rad", "N s/m"), above=0.0, mjcf="tendon/damping"), _RATIO)
    drift = FRICTION_DRIFT

    def of_motor(self, motor: JointMotion) -> FloatArray:
        return motor.velocity


class CoupledCoulombFriction(_CoupledMotor):
    """Dry friction of a motor that turns two joints: effort ``c sign(v_1 + ratio v_2)``."""

    name = "coupled_coulomb_friction"
    label = "Coulomb friction of a motor that turns both joints"
    meaning = "effort level sign(v_1 + ratio v_2) at the first joint, ratio times as much at the second"
    parameters = (ParameterForm("level", EFFORT, above=0.0, mjcf="tendon/frictionloss"), _RATIO)
    drift = FRICTION_DRIFT

    def of_motor(self, motor: JointMotion) -> FloatArray:
        return CoulombFriction().column(motor)


class CoupledRotorInertia(_CoupledMotor):
    """Inertia of a motor that turns two joints: effort ``c (a_1 + ratio a_2)``."""

    name = "coupled_rotor_inertia"
    label = "rotor inertia of a motor that turns both joints"
    meaning = "effort inertia (a_1 + ratio a_2) at the first joint, ratio times as much at the second"
    parameters = (ParameterForm("inertia", ("kg m^2", "kg"), above=0.0, mjcf="tendon/armature"), _RATIO)

    def of_motor(self, motor: JointMotion) -> FloatArray:
        return motor.acceleration
