"""Errors of effort sensors, wrench sensors and IMUs, and commands that act late."""

from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointEffect, RobotEffect, SensorEffect, SituationEffect
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm, Quantities, Values
from geomid_ros.model.effects.situation import JointMotion, Motion, Place, Situation, joint_of
from geomid_ros.types import FloatArray


class EffortOffset(JointEffect):
    """A constant error of the effort measurement."""

    name = "effort_offset"
    label = "an offset of the measured effort"
    meaning = "measured effort = true + offset; with a gain, gain (true + offset)"
    parameters = (ParameterForm("offset", EFFORT),)
    confusable_with_payload = True
    is_sensor_error = True
    # If a joint moves little, gravity looks like an offset: with a wider prior an offset could absorb a mass.
    prior_std_fraction = 0.05
    settled_by = "a recording in which gravity loads the joint in both directions"

    def column(self, motion: JointMotion) -> FloatArray:
        return np.ones_like(motion.velocity)

    @classmethod
    def effort_shift(cls, values: Values) -> float:
        """Return the offset."""
        return values["offset"]


_USED = (-0.7, 2.0)  # range of scale errors at which a model may be built


class _Gain(Effect):
    """A factor ``1 + c``."""

    parameters = (ParameterForm("gain", ("-", "-"), above=0.0),)
    settled_by = "the same motion with a known payload"
    adds_up = False
    absent_value = 1.0
    confusable_with_payload = True
    positives = 0  # the gain minus 1

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gain."""
        return 1.0 + coefficients, np.eye(1)

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """Return the gain minus 1."""
        return {cls(): (values["gain"] - 1.0,)}

    @classmethod
    def combined(cls, first: Quantities, second: Quantities) -> Quantities:
        """Multiply the gains."""
        return {"gain": second["gain"].scaled(first["gain"].value)}


class DriveGain(_Gain):
    """Scale error of the load in the measured effort: what a joint's links need is measured ``(1 + c)`` times.

    A wrong torque constant is one; friction and the rotor's inertia are then in units of the measured effort. Its
    column is the effort of the links that are identified, so it is fitted when these are known.
    """

    name = "drive_gain"
    label = "a gain error of the joint's drive"
    meaning = "measured effort = gain * (effort of the links) + friction and rotor inertia + offset"
    is_sensor_error = True
    default_prior_std = (0.03,)  # of the torque constants of robots
    has_columns = False

    @classmethod
    def load_scale(cls, values: Values) -> float:
        """Return the gain."""
        return values["gain"]


class EffortGain(_Gain, SituationEffect):
    """Scale error of an effort sensor: the measured effort is ``(1 + c)`` times the true one."""

    name = "effort_gain"
    label = "a gain error of the measured effort"
    meaning = "measured effort = gain (true + offset)"
    compensated_in_samples = True
    default_prior_std = (0.1,)
    scales_measurement = True
    corrected_in_samples = True

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """True if no model may be built at these coefficients."""
        return bool(np.any(coefficients != self.linearised_at(coefficients)))

    def linearised_at(self, coefficients: FloatArray) -> FloatArray:
        return np.clip(coefficients, *_USED)

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        return situation.column_of(joint, situation.predicted[:, joint])

    @classmethod
    def effort_scale(cls, values: Values) -> float:
        """Return the gain."""
        return values["gain"]


class EffortDelay(SituationEffect):
    """All efforts are measured too late by c [s]: measured(t) = true(t - c).

    Only the efforts of the rigid bodies identify it. Dry friction changes sign later after a reversal than any function
    of speed (presliding); with its large steps this looks like a delay of some milliseconds.
    """

    name = "effort_delay"
    label = "a delay between efforts and motion"
    meaning = "measured effort(t) = true(t - delay), at all joints"
    parameters = (ParameterForm("delay", ("s", "s"), above=-1.0, below=1.0),)
    settled_by = "faster motions"
    place = "robot"
    relinearise_beyond = (2e-3,)
    compensated_in_samples = True
    largest = 0.2  # [s]
    corrected_in_samples = True

    def columns(self, situation: Situation, place: Place) -> FloatArray:  # noqa: ARG002  # all joints alike
        joints = slice(situation.load.shape[1])
        return situation.column_of(joints, -situation.load_rate)

    @classmethod
    def effort_lag(cls, values: Values) -> float:
        """Return the delay."""
        return values["delay"]


class EncoderOffset(SituationEffect):
    """An encoder's zero is off: the link lags the measured position by a constant c [rad]."""

    name = "encoder_offset"
    label = "an offset of the encoder"
    meaning = "link position = measured position - offset"
    parameters = (ParameterForm("offset", ("rad", "m"), mjcf="joint/ref"),)
    settled_by = "a reference pose, in which the joint's position is known"
    confusable_with_payload = True
    default_prior_std = (0.02,)  # [rad] about a degree

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        moved = np.ones(len(situation.load))
        return situation.lag_column(joint_of(place), moved, 0.0 * moved, 0.0 * moved)


class WrenchOffset(SensorEffect):
    """A constant error of a wrench sensor: one coefficient for each of its axes."""

    name = "wrench_offset"
    label = "an offset of the wrench sensor"
    meaning = "measured wrench = true + (fx ... tz), in the sensor's frame"
    parameters = (
        *(ParameterForm(name, ("N", "N"), optional=True) for name in ("fx", "fy", "fz")),
        *(ParameterForm(name, ("N m", "N m"), optional=True) for name in ("tx", "ty", "tz")),
    )
    settled_by = "static poses with the sensor in many orientations"
    confusable_with_payload = True
    corrected_in_samples = True

    @classmethod
    def wrench_shift(cls, values: Values) -> dict[str, float]:
        """Return the offset."""
        return dict(values)


class ImuOffset(SensorEffect):
    """Constant error of an IMU's acceleration perpendicular to gravity, times the robot's mass: a bias or a tilt.

    Parallel to gravity it cannot be distinguished from mass.
    """

    name = "imu_offset"
    label = "an offset of the IMU's acceleration"
    meaning = "force of the ground = mass * measured acceleration + (fx, fy), in the base frame"
    parameters = tuple(ParameterForm(name, ("N", "N"), optional=True) for name in ("fx", "fy"))
    settled_by = "standing on level ground, and again turned by half a turn"
    place = "base"
    count = len(parameters)


class CommandDelay(RobotEffect):
    """Commands act c [s] after their stamps, to first order in c: effort(t) = gains (command(t - c) - measured(t)).

    Its column is the rate of the commands in the samples; it does not follow from the motion.
    """

    name = "command_delay"
    label = "a delay of commands"
    meaning = "effort = kp (q_c(t - delay) - q) + kd (v_c(t - delay) - v) + feed-forward(t - delay)"
    parameters = (ParameterForm("delay", ("s", "s"), above=-1.0, below=1.0),)
    is_sensor_error = True
    settled_by = "faster commands"
    place = "commands"

    def efforts(self, motion: Motion, place: Place) -> FloatArray:  # noqa: ARG002
        return np.zeros_like(motion.position)
