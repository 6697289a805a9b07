"""What a motor that turns two joints together adds at both of them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from geomid_ros.model.effects.dry_friction import CoulombFriction
from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, PairEffect
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm, Values
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray

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
