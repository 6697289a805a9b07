from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import MotionEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Motion, Place
from geomid_ros.types import FloatArray


class CommandDelay(MotionEffect):
    """Commands act c [s] after their stamps, to first order in c: effort(t) = gains (command(t - c) - measured(t)).

    Its column is the rate of the commands, which samples carry; no motion has it.
    """

    name = "command_delay"
    label = "a delay of commands"
    meaning = "effort = kp (q_c(t - delay) - q) + kd (v_c(t - delay) - v) + feed-forward(t - delay)"
    parameters = (ParameterForm("delay", ("s", "s"), above=-1.0, below=1.0),)
    of_sensor = True
    settled_by = "faster commands"
    place = "commands"

    def efforts(self, motion: Motion, place: Place) -> FloatArray:  # noqa: ARG002
        return np.zeros_like(motion.position)
