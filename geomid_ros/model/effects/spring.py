from __future__ import annotations

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.types import FloatArray


class Spring(Effect):
    """A spring or counterbalance: effort ``k q``; the offset that it comes with, ``-k q_0``, says where it rests."""

    name = "spring"
    label = "a spring"
    meaning = "effort stiffness (q - equilibrium), which the motor supplies against the spring"
    parameters = (
        ParameterForm("stiffness", ("N m/rad", "N/m"), mjcf="joint/stiffness"),
        ParameterForm("equilibrium", ("rad", "m"), mjcf="joint/springref"),
    )
    settled_by = "a slow sweep of this joint through its range in several postures of the others"
    adds_up = False
    positive = True  # as it is found; a file may say a spring that pushes away

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.position
