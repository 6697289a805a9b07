"""Constant errors of wrench sensors and IMUs, and commands that act late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.model.effects.effect import MotionEffect, SensorEffect
from geomid_ros.model.effects.parameters import ParameterForm, Values
from geomid_ros.model.effects.situation import Motion, Place
from geomid_ros.types import FloatArray


class WrenchOffset(SensorEffect):
    """A constant error of a wrench sensor: one more number for each of its axes."""

    name = "wrench_offset"
    label = "an offset of the wrench sensor"
    meaning = "measured wrench = true + (fx ... tz), in the sensor's frame"
    parameters = (
        *(ParameterForm(name, ("N", "N"), optional=True) for name in ("fx", "fy", "fz")),
        *(ParameterForm(name, ("N m", "N m"), optional=True) for name in ("tx", "ty", "tz")),
    )
    settled_by = "static poses with the sensor in many orientations"
    like_a_payload = True
    corrected_in_samples = True

    def columns(self, motion: Motion, axes: Sequence[str]) -> FloatArray:
        return np.broadcast_to(np.eye(len(axes)), (*motion.position.shape[:-1], len(axes), len(axes)))

    @classmethod
    def wrench_shift(cls, values: Values) -> dict[str, float]:
        """The offset."""
        return dict(values)


class ImuOffset(SensorEffect):
    """A constant error of an IMU's acceleration across gravity, times the robot's mass: a bias, or the IMU is turned.

    Along gravity it cannot be distinguished from mass.
    """

    name = "imu_offset"
    label = "an offset of the IMU's acceleration"
    meaning = "force of the ground = mass * measured acceleration + (fx, fy), in the base frame"
    parameters = tuple(ParameterForm(name, ("N", "N"), optional=True) for name in ("fx", "fy"))
    settled_by = "standing on level ground, and again turned by half a turn"
    place = "base"
    count = 2

    def columns(self, motion: Motion, axes: Sequence[str]) -> FloatArray:
        return np.broadcast_to(np.eye(len(axes)), (*motion.position.shape[:-1], len(axes), len(axes)))


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
