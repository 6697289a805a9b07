"""Inverse dynamics of a robot with given inertias, its derivatives by motion and gravity, and a version without
regressors that is fast enough to run for every message."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from geomid_ros.model.effects import LoadEffect, Motion, MotionEffect, Place, joint_of
from geomid_ros.model.effects.situation import Sensitivity
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import SIGN, Samples, entries_of
from geomid_ros.types import FloatArray, frozen

STEP = 1e-5
"""Step of finite differences, in rad, rad/s, rad/s^2, or tangent coordinates."""


class Dynamics:
    """Channels of a measurement model as functions of the motion, for fixed ``inertias (all bodies, 10)``.

    Joint efforts follow from the recursive Newton-Euler algorithm and its derivatives (Carpentier & Mansard 2018). A
    mounted sensor's wrench is the force through its joint in a robot where only the sensor's subtree has a mass. The
    sum of wrenches on a floating base is not differentiated (zero).
    """

    def __init__(self, model: MeasurementModel, inertias: FloatArray) -> None:
        self._model = model
        self._robot = model.robot
        self._inertias = inertias
        self._coupling = self._robot.coupling
        self._whole = self._robot.with_inertias(inertias, range(len(inertias)))
        self._data = self._whole.createData()
        self._carried = [
            (sensor, subtree, subtree.createData())
            for sensor in model.mounted
            for subtree in [self._robot.with_inertias(inertias, self._robot.subtree(sensor.frame))]
        ]

    def efforts(self, samples: Samples) -> FloatArray:
        """Compute joint efforts ``(N, J)``."""
        return self._robot.joint_efforts(*self._robot.configuration(samples), self._inertias)

    def sensitivity(self, samples: Samples) -> Sensitivity:
        """Compute derivatives of all channels for N samples."""
        joints, layout = len(self._robot.joints), self._model.layout
        blocks = [np.zeros((len(samples), len(self._model.channels), width)) for width in (joints, joints, joints, 3)]
        motion = list(zip(*self._robot.configuration(samples), strict=True))
        if layout.efforts:
            for target, term in zip(blocks, self._effort_terms(motion), strict=True):
                target[:, :joints] = term
        for index, state in enumerate(motion):
            for sensor, subtree, data in self._carried:
                for target, term in zip(blocks, self._wrench_terms(subtree, data, sensor.frame, *state), strict=True):
                    target[index, layout.wrenches[sensor.topic]] = term[sensor.axis_indices]
        return Sensitivity(*blocks)

    def _effort_terms(self, motion: Sequence[tuple[FloatArray, FloatArray, FloatArray]]) -> Iterator[FloatArray]:
        """Yield effort derivatives ``(N, joints, joints)`` by q, v and a, then ``(N, joints, 3)`` by gravity."""
        # Only pinocchio's calls are per sample.
        size = self._whole.nv
        terms = np.empty((3, len(motion), size, size))
        for index, state in enumerate(motion):
            terms[:, index] = pin.computeRNEADerivatives(self._whole, self._data, *state)
        terms[2] = np.triu(terms[2]) + np.triu(terms[2], 1).transpose(0, 2, 1)
        for term in terms:
            yield self._coupling.T @ term @ self._coupling
        static = self._whole.copy(), self._data, np.array([q for q, _, _ in motion])
        yield self._robot.efforts_by_gravity(*static, np.eye(3))

    def _wrench_terms(
        self, model: pin.Model, data: pin.Data, frame: str, q: FloatArray, v: FloatArray, a: FloatArray
    ) -> Iterator[FloatArray]:
        """Yield finite-difference derivatives ``(6, joints)`` of a wrench by q, v and a, then ``(6, 3)`` by gravity."""
        wrench = partial(_carried_wrench, model, data, frame)
        steps = [STEP * velocities for velocities in self._coupling.T]
        zeros = np.zeros(model.nv)
        yield np.array(
            [wrench(pin.integrate(model, q, s), v, a) - wrench(pin.integrate(model, q, -s), v, a) for s in steps]
        ).T / (2.0 * STEP)
        yield np.array([wrench(q, v + s, a) - wrench(q, v - s, a) for s in steps]).T / (2.0 * STEP)
        # Acceleration and gravity enter linearly.
        present = wrench(q, v, a)
        yield np.array([wrench(q, v, a + s) - present for s in steps]).T / STEP
        yield np.array([wrench(q, zeros, zeros) for _ in _unit_gravities(model)]).T


def _unit_gravities(model: pin.Model) -> Iterator[None]:
    """Set the model's gravity to each unit vector in turn, then restore it."""
    gravity = model.gravity.linear.copy()
    for unit in np.eye(3):
        model.gravity.linear = unit
        yield
    model.gravity.linear = gravity


def _carried_wrench(
    model: pin.Model, data: pin.Data, frame: str, q: FloatArray, v: FloatArray, a: FloatArray
) -> FloatArray:
    """Compute the wrench ``(6,)`` that moves all bodies of ``model`` that have a mass, in the frame of the link
    ``frame``; they must all be in its subtree."""
    pin.rnea(model, data, q, v, a)
    link_frame = model.frames[model.getFrameId(frame, pin.BODY)]
    wrench = data.f[link_frame.parentJoint]
    if link_frame.parentJoint == 0:
        wrench = pin.Force.Zero()
        for joint in model.children[0]:
            wrench += data.oMi[joint].act(data.f[joint])
        base = model.inertias[0]
        wrench += pin.Force(base.mass * -model.gravity.linear, np.cross(base.mass * base.lever, -model.gravity.linear))
    return np.array(link_frame.placement.actInv(wrench).vector)


def motor_parameters(model: MeasurementModel, parameters: FloatArray) -> FloatArray:
    """Parameters ``(D,)`` without errors of effort sensors, which move nothing."""
    in_motors = np.logical_not([c.effect.is_sensor_error for c in model.coefficients])
    return np.asarray(parameters * np.append(np.ones(len(model.nominal_inertias)), in_motors))


class InverseDynamics:
    """Motor efforts of a motion, by the recursive Newton-Euler algorithm and the effects' columns.

    External loads are not included. Only one thread may call it at a time.
    """

    def __init__(self, model: MeasurementModel, parameters: FloatArray) -> None:
        """
        Args:
            model: measurement model of the robot.
            parameters: its parameters ``(D,)``.
        """
        first = 10 * len(model.identified)
        inertias = np.array([body.parameters for body in model.robot.bodies])
        inertias[list(model.identified)] = 0.0
        np.add.at(inertias, list(model.identified), parameters[:first].reshape(-1, 10))
        self.inertias = frozen(inertias)
        """Parameters of all bodies ``(bodies, 10)``."""
        nonzero = [(c, v) for c, v in zip(model.coefficients, parameters[first:].tolist(), strict=True) if v != 0.0]
        robot = model.robot.with_gravity(model.gravity_at(parameters))
        motion_effects = [(c.effect, c.place, value) for c, value in nonzero if isinstance(c.effect, MotionEffect)]
        self._robot = robot
        gains = model.drive_gains[list(model.layout.efforts)]
        self._whole = _Motors(robot, inertias, motion_effects, gains)
        self._gears = _Motors(robot, model.gear_inertias, ())
        self._by_load: dict[LoadEffect, FloatArray] = {}
        for c, value in nonzero:
            if isinstance(c.effect, LoadEffect):
                strengths = self._by_load.setdefault(c.effect, np.zeros(len(model.robot.joints)))
                strengths[joint_of(c.place)] = value

    def __call__(self, motion: FloatArray) -> FloatArray:
        """Compute efforts ``(N, joints)`` [N m, N] at positions, velocities and accelerations ``(3, N, joints)``."""
        states, configuration = Motion(motion), self._robot.moved(motion)
        efforts = self._whole(states, *configuration)
        if self._by_load:
            loads, signs = self._gears(states, *configuration), SIGN.values(states)
            for effect, strengths in self._by_load.items():
                efforts += strengths * effect.column(loads, signs)
        return efforts


class _Motors:
    """Efforts of bodies, times ``gains``, and of motion effects, given as (effect, place, coefficient)."""

    def __init__(
        self,
        robot: Robot,
        inertias: FloatArray,
        effects: Iterable[tuple[MotionEffect, Place, float]],
        gains: FloatArray | float = 1.0,
    ) -> None:
        self._robot = robot
        self._rigid = robot.with_inertias(inertias, range(len(inertias)))
        self._data = self._rigid.createData()
        self._entries, self._strengths = entries_of(effects, len(robot.joints))
        self._gains = gains

    def __call__(self, states: Motion, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        rigid = self._robot.efforts_of(self._rigid, self._data, q, v, a)
        return np.asarray(self._gains * rigid + self._entries.values(states) @ self._strengths)
