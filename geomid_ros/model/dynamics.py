"""What a robot with given inertias takes to move, and how that changes with its motion and with gravity."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of C channels at N instants by the joints' motion, ``(N, C, J)``, and by gravity, ``(N, C, 3)``."""

    by_position: FloatArray
    by_velocity: FloatArray
    by_acceleration: FloatArray
    by_gravity: FloatArray


class Dynamics:
    """The channels of a measurement model as functions of the motion, for fixed ``inertias (all bodies, 10)``.

    Joints' efforts by the recursive Newton-Euler algorithm and its derivatives (Carpentier & Mansard 2018); a mounted
    sensor's wrench is the force through its joint in a robot of which only what it carries has a mass. The sum of
    wrenches on a floating base is not differentiated (zero).
    """

    def __init__(self, model: MeasurementModel, inertias: FloatArray) -> None:
        self._model = model
        self._robot = model.robot
        self._whole = self._robot.with_inertias(inertias, range(len(inertias)))
        self._data = self._whole.createData()
        self._carried = [
            (sensor, carried, carried.createData())
            for sensor in model.mounted
            for carried in [self._robot.with_inertias(inertias, self._robot.subtree(sensor.frame))]
        ]

    def efforts(self, samples: Samples) -> FloatArray:
        """Efforts ``(N, J)`` of the joints."""
        rows = self._robot.velocity_rows
        motion = zip(*self._robot.configuration(samples), strict=True)
        return np.array([pin.rnea(self._whole, self._data, q, v, a)[rows] for q, v, a in motion])

    def sensitivity(self, samples: Samples) -> Sensitivity:
        """Derivatives of all channels at N instants."""
        count, joints = len(samples), len(self._robot.joints)
        channels, layout = len(self._model.channels), self._model.layout
        derivatives = [np.zeros((count, channels, joints)) for _ in range(3)]
        by_gravity = np.zeros((count, channels, 3))
        for index, (q, v, a) in enumerate(zip(*self._robot.configuration(samples), strict=True)):
            if layout.efforts:
                self._joint_terms(q, v, a, index, derivatives, by_gravity)
            for sensor, carried, data in self._carried:
                rows = layout.wrenches[sensor.topic]
                terms = _wrench_terms(self._robot, carried, data, sensor.frame, (q, v, a))
                for target, term in zip((*derivatives, by_gravity), terms, strict=True):
                    target[index, rows] = term[sensor.axis_indices]
        return Sensitivity(derivatives[0], derivatives[1], derivatives[2], by_gravity)

    def _joint_terms(
        self, q: FloatArray, v: FloatArray, a: FloatArray, index: int, targets: list[FloatArray], by_gravity: FloatArray
    ) -> None:
        joints = np.ix_(self._robot.velocity_rows, self._robot.velocity_rows)
        terms = pin.computeRNEADerivatives(self._whole, self._data, q, v, a)
        for target, term in zip(targets, terms, strict=True):
            target[index, : len(self._robot.joints)] = term[joints]
        mass = terms[2][joints]
        targets[2][index, : len(mass)] = np.triu(mass) + np.triu(mass, 1).T
        for axis in range(3):
            still = _gravity_effort(self._whole, self._data, q, axis)
            by_gravity[index, : len(mass), axis] = still[self._robot.velocity_rows]


def _gravity_effort(model: pin.Model, data: pin.Data, q: FloatArray, axis: int) -> FloatArray:
    gravity = model.gravity.linear.copy()
    model.gravity.linear = np.eye(3)[axis]
    effort = np.array(pin.computeGeneralizedGravity(model, data, q))
    model.gravity.linear = gravity
    return effort


def _wrench_terms(
    robot: Robot, model: pin.Model, data: pin.Data, frame: str, motion: tuple[FloatArray, FloatArray, FloatArray]
) -> Iterable[FloatArray]:
    """Derivatives ``(6, joints)`` of a carried wrench by the ``motion`` q, v and a, and ``(6, 3)`` by gravity:
    differences."""
    q, v, a = motion

    def wrench(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return robot.carried_wrench(model, data, frame, q, v, a)

    steps = [_STEP * unit for unit in np.eye(model.nv)[robot.velocity_rows]]
    still = np.zeros(model.nv)
    yield np.array(
        [wrench(pin.integrate(model, q, s), v, a) - wrench(pin.integrate(model, q, -s), v, a) for s in steps]
    ).T / (2.0 * _STEP)
    yield np.array([wrench(q, v + s, a) - wrench(q, v - s, a) for s in steps]).T / (2.0 * _STEP)
    # Acceleration and gravity enter linearly.
    yield np.array([wrench(q, v, a + s) - wrench(q, v, a) for s in steps]).T / _STEP
    gravity = model.gravity.linear.copy()
    columns = []
    for unit in np.eye(3):
        model.gravity.linear = unit
        columns.append(wrench(q, still, still))
    model.gravity.linear = gravity
    yield np.array(columns).T
