"""A written MJCF as MuJoCo takes it."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.models.read_back import Attributes, ReadBack
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects.places import pair_name
from geomid_ros.model.robot import Robot
from geomid_ros.resimulation.written_robot import load_mujoco
from geomid_ros.types import FloatArray

_PAYLOAD = "/payload"


def read_mjcf_back(text: str, robot: Robot) -> ReadBack:
    """The bodies and joints of an MJCF of ``robot``, as MuJoCo has compiled them.

    Raises:
        InputError: MuJoCo is not installed, or does not take it.
    """
    mujoco = load_mujoco()
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise InputError(f"the written MJCF: MuJoCo does not take it ({error})") from error
    inertias: dict[str, FloatArray] = {}
    for index in range(1, model.nbody):
        name = model.body(index).name.removesuffix(_PAYLOAD)
        inertias[name] = inertias.get(name, np.zeros(10)) + _parameters(mujoco, model, index)
    attributes: Attributes = {}
    for name in robot.joint_names:
        joint = model.joint(name)
        (dof,), (place,) = joint.dofadr, joint.qposadr
        attributes[name, "joint/damping"] = float(model.dof_damping[dof])
        attributes[name, "joint/frictionloss"] = float(model.dof_frictionloss[dof])
        attributes[name, "joint/armature"] = float(model.dof_armature[dof])
        attributes[name, "joint/stiffness"] = float(joint.stiffness[0])
        attributes[name, "joint/springref"] = float(model.qpos_spring[place])
    for index in range(model.ntendon):
        first, second = model.wrap_objid[model.tendon_adr[index] :][:2]
        pair = pair_name(model.joint(first).name, model.joint(second).name)
        attributes[pair, "tendon/coef"] = float(model.wrap_prm[model.tendon_adr[index] + 1])
        for key in ("damping", "frictionloss", "armature"):
            place = pair, f"tendon/{key}"
            attributes[place] = attributes.get(place, 0.0) + float(np.ravel(getattr(model, f"tendon_{key}")[index])[0])
    own = {"world_link": "world"}
    return ReadBack("mujoco", {own.get(name, name): value for name, value in inertias.items()}, attributes)


def _parameters(mujoco: Any, model: Any, index: int) -> FloatArray:
    """Parameters ``(10,)`` of a body about its frame's origin."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[index])
    axes = rotation.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[index]) @ axes.T
    return pseudo_inertia.assemble(model.body_mass[index], model.body_ipos[index], inertia)
