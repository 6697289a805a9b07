"""Where the bodies and joints of an MJCF are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.resimulation.written_robot import load_mujoco
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class BodyFrames:
    """Homogeneous matrices ``(4, 4)`` of ``bodies`` in the world by name, all joints at zero, and their ``masses``
    [kg]; of hinges and slides, ``joints``, a point that they pass through and the direction of their axes, ``(2, 3)``.
    """

    bodies: dict[str, FloatArray]
    masses: dict[str, float]
    joints: dict[str, FloatArray]


def body_frames(path: Path) -> BodyFrames:
    """Read an MJCF. Raises InputError naming the file."""
    mujoco = load_mujoco()
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot read this model ({' '.join(str(error).split())})") from error
    data = mujoco.MjData(model)
    of_one_axis = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
    single = [index for index in range(model.njnt) if model.jnt_type[index] in of_one_axis]
    data.qpos[model.jnt_qposadr[single]] = 0.0
    mujoco.mj_kinematics(model, data)
    bodies = {}
    for index in range(1, model.nbody):
        placed = np.eye(4)
        placed[:3, :3], placed[:3, 3] = data.xmat[index].reshape(3, 3), data.xpos[index]
        bodies[model.body(index).name] = placed
    joints = {model.joint(index).name: np.array([data.xanchor[index], data.xaxis[index]]) for index in single}
    masses = {name: float(model.body(name).mass[0]) for name in bodies}
    return BodyFrames(bodies, masses, joints)
