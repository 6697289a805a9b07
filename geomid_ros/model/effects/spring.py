from __future__ import annotations

from dataclasses import replace

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointEffect
from geomid_ros.model.effects.effort_offset import EffortOffset
from geomid_ros.model.effects.parameters import ByEffect, ParameterForm, Quantities, Values
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray

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
