"""A written description as its reader takes it: the bodies' inertias, and what attributes of joints say."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.models.readers import ELEMENTS
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import EFFECTS, Effect, MotionEffect, Place
from geomid_ros.model.effects.situation import pair_name, place_named
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.model.urdf_tree import read_xml
from geomid_ros.resimulation.written_robot import load_mujoco
from geomid_ros.types import FloatArray

Attributes: TypeAlias = dict[tuple[str, str], float]
"""Numbers of a description by joint and ``ELEMENT/ATTRIBUTE``."""
_PAYLOAD = "/payload"


@dataclass(frozen=True, eq=False)
class ReadBack:
    """What a ``reader`` takes from a description: ``inertias (10,)`` by body, and ``attributes`` of joints."""

    reader: str
    inertias: Mapping[str, FloatArray]
    attributes: Attributes

    def parameters(self, model: MeasurementModel) -> FloatArray:
        """The parameters ``(D,)`` of ``model`` with these inertias and no effects."""
        bodies = [self.inertias[name] for name in model.body_names]
        return np.concatenate([*bodies, np.zeros(len(model.coefficients))])

    def efforts(self, joints: Sequence[str], samples: Samples) -> FloatArray:
        """What the attributes add to the joints' efforts ``(N, joints)``."""
        return samples.efforts_of(self._terms(joints))

    def _terms(self, joints: Sequence[str]) -> Iterator[tuple[MotionEffect, Place, float]]:
        """The effects that the attributes mean, at their places, with their coefficients."""
        taken = set[str]()
        for cls in (each for each in EFFECTS.values() if issubclass(each, MotionEffect)):
            places = {form.name: form.place_in(ELEMENTS[self.reader]) for form in cls.parameters}
            sizes = {places[form.name] for form in cls.variants()[0].own if places[form.name]}
            if not taken & sizes:
                taken |= sizes
                for name in {name for name, at in self.attributes if at in sizes}:
                    values = {key: self.attributes.get((name, place), 0.0) for key, place in places.items()}
                    where = place_named(cls.place, name, joints)
                    yield from _parts(cls, values, where) if where is not None else ()


def _parts(cls: type[Effect], values: Mapping[str, float], place: Place) -> Iterator[tuple[MotionEffect, Place, float]]:
    if any(values.values()):
        for part, (coefficient, *_) in cls.coefficients(values).items():
            if isinstance(part, MotionEffect):
                yield part, place, coefficient


def read_urdf_back(robot: Robot, reader: str, beside: Mapping[str, str] = MappingProxyType({})) -> ReadBack:
    """What a reader takes from the URDF that ``robot`` was read from, by pinocchio, and from the files ``beside``."""
    attributes = {**robot.described_dynamics, **_of_gazebo(robot), **_of_drake(robot)}
    for text in beside.values():
        armatures = {name: own.get("armature", 0.0) for name, own in json.loads(text).items()}
        attributes |= {(name, "joint/armature"): armature for name, armature in armatures.items()}
    return ReadBack(reader, {body.name: body.parameters for body in robot.bodies}, attributes)


def _of_gazebo(robot: Robot) -> Attributes:
    """Numbers in elements of ``<gazebo reference=JOINT>``."""
    elements = read_xml(robot.urdf, robot.source).findall("gazebo")
    named = [(element.get("reference", ""), child) for element in elements for child in element]
    return {(joint, f"gazebo/{child.tag}"): value for joint, child in named if (value := _number(child.text))}


def _of_drake(robot: Robot) -> Attributes:
    """Inertias of rotors, as they are behind their gears, at the actuators of transmissions."""
    found: Attributes = {}
    for transmission in read_xml(robot.urdf, robot.source).findall("transmission"):
        joint, actuator = transmission.find("joint"), transmission.find("actuator")
        said = {_local_name(child): _number(child.get("value")) for child in ([] if actuator is None else actuator)}
        ratio = said.pop("gear_ratio", 0.0) or 1.0
        if joint is not None:
            found |= {(joint.get("name", ""), f"actuator/drake:{name}"): own * ratio**2 for name, own in said.items()}
    return found


def _local_name(element: Element) -> str:
    """An element's name without its namespace."""
    return re.sub(r"^\{.*\}|^.*:", "", str(element.tag))


def _number(text: str | None) -> float:
    """A number, zero for what is none."""
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0


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
