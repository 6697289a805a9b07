"""The simulated robot: rigid bodies, joints and sensors in MuJoCo. The only file that imports MuJoCo."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.simulation.description import Description, LinkInertia
from geomid_ros.simulation.effects import MECHANICAL
from geomid_ros.simulation.options import JointEffect
from geomid_ros.types import FloatArray

GRAVITY = 9.81
"""Downwards along the world's z [m/s^2]."""

# MuJoCo's dry friction is a soft constraint: constant while a joint moves, but near standstill it only damps, below a
# speed of about this time [s] times the deceleration that friction alone would cause. MuJoCo's default, 0.02, is soft.
_FRICTION_TIME = 0.004
_SENSOR = "wrench"


def load_mujoco() -> Any:
    """The module, imported when it is first needed."""
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise InputError(f"simulating needs MuJoCo, which does not import ({error}): pip install mujoco") from error


class Plant:
    """A robot with a fixed base, hinges and slides, driven by the joints' efforts.

    Arrays ``(n,)`` follow ``joints``, which is MuJoCo's order. Joint friction, rotor inertia and effort limits
    are MuJoCo's ``damping``, ``frictionloss``, ``armature`` and ``actuatorfrcrange``. Nothing collides.
    """

    def __init__(
        self,
        description: Description,
        bodies: Iterable[LinkInertia],
        effects: Iterable[JointEffect] = (),
        wrench_frame: str | None = None,
    ) -> None:
        self._mujoco = load_mujoco()
        if wrench_frame is not None:
            _check_frame(description, wrench_frame)
        try:
            self._model = _compiled(self._mujoco, description, bodies, wrench_frame)
        except ValueError as error:
            raise InputError(f"MuJoCo cannot build this robot: {error}. Correct its URDF.") from error
        self._data = self._mujoco.MjData(self._model)
        self.joints = tuple(self._model.joint(index).name for index in range(self._model.njnt))
        self._apply(effects)

    def _apply(self, effects: Iterable[JointEffect]) -> None:
        for effect in effects:
            if effect.name in MECHANICAL:
                MECHANICAL[effect.name](self._model, self.joints.index(effect.joint), effect.value)
        self._mujoco.mj_setConst(self._model, self._data)

    def moves(self, link: str) -> bool:
        """Whether any joint moves the link."""
        return bool(self._model.body(link).weldid[0] != 0)

    def acceleration(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> FloatArray:
        """Joint accelerations ``(n,)`` under commanded ``effort (n,)``, cut to the joints' effort limits."""
        data = self._data
        data.qpos[:] = position
        data.qvel[:] = velocity
        data.ctrl[:] = effort
        self._mujoco.mj_forwardSkip(self._model, data, self._mujoco.mjtStage.mjSTAGE_NONE, 1)
        acceleration: FloatArray = data.qacc.copy()
        return acceleration

    def effort(self) -> FloatArray:
        """The actuators' efforts ``(n,)`` at the state last given to :meth:`acceleration`."""
        effort: FloatArray = self._data.qfrc_actuator.copy()
        return effort

    def wrench(self) -> FloatArray:
        """Force [N] and torque [N m], ``(6,)``, at the state last given to :meth:`acceleration`; ``(0,)`` unsensed.

        It is what the side of the base applies to the far side, about the sensor frame's origin in its axes: at rest
        the force points up and equals the weight that the sensor carries.
        """
        self._mujoco.mj_rnePostConstraint(self._model, self._data)
        self._mujoco.mj_sensorAcc(self._model, self._data)
        wrench: FloatArray = self._data.sensordata.copy()
        return wrench

    def inverse_dynamics(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Efforts ``(n,)`` that a motion takes."""
        data = self._data
        data.qpos[:] = position
        data.qvel[:] = velocity
        data.qacc[:] = acceleration
        self._mujoco.mj_inverse(self._model, data)
        effort: FloatArray = data.qfrc_inverse.copy()
        return effort

    def joint_inertia(self, position: FloatArray) -> FloatArray:
        """Diagonal ``(n,)`` of the joint-space inertia matrix, rotors included [kg m^2 or kg]."""
        self._data.qpos[:] = position
        self._mujoco.mj_forward(self._model, self._data)
        column = np.empty(self._model.nv)
        diagonal = np.empty(self._model.nv)
        for joint, unit in enumerate(np.eye(self._model.nv)):
            self._mujoco.mj_mulM(self._model, self._data, column, unit)
            diagonal[joint] = column[joint]
        return diagonal


def _compiled(mujoco: Any, description: Description, bodies: Iterable[LinkInertia], wrench_frame: str | None) -> Any:
    spec = mujoco.MjSpec.from_string(description.kinematics)
    _configure(mujoco, spec)
    for body in bodies:
        _set_inertia(mujoco, spec.body(body.name), body)
    if wrench_frame is not None:
        _mount_sensor(mujoco, spec, wrench_frame)
    return spec.compile()


def _configure(mujoco: Any, spec: Any) -> None:
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = False
    spec.compiler.boundmass = 0.0
    spec.compiler.boundinertia = 0.0
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.tolerance = 1e-14
    spec.option.timestep = _FRICTION_TIME / 2.0  # the longest with which MuJoCo allows that time; the loop has its own
    for joint in spec.joints:
        joint.solref_friction = [_FRICTION_TIME, 1.0]
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)


def _set_inertia(mujoco: Any, element: Any, body: LinkInertia) -> None:
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    element.mass = body.mass
    element.ipos = body.com
    element.iquat = quaternion
    element.inertia = moments
    element.explicitinertial = True


def _mount_sensor(mujoco: Any, spec: Any, frame: str) -> None:
    spec.body(frame).add_site(name=_SENSOR)
    for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=_SENSOR)


def _check_frame(description: Description, frame: str) -> None:
    carriers = [link for link in description.links if link != description.root]
    if frame not in carriers:
        raise unknown_name("wrench frame", frame, carriers)
