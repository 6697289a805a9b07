"""What a robot with given inertias takes to move, and how that changes with its motion and with gravity; and, without
regressors and so fast enough for every message, what one with known parameters takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pinocchio as pin

from geomid_ros.model.columns import entries_of
from geomid_ros.model.effects import LoadEffect, Motion, MotionEffect, Place, joint_of
from geomid_ros.model.effects.situation import Sensitivity
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import SIGN, Samples
from geomid_ros.types import FloatArray, frozen

STEP = 1e-5
"""Of derivatives by differences, in rad, rad/s, rad/s^2, or tangent coordinates."""


class Dynamics:
    """The channels of a measurement model as functions of the motion, for fixed ``inertias (all bodies, 10)``.

    Joints' efforts by the recursive Newton-Euler algorithm and its derivatives (Carpentier & Mansard 2018); a mounted
    sensor's wrench is the force through its joint in a robot of which only what it carries has a mass. The sum of
    wrenches on a floating base is not differentiated (zero).
    """

    def __init__(self, model: MeasurementModel, inertias: FloatArray) -> None:
        self._model = model
        self._robot = model.robot
        self._inertias = inertias
        self._coupling = self._robot.coupling
        self._whole = self._robot.with_inertias(inertias, range(len(inertias)))
        self._data = self._whole.createData()
        self._carried = [
            (sensor, carried, carried.createData())
            for sensor in model.mounted
            for carried in [self._robot.with_inertias(inertias, self._robot.subtree(sensor.frame))]
        ]

    def efforts(self, samples: Samples) -> FloatArray:
        """Efforts ``(N, J)`` of the joints."""
        return self._robot.joint_efforts(*self._robot.configuration(samples), self._inertias)

    def sensitivity(self, samples: Samples) -> Sensitivity:
        """Derivatives of all channels at N instants."""
        joints, layout = len(self._robot.joints), self._model.layout
        found = [np.zeros((len(samples), len(self._model.channels), width)) for width in (joints, joints, joints, 3)]
        motion = list(zip(*self._robot.configuration(samples), strict=True))
        if layout.efforts:
            for target, term in zip(found, self._effort_terms(motion), strict=True):
                target[:, :joints] = term
        for index, state in enumerate(motion):
            for sensor, carried, data in self._carried:
                for target, term in zip(found, self._wrench_terms(carried, data, sensor.frame, *state), strict=True):
                    target[index, layout.wrenches[sensor.topic]] = term[sensor.axis_indices]
        return Sensitivity(*found)

    def _effort_terms(self, motion: Sequence[tuple[FloatArray, FloatArray, FloatArray]]) -> Iterator[FloatArray]:
        """Derivatives ``(N, joints, joints)`` of the efforts by q, v and a, and ``(N, joints, 3)`` by gravity."""
        # Instant by instant only what pinocchio does.
        size = self._whole.nv
        terms = np.empty((3, len(motion), size, size))
        for index, state in enumerate(motion):
            terms[:, index] = pin.computeRNEADerivatives(self._whole, self._data, *state)
        terms[2] = np.triu(terms[2]) + np.triu(terms[2], 1).transpose(0, 2, 1)
        for term in terms:
            yield self._coupling.T @ term @ self._coupling
        still = np.empty((3, len(motion), size))
        for gravity, _ in enumerate(_unit_gravities(self._whole)):
            for index, (q, _, _) in enumerate(motion):
                still[gravity, index] = pin.computeGeneralizedGravity(self._whole, self._data, q)
        yield self._coupling.T @ still.transpose(1, 2, 0)

    def _wrench_terms(
        self, model: pin.Model, data: pin.Data, frame: str, q: FloatArray, v: FloatArray, a: FloatArray
    ) -> Iterator[FloatArray]:
        """Derivatives ``(6, joints)`` of a carried wrench by q, v and a, and ``(6, 3)`` by gravity: differences."""

        def wrench(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
            return _carried_wrench(model, data, frame, q, v, a)

        steps = [STEP * velocities for velocities in self._coupling.T]
        still = np.zeros(model.nv)
        yield np.array(
            [wrench(pin.integrate(model, q, s), v, a) - wrench(pin.integrate(model, q, -s), v, a) for s in steps]
        ).T / (2.0 * STEP)
        yield np.array([wrench(q, v + s, a) - wrench(q, v - s, a) for s in steps]).T / (2.0 * STEP)
        # Acceleration and gravity enter linearly.
        yield np.array([wrench(q, v, a + s) - wrench(q, v, a) for s in steps]).T / STEP
        yield np.array([wrench(q, still, still) for _ in _unit_gravities(model)]).T


def _unit_gravities(model: pin.Model) -> Iterator[None]:
    """Set the model's gravity to each unit vector in turn, and at the end to what it was."""
    gravity = model.gravity.linear.copy()
    for unit in np.eye(3):
        model.gravity.linear = unit
        yield
    model.gravity.linear = gravity


def _carried_wrench(
    model: pin.Model, data: pin.Data, frame: str, q: FloatArray, v: FloatArray, a: FloatArray
) -> FloatArray:
    """Wrench ``(6,)`` that moves all massive bodies of ``model``, in the frame of the link ``frame``, at or after which
    they all are."""
    pin.rnea(model, data, q, v, a)
    at = model.frames[model.getFrameId(frame, pin.BODY)]
    total = data.f[at.parentJoint]
    if at.parentJoint == 0:
        total = pin.Force.Zero()
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0:
                total += data.oMi[joint].act(data.f[joint])
        own = model.inertias[0]
        total += pin.Force(own.mass * -model.gravity.linear, np.cross(own.mass * own.lever, -model.gravity.linear))
    return np.array(at.placement.actInv(total).vector)


class InverseDynamics:
    """Efforts that motors supply to a motion: the recursive Newton-Euler algorithm and the effects' columns.

    External loads are not among them. One thread may call it at a time.
    """

    def __init__(self, model: MeasurementModel, parameters: FloatArray) -> None:
        """
        Args:
            model: of the robot.
            parameters: of the model ``(D,)``.
        """
        first = 10 * len(model.identified)
        inertias = np.array([body.parameters for body in model.robot.bodies])
        inertias[list(model.identified)] = 0.0
        np.add.at(inertias, list(model.identified), parameters[:first].reshape(-1, 10))
        self.inertias = frozen(inertias)
        """Of all bodies ``(bodies, 10)``."""
        known = [(c, v) for c, v in zip(model.coefficients, parameters[first:].tolist(), strict=True) if v != 0.0]
        moving = [(c.effect, c.place, value) for c, value in known if isinstance(c.effect, MotionEffect)]
        self._robot = model.robot
        self._whole = _Motors(model.robot, inertias, moving)
        self._gears = _Motors(model.robot, model.loading, model.resisting)
        self._by_load: dict[LoadEffect, FloatArray] = {}
        for c, value in known:
            if isinstance(c.effect, LoadEffect):
                strengths = self._by_load.setdefault(c.effect, np.zeros(len(model.robot.joints)))
                strengths[joint_of(c.place)] = value

    def __call__(self, motion: FloatArray) -> FloatArray:
        """Efforts ``(N, joints)`` [N m, N] at positions, velocities and accelerations ``(3, N, joints)``."""
        states, configuration = Motion(motion), self._robot.moved(motion)
        efforts = self._whole(states, *configuration)
        if self._by_load:
            loads, signs = self._gears(states, *configuration), SIGN.values(states)
            for effect, strengths in self._by_load.items():
                efforts += strengths * effect.column(loads, signs)
        return efforts


class _Motors:
    """Efforts of bodies, and of effects of motion at places with their coefficients."""

    def __init__(
        self, robot: Robot, inertias: FloatArray, effects: Iterable[tuple[MotionEffect, Place, float]]
    ) -> None:
        self._robot = robot
        self._rigid = robot.with_inertias(inertias, range(len(inertias)))
        self._data = self._rigid.createData()
        self._entries, self._strengths = entries_of(effects, len(robot.joints))

    def __call__(self, states: Motion, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        rigid = self._robot.efforts_of(self._rigid, self._data, q, v, a)
        return np.asarray(rigid + self._entries.values(states) @ self._strengths)
