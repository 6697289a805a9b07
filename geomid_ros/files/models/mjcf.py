"""MJCF of an identified robot with its effects, as far as MJCF can say them; or their numbers in an MJCF of a user.

Kinematics are the URDF's. Gravity, damping, dry friction, armature and springs are MuJoCo's own elements; a payload
is a body fixed to its link. A joint that gives, by elasticity or backlash, has a further hinge (or
slide) named ``JOINT/elasticity`` or ``JOINT/backlash`` on the same axis behind its own, which is the motor's: the one
that is measured and driven.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.models.effects_file import is_body, joint_attributes, payload_parameters, turned_gravity
from geomid_ros.files.models.urdf import JointFrame, joint_frames
from geomid_ros.files.models.xml_edits import Edit, descendants_of, edited, insertion, with_attributes
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import EFFECTS, Hinge, KnownEffect, joints_of, values_of
from geomid_ros.model.effects.situation import place_named
from geomid_ros.model.robot import Robot
from geomid_ros.model.se3 import quaternion
from geomid_ros.model.urdf_tree import origin_of, read_numbers, read_xml
from geomid_ros.types import FloatArray

_READ_BY_MUJOCO = (".stl", ".obj", ".msh")
# Shapes to be seen touch nothing. Those to touch do not touch one another: a URDF does not say which ones may.
_KINDS = {
    "visual": {"contype": "0", "conaffinity": "0", "group": "2"},
    "collision": {"contype": "1", "conaffinity": "0", "group": "3"},
}


@dataclass(frozen=True, eq=False)
class Shapes:
    """The ``geoms`` of links by name, the ``assets`` that these need, and sentences on what is ``missing``."""

    geoms: dict[str, list[Element]] = field(default_factory=dict)
    assets: list[Element] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


def mjcf_shapes(urdf: str, source: str, find: Callable[[str, str], Path]) -> Shapes:
    """The shapes of a URDF's links.

    Args:
        urdf: its text.
        source: names it in messages.
        find: the file of a mesh's URI, or an InputError that begins with its second argument.
    """
    found = Shapes()
    meshes: dict[tuple[str, str], str] = {}
    for link in read_xml(urdf, source).findall("link"):
        name = link.get("name", "")
        for kind, attributes in _KINDS.items():
            for element in link.findall(kind):
                where = f"{source}: link '{name}'"
                try:
                    geom = Element("geom", attributes | _placement(element, where) | _shape(element, where))
                    mesh = element.find("geometry/mesh")
                    if mesh is not None:
                        geom.set("mesh", _asset(found, meshes, mesh, where, find))
                except InputError as error:
                    found.missing.append(str(error))
                else:
                    found.geoms.setdefault(name, []).append(geom)
    return found


def _placement(element: Element, where: str) -> dict[str, str]:
    position, axes = origin_of(element, where)
    return {"pos": words(position), "quat": words(np.roll(quaternion(axes), 1))}


def _shape(element: Element, where: str) -> dict[str, str]:
    geometry = element.find("geometry")
    if geometry is None or len(geometry) == 0:
        raise InputError(f"{where}: a shape has no geometry")
    tag = geometry[0].tag
    if tag == "box":
        sizes = [0.5 * size for size in read_numbers(geometry, tag, ("size",), [0.0] * 3, where)]
    elif tag == "sphere":
        sizes = read_numbers(geometry, tag, ("radius",), None, where)
    elif tag in ("cylinder", "capsule"):
        radius, length = read_numbers(geometry, tag, ("radius", "length"), None, where)
        sizes = [radius, 0.5 * length]
    elif tag == "mesh":
        return {"type": "mesh"}
    else:
        raise InputError(f"{where}: MuJoCo has no shape <{tag}>")
    return {"type": tag, "size": words(sizes)}


def _asset(
    found: Shapes, meshes: dict[tuple[str, str], str], mesh: Element, where: str, find: Callable[[str, str], Path]
) -> str:
    """The name of a mesh among the assets, to which it is added once."""
    path, scale = find(mesh.get("filename", ""), where), mesh.get("scale", "1 1 1")
    if path.suffix.lower() not in _READ_BY_MUJOCO:
        raise InputError(f"{where}: MuJoCo reads no {path.suffix} ({path.name})")
    key = str(path.resolve()), scale
    if key not in meshes:
        meshes[key] = f"{path.stem}_{len(meshes)}"
        found.assets.append(Element("mesh", name=meshes[key], file=key[0], scale=scale))
    return meshes[key]


def words(numbers: FloatArray | Sequence[float] | float) -> str:
    """Numbers to the last bit."""
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


LONGEST_STEP = 1e-3  # [s]
_STEPS_PER_RADIAN = 4.0  # of the fastest oscillation of an elastic joint
# MuJoCo's dry friction, and the ends of a backlash, are constraints that act within this many steps, the fewest that
# it allows: until a joint almost stands still, friction is then what it should be. Harder ones make a light rotor
# rattle in its backlash.
_CONSTRAINT_STEPS = 2.0
# Where a second hinge needs an inertia before it and none is known: a share of the inertia behind it.
_SMALL_ROTOR = 0.01
_MASSLESS = 1e-12  # [kg, kg m^2] MuJoCo wants everything that moves to have a mass


def mjcf(
    robot: Robot,
    inertias: Mapping[str, FloatArray],
    effects: Iterable[KnownEffect] = (),
    sensors: Sequence[WrenchSensor] = (),
    gravity: FloatArray | None = None,
    shapes: Shapes | None = None,
) -> str:
    """The MJCF of ``robot``, its moving bodies with ``inertias (10,)`` by name, or the URDF's where none is given.

    Dry friction and damping in the URDF count for nothing: friction is among the ``effects`` or
    there is none. ``gravity (3,)`` [m/s^2] is that of a base which stands straight, the robot's unless given. Mounted
    ``sensors`` become a force and a torque sensor named ``TOPIC/force`` and ``TOPIC/torque``, of what the part before
    applies to the part behind, in the sensor's frame. Without ``shapes`` there are none.
    """
    straight = robot.gravity if gravity is None else gravity
    root = _Writer(robot, inertias, effects, straight).document(
        [sensor for sensor in sensors if sensor.role == "mounted"], shapes or Shapes()
    )
    indent(root)
    return f"<!-- {robot.name.replace('--', '- -')}: bodies and effects as geomid identified them -->\n" + (
        tostring(root, encoding="unicode") + "\n"
    )


class _Writer:
    """One robot on its way into an MJCF."""

    def __init__(
        self, robot: Robot, inertias: Mapping[str, FloatArray], effects: Iterable[KnownEffect], gravity: FloatArray
    ) -> None:
        self._robot = robot
        self._bodies = {body.name: inertias.get(body.name, body.parameters) for body in robot.bodies}
        self._joints = joint_frames(robot.urdf, robot.source)
        self._driven = set(robot.joint_names)
        self._moving = self._driven.union(follower.joint.name for follower in robot.followers)
        effects = list(effects)
        self._said_of = joint_attributes(effects, "joint")
        # One for each: two of a pair may turn it in different ratios.
        said = (joint_attributes([effect], "tendon") for effect in effects)
        self._said_of_pairs = [(name, numbers) for own in said for name, numbers in own.items()]
        self._effects = {(effect.effect, effect.joint): values_of(effect) for effect in effects}
        self._payloads = {effect.link: values_of(effect) for effect in effects if is_body(effect)}
        self._gravity = turned_gravity(gravity, effects)

    def document(self, sensors: Sequence[WrenchSensor], shapes: Shapes) -> Element:
        root = Element("mujoco", model=self._robot.name)
        SubElement(root, "compiler", angle="radian", inertiafromgeom="false", balanceinertia="false")
        step = self._step()
        gravity = words(self._gravity)
        SubElement(root, "option", timestep=words(step), integrator="implicitfast", gravity=gravity)
        default = SubElement(SubElement(root, "default"), "joint")
        constraint = words([_CONSTRAINT_STEPS * step, 1.0])
        default.attrib |= {"solreffriction": constraint, "solreflimit": constraint}
        base = self._add_link(SubElement(root, "worldbody"), self._robot.tree.root, None)
        if self._robot.floating_base:
            base.insert(0, Element("freejoint", name="floating_base"))
        actuators = SubElement(root, "actuator")
        for joint in self._joints:
            if joint.name in self._driven:
                self._add_motor(actuators, joint)
        _add_all(root, "equality", self._followers())
        _add_all(root, "tendon", self._tendons())
        self._add_sensors(root, sensors)
        _add_all(root, "asset", shapes.assets)
        bodies = {body.get("name"): body for body in root.iter("body")}
        for link, geoms in shapes.geoms.items():
            bodies[_body_name(link)].extend(geoms)
        return root

    def _add_link(self, parent: Element, link: str, joint: JointFrame | None) -> Element:
        body = SubElement(parent, "body", name=_body_name(link))
        if joint is not None:
            body.attrib |= {"pos": words(joint.position), "quat": words(np.roll(quaternion(joint.rotation), 1))}
        moves = joint is not None and joint.name in self._moving
        if link in self._bodies:
            _add_inertial(body, self._bodies[link])
        elif moves:
            _add_inertial(body, _MASSLESS * np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0]))
        if joint is not None and moves:
            self._add_joints(body, joint)
        if link in self._payloads:
            payload = SubElement(body, "body", name=f"{_body_name(link)}/payload")
            _add_inertial(payload, payload_parameters(self._payloads[link]))
        for child in self._children(link):
            self._add_link(body, child.child, child)
        return body

    def _children(self, link: str) -> list[JointFrame]:
        return [joint for joint in self._joints if joint.parent == link]

    def _add_joints(self, body: Element, joint: JointFrame) -> None:
        """The joint itself, and the hinges behind it."""
        kind = {"type": "slide" if joint.slides else "hinge", "axis": words(joint.axis)}
        own = SubElement(body, "joint", {"name": joint.name, **kind, **self._dynamics(joint)})
        if joint.lower < joint.upper and math.isfinite(joint.lower + joint.upper):
            own.attrib |= {"limited": "true", "range": words([joint.lower, joint.upper])}
        hinges = self._hinges(joint)
        for hinge in hinges:
            attributes = _attributes(hinge)
            if hinge is not hinges[-1]:
                attributes["armature"] = words(_SMALL_ROTOR * self._carried(joint))
            SubElement(body, "joint", {"name": f"{joint.name}/{hinge.name}", **kind, **attributes})

    def _dynamics(self, joint: JointFrame) -> dict[str, str]:
        numbers = self._said(joint) | {"armature": self._rotor(joint)}
        return {name: words(number) for name, number in sorted(numbers.items()) if number != 0.0}

    def _said(self, joint: JointFrame) -> dict[str, float]:
        """What the effects say of a joint's own attributes, added up."""
        return self._said_of.get(joint.name, {})

    def _hinges(self, joint: JointFrame) -> list[Hinge]:
        """The hinges behind a joint's own."""
        own = [
            (effect, self._effects[name, joint.name])
            for name, effect in EFFECTS.items()
            if (name, joint.name) in self._effects
        ]
        hinges = [effect.hinge(known, self._carried(joint)) for effect, known in own]
        return [hinge for hinge in hinges if hinge is not None]

    def _rotor(self, joint: JointFrame) -> float:
        known = self._said(joint).get("armature", 0.0)
        return max(known, _SMALL_ROTOR * self._carried(joint)) if self._hinges(joint) else known

    def _step(self) -> float:
        """A time step that resolves the oscillation of every rotor on its elastic gear."""
        periods = [
            math.sqrt(self._rotor(joint) / hinge.stiffness)
            for joint in self._joints
            for hinge in self._hinges(joint)
            if hinge.stiffness > 0.0
        ]
        return min([LONGEST_STEP, *(period / _STEPS_PER_RADIAN for period in periods)])

    def _carried(self, joint: JointFrame) -> float:
        """Inertia [kg m^2, kg] that a joint carries, about its axis, all joints at zero."""
        parameters = pseudo_inertia.to_parameters(self._composite(joint.child))
        if joint.slides:
            return float(parameters[0])
        return float(joint.axis @ pseudo_inertia.rotational_inertia(parameters) @ joint.axis)

    def _composite(self, link: str) -> FloatArray:
        """Pseudo-inertia ``(4, 4)`` of a link and all that comes after it, all joints at zero."""
        total = pseudo_inertia.from_parameters(self._bodies.get(link, np.zeros(10)))
        if link in self._payloads:
            total = total + pseudo_inertia.from_parameters(payload_parameters(self._payloads[link]))
        for joint in self._children(link):
            placed = pseudo_inertia.change_of_frame(joint.rotation, joint.position)
            total = total + placed @ self._composite(joint.child) @ placed.T
        return total

    def _add_motor(self, actuators: Element, joint: JointFrame) -> None:
        motor = SubElement(actuators, "motor", name=joint.name, joint=joint.name)
        if math.isfinite(joint.effort):
            motor.attrib |= {"ctrllimited": "true", "ctrlrange": words([-joint.effort, joint.effort])}

    def _followers(self) -> Iterator[Element]:
        """Ties of the joints that mimic others to these."""
        for follower in self._robot.followers:
            polynomial = words([follower.offset, follower.factor, 0.0, 0.0, 0.0])
            master = self._robot.joint_names[follower.master]
            yield Element("joint", joint1=follower.joint.name, joint2=master, polycoef=polynomial)

    def _tendons(self) -> Iterator[Element]:
        """What acts on two joints together, along a fixed tendon of their weighted sum."""
        for name, numbers in self._said_of_pairs:
            place, coefficient = place_named("joints", name, self._robot.joint_names), numbers.pop("coef")
            joints = [self._robot.joint_names[joint] for joint in (joints_of(place) if place else ())]
            tendon = Element("fixed", {key: words(number) for key, number in sorted(numbers.items())})
            for joint, weight in zip(joints, (1.0, coefficient), strict=False):
                SubElement(tendon, "joint", joint=joint, coef=words(weight))
            yield tendon

    def _add_sensors(self, root: Element, sensors: Sequence[WrenchSensor]) -> None:
        """Sites in the sensors' frames, and what is sensed there."""
        sensed = SubElement(root, "sensor")
        bodies = {body.get("name"): body for body in root.iter("body")}
        for sensor in sensors:
            bodies[_body_name(sensor.frame)].append(Element("site", name=sensor.topic))
            for kind in ("force", "torque"):
                SubElement(sensed, kind, name=f"{sensor.topic}/{kind}", site=sensor.topic)


def _add_all(root: Element, name: str, elements: Iterable[Element]) -> None:
    """Add elements below one of this name, if there are any."""
    if inner := list(elements):
        SubElement(root, name).extend(inner)


def _body_name(link: str) -> str:
    """MuJoCo keeps the name of the world to itself."""
    return "world_link" if link == "world" else link


def _attributes(hinge: Hinge) -> dict[str, str]:
    """Of a hinge behind a joint's own."""
    attributes = {}
    if hinge.stiffness > 0.0:
        attributes["stiffness"] = words(hinge.stiffness)
    if hinge.half_range > 0.0:
        attributes |= {"limited": "true", "range": words([-hinge.half_range, hinge.half_range])}
    return {**attributes, "damping": words(hinge.damping)}


def _add_inertial(body: Element, parameters: FloatArray) -> None:
    SubElement(body, "inertial", inertial_attributes(parameters))


def inertial_attributes(parameters: FloatArray) -> dict[str, str]:
    """The attributes of the <inertial> of a body with ``parameters (10,)``."""
    inertia = pseudo_inertia.central_inertia(parameters)
    return {
        "pos": words(pseudo_inertia.centre_of_mass(parameters)),
        "mass": words(parameters[0]),
        "fullinertia": words(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
    }


_WORLD = ["mujoco", "worldbody"]
_NOTHING = b'<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'
_RADIANS = re.compile(r"""<compiler\b[^>]*\sangle\s*=\s*["']radian["']""")


def with_identified(
    mjcf: str,
    bodies: Mapping[str, FloatArray],
    joints: Mapping[str, Mapping[str, float]],
    emptied: Collection[str] = (),
) -> str:
    """An MJCF with what was identified.

    Args:
        mjcf: the text.
        bodies: inertial parameters ``(10,)`` of bodies by name, in their own frames.
        joints: attributes of joints by name, angles in radians.
        emptied: bodies that weigh nothing of their own, as others count them in.
    """
    data = mjcf.encode()
    places, tags = descendants_of(data, _WORLD, "body", "inertial"), descendants_of(data, _WORLD, "joint")
    edits: list[Edit] = [
        insertion(data, places[name], with_attributes(b"<inertial/>", inertial_attributes(parameters)))
        for name, parameters in bodies.items()
    ]
    edits += [insertion(data, places[name], _NOTHING) for name in emptied]
    for name, numbers in joints.items():
        start, end = tags[name].tag
        slides = re.search(rb"""\stype\s*=\s*["']slide""", data[start:end])
        turns = {} if slides or _RADIANS.search(mjcf) else {"springref": 180.0 / np.pi}
        words = {key: repr(float(value * turns.get(key, 1.0))) for key, value in sorted(numbers.items())}
        edits.append((start, end, with_attributes(data[start:end], words)))
    return edited(data, edits).decode()
