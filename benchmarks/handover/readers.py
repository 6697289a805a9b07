"""The programs that read robot descriptions, each as the efforts that it computes from a file alone.

A reader takes the text of a file, the joints' names and gravity, and returns a function from the motion of N instants,
and the directions in which the joints move, to the efforts ``(N, joints)`` [N m, N]. None of them shares the package's
dynamics. Dry friction counts as its level times the direction of motion: near standstill every simulator has a law of
its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

import mujoco as mj
import numpy as np
import pinocchio as pin

from geomid_ros.model.samples import Samples
from geomid_ros.model.urdf_tree import read_xml
from geomid_ros.types import FloatArray

_SMOOTHING = 0.02  # [rad/s, m/s] over which the dry friction of two joints together changes its sign
Predict: TypeAlias = Callable[[Samples, FloatArray], FloatArray]
Reader: TypeAlias = Callable[[str, Sequence[str], FloatArray], Predict]


def pinocchio(urdf: str, joints: Sequence[str], gravity: FloatArray) -> Predict:
    """Inverse dynamics by pinocchio, and of ``<dynamics>`` damping times the velocity and friction times its sign."""
    model = pin.buildModelFromXML(urdf)
    model.gravity.linear = gravity
    data = model.createData()
    indices = [model.getJointId(name) for name in joints]
    places = [model.joints[index].idx_v for index in indices]
    turning = [model.joints[index].nq == 2 for index in indices]
    positions = [model.joints[index].idx_q for index in indices]
    damping, friction = _dynamics(urdf, joints)

    def predict(samples: Samples, direction: FloatArray) -> FloatArray:
        result = np.empty(samples.effort.shape)
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for index in range(len(samples)):
            for joint, (place, whole) in enumerate(zip(positions, turning, strict=True)):
                angle = samples.position[index, joint]
                q[place : place + 1 + whole] = (np.cos(angle), np.sin(angle)) if whole else angle
            v[places], a[places] = samples.velocity[index], samples.acceleration[index]
            result[index] = pin.rnea(model, data, q, v, a)[places]
        return result + damping * samples.velocity + friction * direction

    return predict


def sdformat(urdf: str, joints: Sequence[str], gravity: FloatArray) -> Predict:
    """What SDFormat makes of a URDF for Gazebo: the same, and the springs of its ``<gazebo>`` elements."""
    inner = pinocchio(urdf, joints, gravity)
    elements = {each.get("reference"): each for each in read_xml(urdf, "written file").findall("gazebo")}
    stiffness, rest = (
        np.array([_number(elements.get(name), kind) for name in joints])
        for kind in ("springStiffness", "springReference")
    )
    return lambda samples, direction: inner(samples, direction) + stiffness * (samples.position - rest)


def mujoco(text: str, joints: Sequence[str], gravity: FloatArray) -> Predict:
    """Inverse dynamics by MuJoCo of an MJCF or a URDF, its own damping, dry friction, armature and springs included."""
    if "<robot" in text:
        text = re.sub(
            r"(<robot\b[^>]*>)",
            r'\1<mujoco><compiler balanceinertia="false" discardvisual="true" strippath="false"/></mujoco>',
            text,
            count=1,
        )
    model = mj.MjModel.from_xml_string(text)
    if "<robot" in text:  # a URDF says nothing of gravity
        model.opt.gravity = gravity
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_CONTACT | mj.mjtDisableBit.mjDSBL_LIMIT
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_FRICTIONLOSS
    data = mj.MjData(model)
    ids = [model.joint(name).id for name in joints]
    qs, vs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]

    def predict(samples: Samples, direction: FloatArray) -> FloatArray:
        result = np.empty(samples.effort.shape)
        for index in range(len(samples)):
            data.qpos[qs], data.qvel[vs], data.qacc[vs] = (
                samples.position[index],
                samples.velocity[index],
                samples.acceleration[index],
            )
            mj.mj_inverse(model, data)
            result[index] = (data.qfrc_inverse + _along_tendons(model, data))[vs]
        return result + model.dof_frictionloss[vs] * direction

    return predict


def _along_tendons(model: Any, data: Any) -> FloatArray:
    """Dry friction ``(nv,)`` of what acts on two joints together, by the velocities of tendons."""
    along = model.tendon_frictionloss * np.tanh(data.ten_velocity / _SMOOTHING)
    lever = np.zeros((model.ntendon, model.nv))
    for tendon in range(model.ntendon):
        for wrap in range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon]):
            lever[tendon, model.jnt_dofadr[model.wrap_objid[wrap]]] = model.wrap_prm[wrap]
    return np.asarray(along @ lever)


def drake(urdf: str, joints: Sequence[str], gravity: FloatArray) -> Predict:
    """Inverse dynamics by Drake, with the damping and the rotors' inertias that it reads; it reads no friction."""
    from pydrake.multibody.parsing import Parser  # noqa: PLC0415 seldom installed
    from pydrake.multibody.plant import MultibodyPlant  # noqa: PLC0415
    from pydrake.multibody.tree import MultibodyForces  # noqa: PLC0415

    plant = MultibodyPlant(0.0)
    (robot,) = Parser(plant).AddModelsFromString(urdf, "urdf")
    if (root := _root(urdf)) != "world":
        plant.WeldFrames(plant.world_frame(), plant.GetBodyByName(root, robot).body_frame())
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    context, forces = plant.CreateDefaultContext(), MultibodyForces(plant)
    qs, vs = (
        [getattr(plant.GetJointByName(name), place)() for name in joints]
        for place in ("position_start", "velocity_start")
    )

    def predict(samples: Samples, _: FloatArray) -> FloatArray:
        result = np.empty(samples.effort.shape)
        q, v, a = np.zeros(plant.num_positions()), np.zeros(plant.num_velocities()), np.zeros(plant.num_velocities())
        for index in range(len(samples)):
            q[qs], v[vs], a[vs] = samples.position[index], samples.velocity[index], samples.acceleration[index]
            plant.SetPositions(context, q)
            plant.SetVelocities(context, v)
            plant.CalcForceElementsContribution(context, forces)
            result[index] = plant.CalcInverseDynamics(context, a, forces)[vs]
        return result

    return predict


READERS: Mapping[str, tuple[tuple[str, Reader], ...]] = {
    "urdf": (("pinocchio", pinocchio), ("mujoco", mujoco)),
    "mujoco": (("mujoco", mujoco),),
    "gazebo": (("sdformat", sdformat),),
    "drake": (("drake", drake),),
}
"""By format, the programs that read it."""


def installed(reader: str) -> bool:
    """Whether a reader's library is there."""
    return reader != "drake" or find_spec("pydrake") is not None


def _dynamics(urdf: str, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    found = {joint.get("name"): joint.find("dynamics") for joint in read_xml(urdf, "written file").findall("joint")}
    damping, friction = (
        np.array([float(own.get(name, 0.0)) if (own := found.get(joint)) is not None else 0.0 for joint in joints])
        for name in ("damping", "friction")
    )
    return damping, friction


def _number(element: Element | None, name: str) -> float:
    text = None if element is None else element.findtext(name)
    return float(text) if text else 0.0


def _root(urdf: str) -> str:
    robot = read_xml(urdf, "written file")
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}  # type: ignore[union-attr]
    return next(name for link in robot.findall("link") if (name := link.get("name", "")) not in children)
