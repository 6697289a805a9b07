"""Drive train: rotor inertia, springs, elastic gears, backlash, and motors that turn two joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, Hinge, JointEffect, PairEffect, SituationEffect
from geomid_ros.model.effects.friction import CoulombFriction, ViscousFriction
from geomid_ros.model.effects.parameters import EFFORT, ByEffect, Found, ParameterForm, Quantities, Values
from geomid_ros.model.effects.sensor_errors import DriveGain, EffortOffset
from geomid_ros.model.effects.situation import JointMotion, Place, Situation, joint_of
from geomid_ros.types import FloatArray


class RotorInertia(JointEffect):
    """Reflected inertia of motor and gears at the joint (armature): effort ``c a``."""

    name = "rotor_inertia"
    label = "rotor inertia"
    meaning = "effort inertia a"
    parameters = (
        ParameterForm(
            "inertia", ("kg m^2", "kg"), above=0.0, mjcf="joint/armature", drake="actuator/drake:rotor_inertia"
        ),
    )
    confusable_with_payload = True
    before_gear = True
    settled_by = "fast accelerations of this joint alone, with the distal links stretched out and folded"

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.acceleration


_LARGEST_TURN = 12.6  # [rad] between the zero of a joint and its spring's equilibrium


class Spring(JointEffect):
    """A spring or counterbalance: effort ``k q``. Its other part, an offset ``-k q_0``, gives the equilibrium q_0."""

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
    confusable_with_payload = True
    load_error = DriveGain.default_prior_std[0]  # what a drive makes of its links' weight depends on the position, too
    positives = 1  # an estimated stiffness; a file may contain a negative one

    @property
    def parts(self) -> tuple[Effect, ...]:
        """Itself (the stiffness), and the offset."""
        return self, EffortOffset()

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.position

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """True if the equilibrium is more than two turns away."""
        return bool(abs(coefficients[1]) > _LARGEST_TURN * coefficients[0])

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return stiffness and equilibrium, the position of zero effort, with their derivatives."""
        stiffness, offset = coefficients
        derivative = [[1.0, 0.0], [offset / stiffness**2, -1.0 / stiffness]]
        return np.array([stiffness, -offset / stiffness]), np.array(derivative)

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """Return the stiffness, and an offset unless the equilibrium is at zero."""
        by_part: dict[Effect, tuple[float, ...]] = {cls(): (values["stiffness"],)}
        if values["equilibrium"]:
            by_part[EffortOffset()] = (-values["stiffness"] * values["equilibrium"],)
        return by_part

    @classmethod
    def updated(cls, known: Quantities, found: ByEffect) -> tuple[Quantities, ByEffect]:
        """Keep the spring's equilibrium, and remove the spring's offset from the estimated one."""
        updated, others = super().updated(known, found)
        if not {cls.name, EffortOffset.name} <= found.keys() or "equilibrium" not in updated:
            return updated, others
        offset = others[EffortOffset.name]["offset"]
        remaining = offset.value + updated["stiffness"].value * updated["equilibrium"].value
        return updated, {**others, EffortOffset.name: {"offset": replace(offset, value=remaining)}}


_DAMPING_RATIO = 0.05  # of the link on the elastic gear, with the motor fixed


class JointElasticity(SituationEffect):
    """An elastic gear: the link lags the measured position by ``c tau``, c the compliance [rad/(N m)]."""

    name = "joint_elasticity"
    label = "an elastic gear"
    meaning = "link position = measured (motor) position - tau/stiffness"
    parameters = (ParameterForm("stiffness", ("N m/rad", "N/m"), above=0.0, mjcf="elasticity/stiffness"),)
    settled_by = "faster motion, or an encoder on the link side"
    adds_up = False
    confusable_with_payload = True
    largest = 1.0  # [rad/(N m)]

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        loads = (situation.load, situation.load_rate, situation.load_acceleration)
        return situation.lag_column(joint, *(load[:, joint] for load in loads))

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the stiffness and its derivative by the compliance."""
        return 1.0 / coefficients, np.array([[-1.0 / coefficients[0] ** 2]])

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """Return the compliance."""
        return {cls(): (1.0 / values["stiffness"],)}

    @classmethod
    def hinge(cls, values: Values, carried: float) -> Hinge:
        """Return a spring between motor and link, lightly damped."""
        stiffness = values["stiffness"]
        damping = 2.0 * _DAMPING_RATIO * float(np.sqrt(stiffness * carried))
        return Hinge("elasticity", stiffness=stiffness, damping=damping)


CROSSINGS = tuple(float(time) for time in np.geomspace(0.003, 0.2, 15).round(4))
"""Times in which the typical load pushes the link across the gap against the drag in the gear [s]."""


@dataclass(frozen=True)
class Backlash(SituationEffect):
    """Backlash: the link is off the measured position by half of the gap c [rad], to the side where the load has pushed
    it. It crosses the gap in a time of :data:`CROSSINGS`, at the index ``crossing``."""

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
    def grid(cls) -> tuple[Effect, ...]:
        """Return one for each of :data:`CROSSINGS`."""
        return tuple(cls(crossing) for crossing in range(len(CROSSINGS)))

    @property
    def grid_value(self) -> float:
        """Time of a crossing [s]."""
        return CROSSINGS[self.crossing]

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        position, rate, acceleration = (
            values[:, joint, self.crossing] for values in situation.from_load_history(sides)
        )
        return 0.5 * situation.lag_column(joint, position, rate, acceleration)

    def constants(self, found: Sequence[Found], log_std: float, usual_load: float) -> list[Found]:
        """Return the drag against which the typical load crosses the gap in the chosen time."""
        ((gap, std),) = found
        drag = usual_load * self.grid_value / gap
        return [(drag, drag * float(np.hypot(log_std, std / gap)))]

    @classmethod
    def from_values(cls, values: Values, usual_load: float = 0.0) -> Backlash:
        """Return the instance whose crossing time is nearest to the time given by drag, gap and load."""
        if usual_load <= 0.0 or values["drag"] <= 0.0:
            return cls()
        time = values["drag"] * values["gap"] / usual_load
        return cls(int(np.argmin(np.abs(np.log(np.array(CROSSINGS) / time)))))

    @classmethod
    def hinge(cls, values: Values, carried: float) -> Hinge:  # noqa: ARG003
        """Return a hinge with end stops, damped by the drag."""
        return Hinge("backlash", damping=values["drag"], half_range=0.5 * values["gap"])


def sides(load: FloatArray, period: float) -> FloatArray:
    """Compute the position of links within their backlash.

    The load pushes the link across the gap against a drag, at a speed proportional to the load.

    Args:
        load: gear loads ``(N, J)``, sampled every ``period`` [s].

    Returns:
        positions from -1 to 1 ``(N, J, K)``, for each of :data:`CROSSINGS`.
    """
    typical = np.maximum(np.std(load, axis=0), 1e-12)
    steps: FloatArray = (load / typical)[:, :, None] * (2.0 * period / np.array(CROSSINGS))
    result = np.empty_like(steps)
    position = np.sign(steps[0])
    for index, step in enumerate(steps):
        position = np.minimum(np.maximum(position + step, -1.0), 1.0)
        result[index] = position
    return result


_RATIO = ParameterForm("ratio", ("-", "-"), mjcf="tendon/coef")


@dataclass(frozen=True)
class _CoupledMotor(PairEffect):
    """An effect of a motor that turns by ``q_1 + ratio q_2``: it acts on the first joint, and ``ratio`` times on the
    second. ``ratio`` is 1, or -1 if the joints turn against each other; ``of_motor``: the effect of a motor that turns
    one joint."""

    ratio: float = 1.0

    of_motor: ClassVar[JointEffect]
    adds_up = False
    before_gear = True
    settled_by: ClassVar[str] = "motion of each joint alone, and of both together"

    @classmethod
    def grid(cls) -> tuple[Effect, ...]:
        """Return both directions."""
        return cls(1.0), cls(-1.0)

    coarse_grid = grid

    @property
    def needs(self) -> tuple[Effect, ...]:
        """The motor's friction: whatever it turns, that is viscous and dry."""
        friction = CoupledViscousFriction(self.ratio), CoupledCoulombFriction(self.ratio)
        return tuple(effect for effect in friction if effect != self)

    def columns(self, first: JointMotion, second: JointMotion) -> tuple[FloatArray, FloatArray]:
        effort = self.of_motor.column(JointMotion(first.states + self.ratio * second.states))
        return effort, self.ratio * effort

    def constants(self, found: object, log_std: float, usual_load: float) -> list[tuple[float, float]]:  # noqa: ARG002
        """Return the ratio, which is exact."""
        return [(self.ratio, 0.0)]

    @classmethod
    def from_values(cls, values: Values, usual_load: float = 0.0) -> _CoupledMotor:  # noqa: ARG003
        """Return the instance with this ratio."""
        return cls(values["ratio"])


class CoupledViscousFriction(_CoupledMotor):
    """Viscous friction of a motor that turns two joints: effort ``c (v_1 + ratio v_2)``."""

    name = "coupled_viscous_friction"
    label = "viscous friction of a motor that turns both joints"
    meaning = "effort coefficient (v_1 + ratio v_2) at the first joint, ratio times as much at the second"
    parameters = (ParameterForm("coefficient", ("N m s/rad", "N s/m"), above=0.0, mjcf="tendon/damping"), _RATIO)
    drift = FRICTION_DRIFT
    of_motor = ViscousFriction()


class CoupledCoulombFriction(_CoupledMotor):
    """Dry friction of a motor that turns two joints: effort ``c sign(v_1 + ratio v_2)``."""

    name = "coupled_coulomb_friction"
    label = "Coulomb friction of a motor that turns both joints"
    meaning = "effort level sign(v_1 + ratio v_2) at the first joint, ratio times as much at the second"
    parameters = (ParameterForm("level", EFFORT, above=0.0, mjcf="tendon/frictionloss"), _RATIO)
    drift = FRICTION_DRIFT
    of_motor = CoulombFriction()


class CoupledRotorInertia(_CoupledMotor):
    """Inertia of a motor that turns two joints: effort ``c (a_1 + ratio a_2)``."""

    name = "coupled_rotor_inertia"
    label = "rotor inertia of a motor that turns both joints"
    meaning = "effort inertia (a_1 + ratio a_2) at the first joint, ratio times as much at the second"
    parameters = (ParameterForm("inertia", ("kg m^2", "kg"), above=0.0, mjcf="tendon/armature"), _RATIO)
    of_motor = RotorInertia()
