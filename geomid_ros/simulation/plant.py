"""Simulated robot, compiled by MuJoCo: rigid bodies, joints and sensors."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from geomid_ros.errors import refusing, unknown_name
from geomid_ros.simulation.description import Description, LinkInertia, set_inertia
from geomid_ros.simulation.effects import (
    FORCES,
    FRICTION,
    MODEL,
    STRUCTURE,
    Places,
    TrueEffect,
    added_friction,
    is_by_load,
    play_name,
    wind_up,
)
from geomid_ros.simulation.options import GEARS
from geomid_ros.types import FloatArray, IntArray


def load_mujoco() -> Any:
    """Import MuJoCo on first use. Raises InputError if it does not import."""
    with refusing("simulating needs MuJoCo, which does not import", ImportError, advice="pip install mujoco"):
        return importlib.import_module("mujoco")


_WINDINGS = 10  # iterations; each leaves a few per cent of the previous error of the gears' deflection at rest


class Simulator(ABC):
    """Simulated robot with a fixed base, hinges and slides, driven by joint efforts, without collisions.

    ``joints`` are its n motors. States ``(m,)`` have the motors at the indices ``driven (n,)``, and also the hinges
    that gears with play or elasticity add. ``names`` are those of all m, see :func:`play_name`.
    """

    def __init__(self, names: Sequence[str], motors: Iterable[str], effects: Iterable[TrueEffect]) -> None:
        motors, index = set(motors), {name: i for i, name in enumerate(names)}
        self.joints = tuple(name for name in names if name in motors)
        self.driven: IntArray = np.array([index[name] for name in self.joints])
        places = [
            (effect, Places(*(index.get(name, -1) for name in (effect.joint, effect.other, play_name(effect.joint)))))
            for effect in effects
        ]
        frictions = [(effect, at.joint) for effect, at in places if effect.name in FRICTION]
        self._frictions = sorted(frictions, key=lambda friction: is_by_load(friction[0]))
        self._viscous = {at.joint: e.parameters["coefficient"] for e, at in places if e.name == "viscous_friction"}
        self._forces = [(effect, at) for effect, at in places if effect.name in FORCES]
        self._gears = [(effect, at) for effect, at in places if effect.name in GEARS]
        self._places = places

    def at_rest(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """State at rest, positions and velocities ``(m,)``, with the motors fixed at ``position (n,)``."""
        size = len(self.driven) + len({at.play for _, at in self._gears})
        state, rest = np.zeros(size), np.zeros(size)
        state[self.driven] = position
        for _ in range(_WINDINGS if self._gears else 0):
            load = self.inverse_dynamics(state, rest, rest)
            for effect, at in self._gears:
                state[at.play] = -wind_up(effect.parameters, float(load[at.joint]))
        return state, rest

    def _friction_levels(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> FloatArray:
        """Magnitude of dry friction ``(m,)`` at a state under the motors' ``effort (n,)``."""
        levels = np.zeros(len(position))
        motors = self.driven.tolist()
        for effect, at in self._frictions:
            state = float(position[at]), float(velocity[at]), float(effort[motors.index(at)])
            levels[at] += added_friction(effect, *state, level=levels[at], viscous=self._viscous.get(at, 0.0))
        return levels

    def _needed(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Efforts ``(m,)`` that the motors need against forces that depend on the state."""
        needed = np.zeros(len(position))
        positions, velocities = position.tolist(), velocity.tolist()
        for effect, at in self._forces:
            FORCES[effect.name](effect.parameters, at, positions, velocities, needed)
        return needed

    @abstractmethod
    def acceleration(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> FloatArray:
        """Accelerations ``(m,)`` of a state under commanded ``effort (n,)``, clipped to the joints' limits."""

    @abstractmethod
    def effort(self) -> FloatArray:
        """Efforts of the motors ``(n,)`` at the state last given to :meth:`acceleration`."""

    @abstractmethod
    def wrench(self) -> FloatArray:
        """Force [N] and torque [N m] ``(6,)`` at the state last given to :meth:`acceleration`; ``(0,)`` without sensor.

        It is what the side of the base applies to the far side, about the sensor frame's origin in its axes: at rest
        the force points up and equals the weight that the sensor supports.
        """

    @abstractmethod
    def inverse_dynamics(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Efforts ``(m,)`` for the motion of a state, without dry friction."""

    @abstractmethod
    def inertia_matrix(self, position: FloatArray) -> FloatArray:
        """Joint-space inertia matrix ``(m, m)`` of a state, including rotors [kg m^2 or kg]."""


class Plant(Simulator):
    """Robot in MuJoCo, with MuJoCo's order of joints.

    Constant properties of a joint are MuJoCo's ``damping``, ``armature``, ``stiffness`` and ``actuatorfrcrange``; dry
    friction is its ``frictionloss``, set at every state; other efforts are applied.
    """

    def __init__(
        self,
        description: Description,
        bodies: Iterable[LinkInertia],
        effects: Iterable[TrueEffect] = (),
        wrench_frame: str | None = None,
    ) -> None:
        effects = tuple(effects)
        self._mujoco = load_mujoco()
        self._model = compile_model(self._mujoco, description, bodies, effects, wrench_frame)
        self._data = data = self._mujoco.MjData(self._model)
        # Looked up once, because a run computes a hundred thousand accelerations.
        self._state, self._accelerations = (data.qpos, data.qvel, data.ctrl), data.qacc
        self._forward_skip, self._from_the_start = self._mujoco.mj_forwardSkip, int(self._mujoco.mjtStage.mjSTAGE_NONE)
        names = [self._model.joint(index).name for index in range(self._model.njnt)]
        super().__init__(names, (joint.name for joint in description.joints), effects)
        for effect, places in self._places:
            if effect.name in MODEL:
                MODEL[effect.name](self._model, places, effect.parameters)
        self._mujoco.mj_setConst(self._model, self._data)

    def acceleration(
        self, position: FloatArray, velocity: FloatArray, effort: FloatArray, added: FloatArray | float = 0.0
    ) -> FloatArray:
        """Accelerations with efforts ``added (m,)`` at the hinges, which the motors do not sense."""
        self._model.dof_frictionloss[:] = self._friction_levels(position, velocity, effort)
        self._data.qfrc_applied[:] = added - self._needed(position, velocity)
        positions, velocities, efforts = self._state
        positions[:] = position
        velocities[:] = velocity
        efforts[:] = effort
        self._forward_skip(self._model, self._data, self._from_the_start, 1)
        return np.array(self._accelerations)

    def effort(self) -> FloatArray:
        return np.asarray(self._data.qfrc_actuator[self.driven])

    def wrench(self) -> FloatArray:
        self._mujoco.mj_rnePostConstraint(self._model, self._data)
        self._mujoco.mj_sensorAcc(self._model, self._data)
        return np.array(self._data.sensordata)

    def inverse_dynamics(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        data = self._data
        data.qpos[:] = position
        data.qvel[:] = velocity
        data.qacc[:] = acceleration
        self._model.dof_frictionloss[:] = 0.0
        self._mujoco.mj_inverse(self._model, data)
        return np.asarray(data.qfrc_inverse + self._needed(position, velocity))

    def inertia_matrix(self, position: FloatArray) -> FloatArray:
        self._data.qpos[:] = position
        self._mujoco.mj_forward(self._model, self._data)
        rows = np.empty((self._model.nv, self._model.nv))
        for row, unit in zip(rows, np.eye(self._model.nv), strict=True):
            self._mujoco.mj_mulM(self._model, self._data, row, unit)
        return rows


GRAVITY = 9.81
"""Downwards along the world's z [m/s^2]."""

# MuJoCo's dry friction is a soft constraint: constant while a joint moves, but near standstill it only damps, below a
# speed of about this time [s] times the deceleration that friction alone would cause. MuJoCo's default, 0.02, is soft.
_FRICTION_TIME = 0.004
_SENSOR = "wrench"


def compile_model(
    mujoco: Any,
    description: Description,
    bodies: Iterable[LinkInertia],
    effects: Iterable[TrueEffect],
    wrench_frame: str | None,
) -> Any:
    """Compile an MjModel with the kinematics of ``description``, the inertias of ``bodies`` and parts for ``effects``.

    It has an actuator at each of the description's joints, in their order, and a sensor at ``wrench_frame``, if any.
    """
    links = [name for name in description.links if name != description.root]
    if wrench_frame is not None and wrench_frame not in links:
        raise unknown_name("wrench frame", wrench_frame, links)
    with buildable():
        spec = rigid_bodies(mujoco, description, bodies)
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        spec.option.tolerance = 1e-14
        spec.option.timestep = _FRICTION_TIME / 2.0  # the longest that MuJoCo allows for it; the loop has another step
        for joint in spec.joints:
            spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)
        if wrench_frame is not None:
            spec.body(wrench_frame).add_site(name=_SENSOR)
            for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
                spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=_SENSOR)
        for effect in effects:
            if effect.name in STRUCTURE:
                STRUCTURE[effect.name](mujoco, spec, effect)
        return spec.compile()


def buildable() -> AbstractContextManager[None]:
    """Raise InputError if MuJoCo refuses to build a robot in the block."""
    return refusing("MuJoCo cannot build this robot", ValueError, advice="correct its URDF")


def rigid_bodies(mujoco: Any, description: Description, bodies: Iterable[LinkInertia]) -> Any:
    """MjSpec with the kinematics of ``description`` and the inertias of ``bodies``, to be completed and compiled."""
    spec = mujoco.MjSpec.from_string(description.kinematics)
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = False
    spec.compiler.boundmass = 0.0
    spec.compiler.boundinertia = 0.0
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    for joint in spec.joints:
        joint.solref_friction = [_FRICTION_TIME, 1.0]
    for body in bodies:
        set_inertia(mujoco, spec.body(body.name), body)
    return spec
