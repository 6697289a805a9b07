from __future__ import annotations

from geomid_ros.model.effects.effect import JointEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import JointMotion
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
