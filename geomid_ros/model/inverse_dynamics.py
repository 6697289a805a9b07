"""Joint efforts of a robot with known parameters, without regressors: fast enough for every message."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from geomid_ros.model.columns import Column, JointColumn, column_of
from geomid_ros.model.effects import LoadEffect, Motion, MotionEffect, Place, joint_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.moving import SIGN
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray, frozen


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
        self._whole = _Motors(model.robot, inertias, moving)
        self._by_load = [(c.effect, joint_of(c.place), value) for c, value in known if isinstance(c.effect, LoadEffect)]
        self._gears = _Motors(model.robot, model.loading, model.resisting)

    def __call__(self, motion: FloatArray) -> FloatArray:
        """Efforts ``(N, joints)`` [N m, N] at positions, velocities and accelerations ``(3, N, joints)``."""
        efforts = self._whole(motion)
        if self._by_load:
            loads, signs = self._gears(motion), SIGN.values(Motion(*motion))
            for effect, joint, value in self._by_load:
                efforts[:, joint] += value * effect.column(loads[:, joint], signs[:, joint])
        return efforts


class _Motors:
    """Efforts of bodies, and of effects of motion at places with their coefficients."""

    def __init__(
        self, robot: Robot, inertias: FloatArray, effects: Iterable[tuple[MotionEffect, Place, float]]
    ) -> None:
        self._robot = robot
        self._rigid = robot.with_inertias(inertias, range(len(inertias)))
        self._data = self._rigid.createData()
        self._strengths: dict[Column, FloatArray] = {}
        for effect, place, value in effects:
            column = column_of(effect, place)
            strengths = self._strengths.setdefault(column, np.zeros(len(robot.joints)))
            strengths[joint_of(place) if isinstance(column, JointColumn) else slice(None)] += value

    def __call__(self, motion: FloatArray) -> FloatArray:
        efforts = self._robot.efforts_of(self._rigid, self._data, *self._robot.moved(motion))
        states = Motion(*motion)
        for column, strengths in self._strengths.items():
            efforts += strengths * column.values(states)
        return efforts
