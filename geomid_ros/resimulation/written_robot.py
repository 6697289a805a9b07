"""Robot in MuJoCo from its written MJCF and sidecar, and the frames of its bodies and joints."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.files.models.effects_file import read_sidecar
from geomid_ros.files.models.written_model import ModelFiles
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import Effect, Motion, Place, SensorEffect, Values, joints_of
from geomid_ros.model.effects.situation import place_named
from geomid_ros.model.samples import SMOOTH_SIGN, Samples
from geomid_ros.types import BoolArray, FloatArray, IntArray

_IMMOVABLE = 1e7  # [kg m^2, kg] inertia of a joint that follows its measured motion under any load


class WrittenRobot:
    """Compiled ``model`` with a fixed base. Arrays ``(..., J)`` follow ``joints``, the measured ones.

    ``dofs (J,)`` are the joints' indices in MuJoCo's qpos and qvel, which are alike; ``gears`` has the names of the
    hinges behind the joints (see :mod:`geomid_ros.files.models.mjcf`), by index.
    """

    def __init__(self, files: ModelFiles, joints: Sequence[str]) -> None:
        """Read the files. Raises InputError naming the file."""
        self.joints = tuple(joints)
        self.mujoco = load_mujoco()
        self.model = _compiled(files.mjcf)
        if self.model.nq != self.model.njnt:
            raise InputError(
                f"{files.mjcf}: has joints of several axes, or a floating base, which cannot be resimulated"
            )
        names = {self.model.joint(index).name: index for index in range(self.model.njnt)}
        for joint in joints:
            if joint not in names:
                raise InputError(f"{files.mjcf}: {unknown_name('joint', joint, names)}")
        self.dofs: IntArray = np.array([names[joint] for joint in joints], dtype=np.int64)
        self.gears = {names[name]: name for name in names if name.rpartition("/")[0] in joints}
        # A joint that was locked stays where it is; one that mimics another follows it.
        locked = {*names.values()}.difference(self.dofs.tolist(), self.gears, self.model.eq_obj1id.tolist())
        self.model.dof_armature[sorted(locked)] = _IMMOVABLE
        self._read_effects(files)
        # Friction of a joint at rest; its change with motion is in sidecar_friction.
        self.model.dof_frictionloss[self.dofs] += self._rest_friction
        # Forces of the stops at a range's ends are not measured; the stops of a backlash stay.
        self.model.jnt_limited[self.dofs] = 0
        self.model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_AUTORESET

    def _read_effects(self, files: ModelFiles) -> None:
        """Read the effects that the MJCF lacks: of effort sensors, friction and wrench sensors."""
        count = len(self.joints)
        self.gain, self.offset, self.delay = np.ones(count), np.zeros(count), 0.0
        self._rest_friction, self._load_friction, self._mean_load = np.zeros(count), np.zeros(count), np.zeros(count)
        self._motion_effects: list[tuple[Effect, Place, Values]] = []
        self._sensor_effects: dict[str, list[tuple[SensorEffect, Values]]] = {}
        for entry in read_sidecar(files.effects):
            values = entry.values
            effect = entry.cls.from_values(values)
            if isinstance(effect, SensorEffect):
                self._sensor_effects.setdefault(entry.joint, []).append((effect, values))
            elif effect.place != "link":
                place = place_named(effect.place, entry.joint, self.joints)
                if place is None:
                    raise InputError(f"{files.effects}: {unknown_name('joint', entry.joint, self.joints)}")
                self.delay += effect.effort_lag(values)
                for joint in joints_of(place):
                    self.gain[joint] *= effect.effort_scale(values)
                    self.offset[joint] += effect.effort_shift(values)
                    self._rest_friction[joint] += effect.holding_friction(values)
                    self._load_friction[joint] += effect.friction_by_load(values)
                self._motion_effects.append((effect, place, values))

    @property
    def step(self) -> float:
        """Time step of the MJCF [s]."""
        return float(self.model.opt.timestep)

    def prescribe(self, joints: BoolArray) -> None:
        """Make these ``joints (J,)`` follow their measured motion: :meth:`driving_effort` accelerates them as
        measured."""
        self.model.dof_armature[self.dofs[joints]] = _IMMOVABLE
        self.mujoco.mj_setConst(self.model, self.mujoco.MjData(self.model))

    def in_closed_loop(self, stiffness: FloatArray, damping: FloatArray, controlled: BoolArray) -> WrittenRobot:
        """Return a copy with a controller's springs and dampers ``(J,)`` at the joints, with set-points at zero. Joints
        that are not ``controlled`` follow their measured motion."""
        robot = copy(self)
        robot.model, dofs = copy(self.model), self.dofs
        model = robot.model
        total = model.jnt_stiffness[dofs] + stiffness
        torque = model.jnt_stiffness[dofs] * model.qpos_spring[dofs]
        model.qpos_spring[dofs] = np.divide(torque, total, out=np.zeros(len(dofs)), where=total != 0.0)
        model.jnt_stiffness[dofs] = total
        model.dof_damping[dofs] += damping
        model.dof_armature[dofs[~controlled]] = _IMMOVABLE
        return robot

    def set_mean_load(self, true_effort: FloatArray) -> None:
        """Set the load friction of a joint at rest to that of its mean load in ``true_effort (N, J)``. Deviations of
        the momentary load are in :meth:`sidecar_friction`."""
        self._mean_load = np.nan_to_num(np.mean(np.abs(true_effort), axis=0))
        self.model.dof_frictionloss[self.dofs] += self._load_friction * self._mean_load

    @property
    def prescribed(self) -> BoolArray:
        """True for each joint that follows its measured motion ``(J,)``."""
        return np.asarray(self.model.dof_armature[self.dofs] == _IMMOVABLE)

    @staticmethod
    def prescribed_effort(acceleration: FloatArray) -> FloatArray:
        """Efforts that accelerate joints which follow their measured motion."""
        return _IMMOVABLE * acceleration

    def driving_effort(self, true_effort: FloatArray, motion: Motion) -> FloatArray:
        """Efforts ``(..., J)`` that drive the joints in MuJoCo: the motors' true efforts minus the friction in this
        motion that the MJCF lacks, ``(..., J)`` each."""
        friction = self.sidecar_friction(true_effort, motion)
        prescribed = self.prescribed
        return np.where(prescribed, self.prescribed_effort(motion.acceleration), true_effort - friction)

    def sidecar_friction(self, true_effort: FloatArray, motion: Motion) -> FloatArray:
        """Friction ``(..., J)`` that only the sidecar contains: the decrease of Stribeck friction with speed, the
        friction by load, and other functions of the motion.

        Let u be the motor's effort minus all other friction, the spring and the rotor's inertia. A gear that transmits
        tau to the links has ``u = tau + c |tau| s`` with the direction of motion s.
        """
        velocity = motion.velocity
        sign = SMOOTH_SIGN.values(motion)
        by_motion = np.zeros(velocity.shape)
        for effect, place, values in self._motion_effects:
            by_motion += effect.efforts_not_in_mjcf(values, motion, place)
        model, dofs = self.model, self.dofs
        dry = model.dof_frictionloss[dofs] - self._load_friction * self._mean_load
        spring = model.jnt_stiffness[dofs] * (motion.position - model.qpos_spring[dofs])
        other = model.dof_damping[dofs] * velocity + dry * sign + spring + by_motion
        arriving = true_effort - other - np.where(self.prescribed, 0.0, model.dof_armature[dofs]) * motion.acceleration
        along = np.sign(arriving) * sign
        transmitted = np.abs(arriving) / (1.0 + self._load_friction * along)
        return np.asarray(by_motion + self._load_friction * (transmitted - self._mean_load) * sign)

    def true_effort(self, measured: FloatArray) -> FloatArray:
        """True efforts of the motors where the effort sensors show ``measured (..., J)``, without the delay."""
        return measured / self.gain - self.offset

    def measured_effort(self, true: FloatArray) -> FloatArray:
        """Readings of the effort sensors where the motors supply ``true (..., J)``, without the delay."""
        return self.gain * (true + self.offset)

    def wrench(self, sensed: FloatArray, sensor: WrenchSensor) -> FloatArray:
        """True wrench ``(..., 6)`` at a mounted sensor, from all ``sensed (..., values)``. It corresponds to the
        reported wrench times the sensor's sign."""
        force, torque = (self.model.sensor(f"{sensor.topic}/{kind}").adr[0] for kind in ("force", "torque"))
        return np.concatenate([sensed[..., force : force + 3], sensed[..., torque : torque + 3]], axis=-1)

    def wrench_error(self, motion: Motion, sensor: WrenchSensor) -> FloatArray:
        """Error of a mounted sensor's wrench in a motion of N samples ``(N, axes)``."""
        error = np.zeros((len(motion.position), len(sensor.axes)))
        for effect, values in self._sensor_effects.get(sensor.topic, ()):
            coefficients = np.array([values.get(axis, 0.0) for axis in sensor.axes])
            error += effect.columns(motion, sensor.axes) @ coefficients
        return error

    def gear_deflections(self, samples: Samples) -> FloatArray:
        """Deflections ``(N, gears)`` of the hinges of ``gears`` while the joints move, without vibration: under the
        efforts that they would transmit if they were rigid."""
        gears, data = list(self.gears), self.mujoco.MjData(self.model)
        efforts = np.zeros((len(samples), len(gears)))
        for index in range(len(samples)):
            data.qpos[self.dofs] = samples.position[index]
            data.qvel[self.dofs] = samples.velocity[index]
            data.qacc[self.dofs] = samples.acceleration[index]
            self.mujoco.mj_inverse(self.model, data)
            efforts[index] = data.qfrc_inverse[gears]
        elastic = self.model.jnt_stiffness[gears] > 0.0
        stiffness = np.where(elastic, self.model.jnt_stiffness[gears], 1.0)
        play = np.where(elastic, 0.0, self.model.jnt_range[gears, 1])
        return np.where(elastic, -efforts / stiffness, -play * np.sign(efforts))

    def rollout(
        self, position: FloatArray, velocity: FloatArray, efforts: FloatArray, step: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Integrate W runs in steps of ``step`` [s] from states, ``position, velocity (W, nv)`` in MuJoCo's order,
        under ``efforts (W, steps, J)`` of the joints.

        Returns:
            Positions and velocities of the joints ``(W, steps, J)`` after each step, and the sensor readings before
            it ``(W, steps, values)``.
        """
        model, mujoco = self.model, self.mujoco
        applied = np.zeros((*efforts.shape[:2], model.nv))
        applied[:, :, self.dofs] = efforts
        written, model.opt.timestep = model.opt.timestep, step
        try:
            states, sensed = importlib.import_module("mujoco.rollout").rollout(
                model,
                [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)],
                np.hstack([np.zeros((len(position), 1)), position, velocity]),
                applied,
                control_spec=mujoco.mjtState.mjSTATE_QFRC_APPLIED,
                persistent_pool=True,
            )
        finally:
            model.opt.timestep = written
        return states[:, :, 1 + self.dofs], states[:, :, 1 + model.nq + self.dofs], sensed


FLOATING_BASE_REASON = "floating base: its motion cannot be simulated without its contacts"
"""Reason why a robot with a floating base is not simulated."""


def loaded_robots(files: Sequence[ModelFiles], joints: Sequence[str], measured: FloatArray) -> list[WrittenRobot]:
    """Load robots from ``files``, with friction by the load of ``measured`` efforts ``(N, J)``. Raises InputError."""
    robots = [WrittenRobot(model_files, joints) for model_files in files]
    for robot in robots:
        robot.set_mean_load(robot.true_effort(measured))
    return robots


def _compiled(path: Path, text: str | None = None) -> Any:
    """Compile the model in an MJCF, or another ``text`` in its place. Raises InputError naming the file."""
    try:
        return load_mujoco().MjModel.from_xml_path(str(path), {} if text is None else {str(path): text.encode()})
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot read this model ({' '.join(str(error).split())})") from error


def load_mujoco() -> Any:
    """Import MuJoCo on first use. Raises InputError if it does not import."""
    try:
        mujoco = importlib.import_module("mujoco")
    except ImportError as error:
        raise InputError(f"MuJoCo is needed but cannot be imported ({error}): pip install mujoco") from error
    # By default MuJoCo prints warnings of runs that diverge, and writes a MUJOCO_LOG.TXT to the user's folder. Their
    # errors show it better.
    mujoco.set_mju_user_warning(lambda _: None)
    return mujoco


@dataclass(frozen=True, eq=False)
class CompiledMjcf:
    """An MJCF as MuJoCo has compiled it.

    Attributes:
        bodies: homogeneous matrices ``(4, 4)`` of bodies in the world by name, with all joints at zero.
        moving: masses [kg] of those that move, by name.
        parents: names of the bodies that they are children of.
        axes: of hinges and slides by name, a point on the axis and its direction ``(2, 3)``.
        attributes: of hinges and slides by name, values by attribute.
        gravity: ``(3,)`` in the world [m/s^2].
    """

    bodies: dict[str, FloatArray]
    moving: dict[str, float]
    parents: dict[str, str]
    axes: dict[str, FloatArray]
    attributes: dict[str, dict[str, float]]
    gravity: FloatArray


def compile_mjcf(path: Path, text: str | None = None) -> CompiledMjcf:
    """Compile an MJCF file, or another ``text`` in its place. Raises InputError naming the file."""
    mujoco, model = load_mujoco(), _compiled(path, text)
    data = mujoco.MjData(model)
    single_axis = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
    indices = [index for index in range(model.njnt) if model.jnt_type[index] in single_axis]
    data.qpos[model.jnt_qposadr[indices]] = 0.0
    mujoco.mj_kinematics(model, data)
    bodies = {
        model.body(index).name: pseudo_inertia.change_of_frame(data.xmat[index].reshape(3, 3), data.xpos[index])
        for index in range(1, model.nbody)
    }
    named = [model.body(index) for index in range(1, model.nbody)]
    names = {index: model.joint(index).name for index in indices}
    weightless = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return CompiledMjcf(
        bodies=bodies,
        moving={body.name: float(body.mass[0]) for body in named if model.body_weldid[body.id]},
        parents={body.name: model.body(body.parentid[0]).name for body in named},
        axes={name: np.array([data.xanchor[index], data.xaxis[index]]) for index, name in names.items()},
        attributes={name: joint_attributes(model, name) for name in names.values()},
        gravity=np.zeros(3) if weightless else model.opt.gravity.copy(),
    )


def body_inertias(model: Any) -> dict[str, FloatArray]:
    """Parameters ``(10,)`` of the bodies of a compiled model about the origins of their frames, by name."""
    inertias = {}
    for index in range(1, model.nbody):
        rotation = np.zeros(9)
        load_mujoco().mju_quat2Mat(rotation, model.body_iquat[index])
        axes = rotation.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[index]) @ axes.T
        parameters = pseudo_inertia.assemble(model.body_mass[index], model.body_ipos[index], inertia)
        inertias[model.body(index).name] = parameters
    return inertias


def joint_attributes(model: Any, name: str) -> dict[str, float]:
    """Values of a hinge or slide of a compiled model by attribute."""
    joint = model.joint(name)
    (dof,), (place,) = joint.dofadr, joint.qposadr
    return {
        "damping": float(np.ravel(model.dof_damping[dof])[0]),
        "frictionloss": float(model.dof_frictionloss[dof]),
        "armature": float(model.dof_armature[dof]),
        "stiffness": float(np.ravel(joint.stiffness)[0]),
        "springref": float(model.qpos_spring[place]),
    }
