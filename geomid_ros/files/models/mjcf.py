"""MJCF of an identified robot with its effects, as far as MJCF can represent them; or their values in an existing MJCF.

The kinematics are the URDF's. Gravity, damping, dry friction, armature and springs are MuJoCo's own elements; a payload
is a body fixed to its link. A joint with elasticity or backlash has a second hinge (or slide) named
``JOINT/elasticity`` or ``JOINT/backlash`` on the same axis, distal to its own. The first is the motor's, measured and
driven.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.models.effects_file import joint_attributes, tilted_gravity
from geomid_ros.files.models.urdf import MeshFinder
from geomid_ros.files.models.xml_edits import Edit, edited, insertion, spans_of, with_attributes
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import EFFECTS, Hinge, KnownEffect, joints_of
from geomid_ros.model.effects.situation import place_named
from geomid_ros.model.robot import Robot
from geomid_ros.model.se3 import quaternion
from geomid_ros.model.urdf_tree import AXES, UrdfJoint, masters, origin_of, read_numbers, read_xml
from geomid_ros.types import FloatArray

_READ_BY_MUJOCO = (".stl", ".obj", ".msh")
# Visual shapes collide with nothing. Collision shapes ignore one another: a URDF does not state which pairs may touch.
_KINDS = {
    "visual": {"contype": "0", "conaffinity": "0", "group": "2"},
    "collision": {"contype": "1", "conaffinity": "0", "group": "3"},
}


@dataclass(frozen=True, eq=False)
class Shapes:
    """The ``geoms`` of links by name, the ``assets`` that they need, and for each reason why
    some are ``missing`` their links."""

    geoms: dict[str, list[Element]] = field(default_factory=dict)
    assets: dict[tuple[str, str], Element] = field(default_factory=dict)
    missing: dict[str, list[str]] = field(default_factory=dict)


def mjcf_shapes(urdf: str, source: Path, packages: Mapping[str, Path] = MappingProxyType({})) -> Shapes:
    """Convert the shapes of a URDF's links.

    Args:
        urdf: text of the URDF.
        source: its file, above which meshes are searched.
        packages: folders of meshes by package name.
    """
    shapes, find = Shapes(), MeshFinder(source, packages).find
    for link in read_xml(urdf, str(source)).findall("link"):
        name = link.get("name", "")
        for kind, attributes in _KINDS.items():
            for element in link.findall(kind):
                where = f"{source}: link '{name}'"
                try:
                    pose = _pose(*origin_of(element, where))
                    geom = Element("geom", attributes | pose | _shape(element, where))
                    mesh = element.find("geometry/mesh")
                    if mesh is not None:
                        path, scale = find(mesh.get("filename", ""), where), mesh.get("scale", "1 1 1")
                        geom.set("mesh", _asset(shapes, path, scale, where))
                except InputError as error:
                    shapes.missing.setdefault(str(error).removeprefix(f"{where}: "), []).append(name)
                else:
                    shapes.geoms.setdefault(name, []).append(geom)
    return shapes


def _pose(position: FloatArray, axes: FloatArray) -> dict[str, str]:
    return {"pos": number_text(position), "quat": number_text(np.roll(quaternion(axes), 1))}


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
    return {"type": tag, "size": number_text(sizes)}


def _asset(shapes: Shapes, path: Path, scale: str, where: str) -> str:
    """Name of a mesh among the assets, to which it is added once."""
    if path.suffix.lower() not in _READ_BY_MUJOCO:
        raise InputError(f"{where}: MuJoCo reads no {path.suffix}")
    key = str(path.resolve()), scale
    if key not in shapes.assets:
        name = f"{path.stem}_{len(shapes.assets)}"
        shapes.assets[key] = Element("mesh", name=name, file=key[0], scale=scale)
    return shapes.assets[key].get("name", "")


def number_text(numbers: FloatArray | Sequence[float] | float) -> str:
    """Numbers as text, to the last bit."""
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


LONGEST_STEP = 1e-3  # [s] upper bound of the time step
_STEPS_PER_RADIAN = 4.0  # time steps per radian of an elastic joint's fastest oscillation
# Time constant, in time steps, of the constraints for dry friction and backlash limits: the smallest that MuJoCo
# allows. Friction is then correct until a joint is almost at rest. Stiffer constraints make a light rotor rattle in its
# backlash.
_CONSTRAINT_STEPS = 2.0
# If a second hinge needs a rotor inertia and none is known: fraction of the distal inertia.
_SMALL_ROTOR = 0.01
_FRICTION = {"damping": "damping", "friction": "frictionloss"}  # MJCF attributes by those of a URDF's <dynamics>
_MASSLESS = 1e-12  # [kg, kg m^2] MuJoCo requires a mass of every moving body


def mjcf(
    robot: Robot,
    inertias: Mapping[str, FloatArray],
    effects: Iterable[KnownEffect] = (),
    sensors: Sequence[WrenchSensor] = (),
    gravity: FloatArray | None = None,
    shapes: Shapes | None = None,
) -> str:
    """MJCF of ``robot``. Its bodies have ``inertias (10,)`` by name, or the URDF's if none is given. No joint is
    locked, and links that are fixed to the world have their inertials.

    Dry friction and damping in the URDF are ignored but for locked joints; friction is among the ``effects`` or absent.
    ``gravity (3,)`` [m/s^2] is that of an upright base, the robot's unless given. Mounted ``sensors`` become a force
    and a torque sensor named ``TOPIC/force`` and ``TOPIC/torque``. They measure, in the sensor's frame, the wrench from
    the proximal on the distal part. Without ``shapes`` the MJCF has none.
    """
    upright_gravity = robot.gravity if gravity is None else gravity
    root = _Writer(robot, inertias, effects, upright_gravity).document(
        [sensor for sensor in sensors if sensor.role == "mounted"], shapes or Shapes()
    )
    indent(root)
    return f"<!-- {robot.name.replace('--', '- -')}: bodies and effects as geomid identified them -->\n" + (
        tostring(root, encoding="unicode") + "\n"
    )


class _Writer:
    """Builds the MJCF of one robot."""

    def __init__(
        self, robot: Robot, inertias: Mapping[str, FloatArray], effects: Iterable[KnownEffect], gravity: FloatArray
    ) -> None:
        self._robot = robot
        bodies = {body.name: inertias.get(body.name, body.parameters) for body in robot.bodies}
        included, inertials = robot.included_links(bodies), robot.tree.inertials
        others = {name: own for name, own in inertials.items() if name not in included and own[0] > 0.0}
        self._links = {name: pseudo_inertia.nearest_body(own) for name, own in others.items()} | robot.as_links(bodies)
        self._joints = robot.tree.joints
        self._moving = [joint.name for joint in self._joints if AXES[joint.type] == 1]
        self._masters = masters(robot.tree, robot.source)
        effects = list(effects)
        self._joint_attributes = defaultdict(dict[str, float], joint_attributes(effects, "joint"))
        for name, key in itertools.product(robot.locked_joints, _FRICTION):
            self._joint_attributes[name].setdefault(_FRICTION[key], robot.described_dynamics[name, f"dynamics/{key}"])
        # One entry per effect: two effects of a pair may have different ratios.
        tendons = (joint_attributes([effect], "tendon") for effect in effects)
        self._tendon_attributes = [(name, numbers) for pairs in tendons for name, numbers in pairs.items()]
        self._effects = {(effect.effect, effect.joint): effect.values for effect in effects}
        self._payloads = {effect.link: effect.body for effect in effects if effect.is_payload}
        self._gravity = tilted_gravity(gravity, effects)

    def document(self, sensors: Sequence[WrenchSensor], shapes: Shapes) -> Element:
        root = Element("mujoco", model=self._robot.name)
        SubElement(root, "compiler", angle="radian", inertiafromgeom="false", balanceinertia="false")
        step = self._step()
        gravity = number_text(self._gravity)
        SubElement(root, "option", timestep=number_text(step), integrator="implicitfast", gravity=gravity)
        default = SubElement(SubElement(root, "default"), "joint")
        constraint = number_text([_CONSTRAINT_STEPS * step, 1.0])
        default.attrib |= {"solreffriction": constraint, "solreflimit": constraint}
        base = self._add_link(SubElement(root, "worldbody"), self._robot.tree.root, None)
        if self._robot.floating_base:
            base.insert(0, Element("freejoint", name="floating_base"))
        SubElement(root, "actuator").extend(self._motors())
        _add_all(root, "equality", self._followers())
        _add_all(root, "tendon", self._tendons())
        bodies = {body.get("name"): body for body in root.iter("body")}
        section = SubElement(root, "sensor")
        for sensor in sensors:
            bodies[_body_name(sensor.frame)].append(Element("site", name=sensor.topic))
            for kind in ("force", "torque"):
                SubElement(section, kind, name=f"{sensor.topic}/{kind}", site=sensor.topic)
        _add_all(root, "asset", shapes.assets.values())
        for link, geoms in shapes.geoms.items():
            bodies[_body_name(link)].extend(geoms)
        return root

    def _add_link(self, parent: Element, link: str, joint: UrdfJoint | None) -> Element:
        body = SubElement(parent, "body", name=_body_name(link))
        if joint is not None:
            body.attrib |= _pose(joint.position, joint.rotation)
        moves = joint is not None and joint.name in self._moving
        if link in self._links:
            _add_inertial(body, self._links[link])
        elif moves:
            _add_inertial(body, _MASSLESS * np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0]))
        if joint is not None and moves:
            self._add_joints(body, joint)
        if link in self._payloads:
            payload = SubElement(body, "body", name=f"{_body_name(link)}/payload")
            _add_inertial(payload, self._payloads[link])
        for child in self._robot.tree.children(link):
            self._add_link(body, child.child, child)
        return body

    def _add_joints(self, body: Element, joint: UrdfJoint) -> None:
        """Add the joint itself, and its second hinges."""
        kind = {"type": "slide" if joint.type == "prismatic" else "hinge", "axis": number_text(joint.axis)}
        numbers = self._joint_attributes[joint.name] | {"armature": self._rotor(joint)}
        dynamics = {name: number_text(number) for name, number in sorted(numbers.items()) if number != 0.0}
        element = SubElement(body, "joint", {"name": joint.name, **kind, **dynamics})
        if joint.lower < joint.upper and math.isfinite(joint.lower + joint.upper):
            element.attrib |= {"limited": "true", "range": number_text([joint.lower, joint.upper])}
        hinges = self._hinges(joint)
        for hinge in hinges:
            attributes = _attributes(hinge)
            if hinge is not hinges[-1]:
                attributes["armature"] = number_text(_SMALL_ROTOR * self._distal_inertia(joint))
            SubElement(body, "joint", {"name": f"{joint.name}/{hinge.name}", **kind, **attributes})

    def _hinges(self, joint: UrdfJoint) -> list[Hinge]:
        """Additional hinges distal to a joint's own."""
        values = {name: self._effects[name, joint.name] for name in EFFECTS if (name, joint.name) in self._effects}
        hinges = (EFFECTS[name].hinge(value, self._distal_inertia(joint)) for name, value in values.items())
        return [hinge for hinge in hinges if hinge is not None]

    def _rotor(self, joint: UrdfJoint) -> float:
        armature = self._joint_attributes[joint.name].get("armature", 0.0)
        return max(armature, _SMALL_ROTOR * self._distal_inertia(joint)) if self._hinges(joint) else armature

    def _step(self) -> float:
        """Time step [s] that resolves the oscillation of every rotor on its elastic gear."""
        periods = [
            math.sqrt(self._rotor(joint) / hinge.stiffness)
            for joint in self._joints
            for hinge in self._hinges(joint)
            if hinge.stiffness > 0.0
        ]
        return min([LONGEST_STEP, *(period / _STEPS_PER_RADIAN for period in periods)])

    def _distal_inertia(self, joint: UrdfJoint) -> float:
        """Inertia [kg m^2, kg] about a joint's axis of everything distal to it, all joints at zero."""
        parameters = pseudo_inertia.to_parameters(self._composite(joint.child))
        if joint.type == "prismatic":
            return float(parameters[0])
        return float(joint.axis @ pseudo_inertia.rotational_inertia(parameters) @ joint.axis)

    def _composite(self, link: str) -> FloatArray:
        """Pseudo-inertia ``(4, 4)`` of a link and its subtree, all joints at zero."""
        total = pseudo_inertia.from_parameters(self._links.get(link, np.zeros(10)))
        if link in self._payloads:
            total = total + pseudo_inertia.from_parameters(self._payloads[link])
        for joint in self._robot.tree.children(link):
            placed = pseudo_inertia.change_of_frame(joint.rotation, joint.position)
            total = total + placed @ self._composite(joint.child) @ placed.T
        return total

    def _motors(self) -> Iterator[Element]:
        """Yield motors of the joints that mimic no other."""
        driven = {*self._moving} - self._masters.keys()
        for joint in (joint for joint in self._joints if joint.name in driven):
            motor = Element("motor", name=joint.name, joint=joint.name)
            if math.isfinite(joint.effort):
                motor.attrib |= {"ctrllimited": "true", "ctrlrange": number_text([-joint.effort, joint.effort])}
            yield motor

    def _followers(self) -> Iterator[Element]:
        """Yield equality constraints of joints that mimic others."""
        for follower, (master, factor, offset) in self._masters.items():
            polynomial = number_text([offset, factor, 0.0, 0.0, 0.0])
            joint2 = {"joint2": master} if master in self._moving else {}
            if follower in self._moving:
                yield Element("joint", {"joint1": follower, **joint2, "polycoef": polynomial})

    def _tendons(self) -> Iterator[Element]:
        """Yield effects on two joints together, as fixed tendons along their weighted sum."""
        for name, numbers in self._tendon_attributes:
            place, coefficient = place_named("joints", name, self._robot.joint_names), numbers.pop("coef")
            joints = [self._robot.joint_names[joint] for joint in (joints_of(place) if place else ())]
            tendon = Element("fixed", {key: number_text(number) for key, number in sorted(numbers.items())})
            for joint, weight in zip(joints, (1.0, coefficient), strict=False):
                SubElement(tendon, "joint", joint=joint, coef=number_text(weight))
            yield tendon


def _add_all(root: Element, name: str, elements: Iterable[Element]) -> None:
    """Add elements below a new element of this name, if there are any."""
    if inner := list(elements):
        SubElement(root, name).extend(inner)


def _body_name(link: str) -> str:
    """Rename a link called world, as MuJoCo reserves this name."""
    return "world_link" if link == "world" else link


def _attributes(hinge: Hinge) -> dict[str, str]:
    """Attributes of an additional hinge."""
    attributes = {}
    if hinge.stiffness > 0.0:
        attributes["stiffness"] = number_text(hinge.stiffness)
    if hinge.half_range > 0.0:
        attributes |= {"limited": "true", "range": number_text([-hinge.half_range, hinge.half_range])}
    return {**attributes, "damping": number_text(hinge.damping)}


def _add_inertial(body: Element, parameters: FloatArray) -> None:
    SubElement(body, "inertial", inertial_attributes(parameters))


def inertial_attributes(parameters: FloatArray) -> dict[str, str]:
    """Attributes of the <inertial> of a body with ``parameters (10,)``."""
    inertia = pseudo_inertia.central_inertia(parameters)
    return {
        "pos": number_text(pseudo_inertia.centre_of_mass(parameters)),
        "mass": number_text(parameters[0]),
        "fullinertia": number_text(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
    }


_WORLD = ["mujoco", "worldbody"]
_NOTHING = b'<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'


def with_identified(
    mjcf: str,
    bodies: Mapping[str, FloatArray],
    joints: Mapping[str, Mapping[str, float]],
    emptied: Collection[str] = (),
    in_degrees: Collection[str] = (),
) -> str:
    """Insert identified values into an MJCF.

    Args:
        mjcf: text of the MJCF.
        bodies: inertial parameters ``(10,)`` of bodies by name, in their own frames.
        joints: attributes of joints by name, angles in radians.
        emptied: bodies that become massless, as the inertias of others include them.
        in_degrees: joints with angles in degrees.
    """
    data = mjcf.encode()
    places = spans_of(data, _WORLD, "body", "inertial", deeper=True)
    tags = spans_of(data, _WORLD, "joint", deeper=True)
    edits: list[Edit] = [
        insertion(data, places[name], with_attributes(b"<inertial/>", inertial_attributes(parameters)))
        for name, parameters in bodies.items()
    ]
    edits += [insertion(data, places[name], _NOTHING) for name in emptied]
    for name, numbers in joints.items():
        start, end = tags[name].tag
        turns = dict.fromkeys(("springref", "ref"), 180.0 / np.pi) if name in in_degrees else {}
        words = {key: repr(float(value * turns.get(key, 1.0))) for key, value in sorted(numbers.items())}
        edits.append((start, end, with_attributes(data[start:end], words)))
    return edited(data, edits).decode()
