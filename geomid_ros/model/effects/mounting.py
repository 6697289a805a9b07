"""Mounting of the robot, and payloads of its links."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from geomid_ros.geometry.pseudo_inertia import INERTIA_NAMES
from geomid_ros.model.effects.effect import Effect, GravityEffect
from geomid_ros.model.effects.parameters import COM_ENTRIES, ParameterForm, Values
from geomid_ros.types import FloatArray

_NAMES = ("tilt_x", "tilt_y")


class GravityTilt(GravityEffect):
    """The base is turned by the rotation vector (c_x, c_y, 0) [rad]: gravity in the base frame is ``R^T g``."""

    name = "gravity_tilt"
    label = "a tilted base"
    meaning = "gravity in the base frame is R^T g, R the rotation by the vector (tilt_x, tilt_y, 0)"
    parameters = tuple(
        ParameterForm(name, ("rad", "rad"), above=-math.pi, below=math.pi, optional=True, mjcf="option/gravity")
        for name in _NAMES
    )
    settled_by = "slow motion of the first joint over its range, with the arm stretched out"
    place = "robot"
    count = len(parameters)
    largest = 0.5  # [rad] a base tilted further is mounted so on purpose
    confusable_with_payload = True
    relinearise_beyond = (0.03, 0.03)
    turns_gravity = True
    compensated_in_samples = True
    corrected_in_samples = True
    default_prior_std = (0.02, 0.02)  # [rad] about a degree

    def slopes(self, gravity: FloatArray, coefficients: FloatArray) -> FloatArray:
        turn = pin.Jexp3(np.append(coefficients, 0.0))[:, : self.count]
        return np.asarray(pin.skew(_turned(gravity, coefficients)) @ turn)

    @classmethod
    def tilted_gravity(cls, gravity: FloatArray, values: Values) -> FloatArray:
        """Return ``R^T g``."""
        return _turned(gravity, np.array([values[name] for name in _NAMES]))


def _turned(gravity: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return gravity rotated by the opposite rotation."""
    return np.asarray(pin.exp3(-np.append(tilt, 0.0)) @ gravity)


_URDF, _MJCF = "link/inertial", "body/inertial"


class CarriedBody(Effect):
    """Payload of a link; it is fitted like the bodies, as a separate pseudo-inertia."""

    name = "payload"
    label = "a payload"
    meaning = "a rigid body fixed to the link, in its frame; its inertia is about its centre of mass"
    parameters = (
        ParameterForm("mass", ("kg", "kg"), above=0.0, urdf=_URDF, mjcf=_MJCF),
        *(ParameterForm(name, ("m", "m"), urdf=_URDF, mjcf=_MJCF) for name in COM_ENTRIES),
        *(ParameterForm(name, ("kg m^2", "kg m^2"), optional=True, urdf=_URDF, mjcf=_MJCF) for name in INERTIA_NAMES),
    )
    stated_parameter_count = 4
    settled_by = "the same motion with and without the payload, or a wrench sensor that carries the link"
    place = "link"
    confusable_with_payload = True
    adds_up = False
    parts = ()  # a body has no coefficients
