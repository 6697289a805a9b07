"""A robot as a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.simulation.description import Description, LinkInertia
from geomid_ros.simulation.effects.effect import TrueEffect
from geomid_ros.simulation.effects.structure import STRUCTURE
from geomid_ros.simulation.inertias import set_inertia

GRAVITY = 9.81
"""Downwards along the world's z [m/s^2]."""

# MuJoCo's dry friction is a soft constraint: constant while a joint moves, but near standstill it only damps, below a
# speed of about this time [s] times the deceleration that friction alone would cause. MuJoCo's default, 0.02, is soft.
_FRICTION_TIME = 0.004
_SENSOR = "wrench"


def compiled(
    mujoco: Any,
    description: Description,
    bodies: Iterable[LinkInertia],
    effects: Iterable[TrueEffect],
    wrench_frame: str | None,
) -> Any:
    """An MjModel with the kinematics of ``description``, the inertias of ``bodies`` and what ``effects`` add to them.

    It has an actuator at each of the description's joints, in their order, and with ``wrench_frame`` a sensor there.
    """
    if wrench_frame is not None:
        _check_frame(description, wrench_frame)
    try:
        spec = mujoco.MjSpec.from_string(description.kinematics)
        _configure(mujoco, spec)
        for body in bodies:
            set_inertia(mujoco, spec.body(body.name), body)
        if wrench_frame is not None:
            _mount_sensor(mujoco, spec, wrench_frame)
        for effect in effects:
            if effect.name in STRUCTURE:
                STRUCTURE[effect.name](mujoco, spec, effect)
        return spec.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo cannot build this robot: {error}. Correct its URDF.") from error


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


def _mount_sensor(mujoco: Any, spec: Any, frame: str) -> None:
    spec.body(frame).add_site(name=_SENSOR)
    for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=_SENSOR)


def _check_frame(description: Description, frame: str) -> None:
    carriers = [link for link in description.links if link != description.root]
    if frame not in carriers:
        raise unknown_name("wrench frame", frame, carriers)
