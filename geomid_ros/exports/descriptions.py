"""Robot descriptions for other software: each format with what it cannot represent, or values in the user's MJCF.

=======  ===============================================================================================================
mujoco   reads MJCF: damping, frictionloss, armature and springs of joints, elasticity and backlash as further joints
gazebo   turns a URDF into SDF: <dynamics> of joints, and springs as <gazebo> elements (SDFormat, sdf_extensions.md)
drake    reads damping of <dynamics>, not friction; rotor inertia at the actuators of transmissions
         (multibody/parsing/detail_urdf_parser.cc)
isaac    reads <dynamics> up to Isaac Sim 6.0 (isaacsim.asset.importer.urdf), no armature; actuators of Isaac Lab take
         armature and friction of joints (isaaclab.actuators, ActuatorBaseCfg)
urdf     any program that reads a URDF
moveit   reads a URDF; its planners ignore inertials and <dynamics>
=======  ===============================================================================================================
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from xml.parsers.expat import ExpatError

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.exports import formats
from geomid_ros.exports.formats import Export
from geomid_ros.exports.model import ExportModel, payload_link
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effects_file import joint_attributes, of_followers, tilted_gravity, unrepresentable
from geomid_ros.files.models.mjcf import Shapes, mjcf, mjcf_shapes, with_identified
from geomid_ros.files.models.readers import ELEMENTS, EXISTING_MJCF
from geomid_ros.files.models.urdf import for_drake, for_gazebo, with_effects
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.robot import Robot
from geomid_ros.model.se3 import best_rotation
from geomid_ros.model.urdf_tree import MOST_URDF_BYTES, masters
from geomid_ros.resimulation.written_robot import CompiledMjcf, compile_mjcf
from geomid_ros.types import FloatArray

_MOVEIT_NOTE = (
    "What reads it: MoveIt plans by limits alone; its DynamicsSolver, and ros2_control's controllers that compute",
    "torques, read <inertial> of robot_description, many by kdl_parser, which takes none at the root link, and of",
    "<dynamics> nothing. The same elements stand in a xacro file.",
)
_ISAAC_NOTE = (
    "What reads it: Isaac Sim's URDF importer takes inertials (import_inertia_tensor). isaac_joints.json has armature,",
    "friction (static), dynamic_friction, viscous_friction for Isaac Lab's actuators, efforts in N m since Isaac Sim",
    "5.0 (PhysX's PxJointFrictionParams). Not tried here: no Isaac Sim is on the machines that test this.",
)
_ISAAC_FILE = "isaac_joints.json"
_ISAAC_DROPS = (
    f"Isaac Sim 6.1 ignores <dynamics> (IsaacSim issue 841): give Isaac Lab's actuators the numbers of {_ISAAC_FILE}. "
    "Up to 6.0 it makes the drives' damping of it, which adds to viscous_friction"
)
# Names of MJCF joint attributes by those of Isaac Lab's actuators.
_ISAAC_JOINT = {
    "armature": "armature",
    "friction": "frictionloss",
    "dynamic_friction": "frictionloss",
    "viscous_friction": "damping",
}
_GAZEBO_NOTE = ("What reads it: gz sdf -p shows what Gazebo makes of it: it lumps fixed links together.",)
_DRAKE_NOTE = ("What reads it: Drake takes inertials and damping, and rotor inertia of joints with an effort limit.",)
_MUJOCO_NOTE = (
    '<compiler inertiafromgeom="true"/> would override the inertials; the default, "auto", does not.',
    "Shapes of the robot do not collide with one another (conaffinity): a URDF does not say which may.",
)


class DescriptionFiles(NamedTuple):
    """Text of a whole robot, sentences on its ``omissions``, and texts of ``extra_files`` by name."""

    text: str
    omissions: list[str]
    extra_files: Mapping[str, str] = MappingProxyType({})


class RobotToDescribe(NamedTuple):
    """Robot to describe: its ``urdf`` with the inertias, the ``path`` and the folders of ``packages`` that its meshes
    are found from, the ``effects`` in addition to inertias, ``gravity (3,)`` with the base upright, and the function
    ``read`` that loads it."""

    urdf: str
    path: Path
    effects: Sequence[KnownEffect]
    gravity: FloatArray
    read: Callable[[], Robot]
    packages: Mapping[str, Path] = MappingProxyType({})


class DescriptionFormat(NamedTuple):
    """Format of one reader: a ``note`` for its user, the text of one ``inertial``, and that of the ``whole`` robot."""

    note: tuple[str, ...]
    inertial: Callable[[Export], str]
    whole: Callable[[RobotToDescribe], DescriptionFiles]

    def payload(self, export: Export) -> str:
        """Return one inertia below a comment with its standard deviations."""
        comments = formats.comments(export)
        return formats.xml_comment([*comments, f"  in the frame of link '{export.frame}'"]) + self.inertial(export)


def described(
    model: ExportModel, reader: str, links: Sequence[Export], packages: Mapping[str, Path]
) -> DescriptionFiles:
    """Return the whole robot for a reader, followed by a comment on its ``links`` and on what the text omits."""
    text, omissions, beside = DESCRIPTIONS[reader].whole(as_described(model, packages))
    lacks = [*not_representable(model, ELEMENTS[reader]), *omissions]
    lacks += [f"{name}: {' '.join(text.split())}" for name, text in beside.items()]
    lines = [*DESCRIPTIONS[reader].note, *lacks, *(line for export in links for line in formats.comments(export))]
    return DescriptionFiles(text.rstrip() + "\n" + formats.xml_comment(lines), lacks, beside)


def not_representable(model: ExportModel, files: tuple[str, ...]) -> list[str]:
    """Return a sentence on the effects of a model that these files cannot represent, if there are any."""
    names = unrepresentable(model.known, files)
    refit = [] if model.fitted else ["estimate.json is of an earlier version: identify again for a fit without these"]
    return [f"Not representable here: {'; '.join([*names, *refit])}"] if names else []


def _urdf(robot: RobotToDescribe) -> DescriptionFiles:
    return DescriptionFiles(with_effects(robot.urdf, robot.effects), [])


def _isaac(robot: RobotToDescribe) -> DescriptionFiles:
    attributes = joint_attributes(robot.effects, "joint")
    joints = {
        joint: {isaac: float(f"{values[ours]:.6g}") for isaac, ours in _ISAAC_JOINT.items() if ours in values}
        for joint, values in attributes.items()
    }
    text = with_effects(robot.urdf, robot.effects)
    return DescriptionFiles(text, [_ISAAC_DROPS], {_ISAAC_FILE: json.dumps(joints, indent=2) + "\n"})


def _gazebo(robot: RobotToDescribe) -> DescriptionFiles:
    return DescriptionFiles(for_gazebo(with_effects(robot.urdf, robot.effects), robot.effects), [])


def _drake(robot: RobotToDescribe) -> DescriptionFiles:
    return DescriptionFiles(for_drake(with_effects(robot.urdf, robot.effects), robot.effects, str(robot.path)), [])


def _mujoco(robot: RobotToDescribe) -> DescriptionFiles:
    shapes = mjcf_shapes(robot.urdf, robot.path, robot.packages)
    text = mjcf(robot.read(), {}, robot.effects, gravity=robot.gravity, shapes=shapes)
    return DescriptionFiles(text, _missing(shapes))


def _missing(shapes: Shapes) -> list[str]:
    """Sentence on the shapes that are missing, with the first reason; none if there are none. Most have one reason, and
    each mesh its own words for it."""
    count = sum(map(len, shapes.missing.values()))
    return [
        f"{count} shape{'s' * (count > 1)} missing, the first of link '{links[0]}': {reason}"
        + " (an option of 'geomid export')" * ("--package-path" in reason)
        for reason, links in [*shapes.missing.items()][:1]
    ]


def as_described(model: ExportModel, packages: Mapping[str, Path] = MappingProxyType({})) -> RobotToDescribe:
    """Return the input for a description of a model."""
    return RobotToDescribe(model.urdf, model.urdf_path, model.effects, model.gravity, lambda: model.robot, packages)


DESCRIPTIONS = {
    "urdf": DescriptionFormat((), formats.urdf_inertial, _urdf),
    "moveit": DescriptionFormat(_MOVEIT_NOTE, formats.urdf_inertial, _urdf),
    "isaac": DescriptionFormat(_ISAAC_NOTE, formats.urdf_inertial, _isaac),
    "gazebo": DescriptionFormat(_GAZEBO_NOTE, formats.sdf_inertial, _gazebo),
    "drake": DescriptionFormat(_DRAKE_NOTE, formats.urdf_inertial, _drake),
    "mujoco": DescriptionFormat(_MUJOCO_NOTE, formats.mjcf_inertial, _mujoco),
}
"""Formats by reader: one for each of :data:`~geomid_ros.files.models.readers.DESCRIBED_FOR`."""


_FAR = 1e-3  # [m, rad] largest deviation between the axes of one joint


@dataclass(frozen=True, eq=False)
class UserMjcf:
    """MJCF of the user that the numbers of a model are written into.

    Attributes:
        path: the file.
        text: its content.
        placements: homogeneous matrices ``(4, 4)`` from links to the bodies of the same names.
        joints: values of its joints by attribute, by name.
        in_degrees: joints with angles in degrees.
        emptied: bodies that are merged into others.
    """

    path: Path
    text: str
    placements: Mapping[str, FloatArray]
    joints: Mapping[str, Mapping[str, float]]
    in_degrees: Collection[str] = ()
    emptied: Sequence[str] = ()

    def with_numbers(self, model: ExportModel) -> str:
        """Return the text with the inertias of the links and the effects at the joints of a model, all else unchanged.
        Raises InputError as :meth:`patched` does."""
        inertias = {
            name: pseudo_inertia.moved(_with_payload(model, name), placed) for name, placed in self.placements.items()
        }
        attributes = joint_attributes(model.effects, "joint")
        for name, zeros in of_followers(attributes, masters(model.tree, model.source)).items():
            own = {key: zero for key, zero in zeros.items() if self.joints.get(name, {}).get(key)}
            attributes[name] = attributes.get(name, {}) | own
        return self.patched(inertias, attributes)

    def patched(self, inertias: Mapping[str, FloatArray], attributes: Mapping[str, Mapping[str, float]]) -> str:
        """Return the text with ``inertias (10,)`` of bodies and ``attributes`` of joints that it has, by name. Raises
        InputError if one of them is not in this file but in an included one."""
        joints = {name: values for name, values in attributes.items() if values and name in self.joints}
        try:
            return with_identified(self.text, inertias, joints, self.emptied, self.in_degrees)
        except KeyError as error:
            raise InputError(
                f"{self.path}: {error} is not in this file itself; give the one that includes nothing"
            ) from error
        except ExpatError as error:  # MuJoCo's parser is more lenient
            raise InputError(f"{self.path}: not valid XML ({error})") from error


def patch_user_mjcf(model: ExportModel, path: Path) -> DescriptionFiles:
    """Return the text of an MJCF with the inertias of the links and the effects at the joints of the model, by name;
    see :func:`read_user_mjcf`."""
    target = read_user_mjcf(model, path)
    patched = target.with_numbers(model)
    links, attributes = model.written, joint_attributes(model.effects, "joint")
    sentences = [
        *not_representable(model, ELEMENTS[EXISTING_MJCF]),
        *_named(f"{path}: has no body", [name for name in links if name not in target.placements]),
        *_named(f"{path}: has no joint", [name for name in attributes if name not in target.joints]),
        *_named("Merged into other bodies (mass set to zero):", target.emptied),
        *_named(f"{path}: {_NOT_THE_MODELS}", _differences(model, compile_mjcf(path, patched))),
    ]
    return DescriptionFiles(patched, sentences)


def read_user_mjcf(model: ExportModel, path: Path) -> UserMjcf:
    """Read an MJCF of the same robot as ``model``.

    The frames of its bodies need not be those of the URDF's links: inertias are transformed, with all joints at zero.

    Raises:
        InputError: it has none of the bodies, or its axes are not where the URDF has them.
    """
    text = read_text(path, "MJCF", MOST_URDF_BYTES)
    if "<mujoco" not in text:
        raise InputError(f"{path}: not an MJCF, it has no <mujoco> element; is it a URDF?")
    compiled = compile_mjcf(path)
    bodies = [name for name in model.written if name in compiled.bodies]
    if not bodies:
        names = f"{', '.join(model.written)}; those that it has: {', '.join(compiled.bodies)}"
        raise InputError(f"{path}: has none of the bodies {names}")
    base = _base(model, compiled, path)
    placed = {name: np.linalg.inv(compiled.bodies[name]) @ base @ model.placements[name] for name in bodies}
    merged = [link for name in bodies for link in model.bodies[name].merged if link not in model.bodies]
    emptied = [link for link in merged if compiled.moving.get(link)]
    target = UserMjcf(path, text, placed, compiled.attributes, emptied=emptied)
    angles = {"springref", "ref"}
    turned = [name for name, values in joint_attributes(model.effects, "joint").items() if angles & values.keys()]
    ones = compile_mjcf(path, target.patched({}, {name: {"springref": 1.0} for name in turned})).attributes
    return replace(target, in_degrees=[name for name in turned if name in ones and ones[name]["springref"] != 1.0])


_NOT_THE_MODELS = "as MuJoCo compiles the written file, it differs from the model:"


def _differences(model: ExportModel, compiled: CompiledMjcf) -> list[str]:
    """Phrases on the masses and joint attributes of a robot in MuJoCo, and the gravity, that are not the model's."""
    masses = {name: body.mass for name, body in model.bodies.items()}
    masses |= {payload_link(model.tree, name): 0.0 for name in model.written}
    masses |= {name: _with_payload(model, name)[0] for name in model.written}
    robot = {*model.tree.links} - {"world"}
    for name in compiled.moving:  # parents come first
        robot |= {name} if compiled.parents[name] in robot else set()
    pairs = [
        (f"mass of {name}", mass, masses.get(name, 0.0)) for name, mass in compiled.moving.items() if name in robot
    ]
    effects, joints = joint_attributes(model.effects, "joint"), {joint.name for joint in model.tree.joints}
    pairs += [
        (f"{key} of {name}", value, effects.get(name, {}).get(key, 0.0))
        for name, values in compiled.attributes.items()
        for key, value in values.items()
        if name in joints and (key != "springref" or values["stiffness"])
    ]
    gravity = tilted_gravity(model.gravity, model.effects)
    if model.tree.root not in model.estimated:
        gravity = _base(model, compiled, model.urdf_path)[:3, :3] @ gravity
    phrases = [f"{name} {own:.4g} instead of {known:.4g}" for name, own, known in pairs if not np.isclose(own, known)]
    if np.linalg.norm(compiled.gravity - gravity) > _FAR * np.linalg.norm(gravity):
        own, expected = (np.round(each, 3).tolist() for each in (compiled.gravity, gravity))
        phrases.append(f"gravity {own} instead of {expected}")
    return phrases


def _with_payload(model: ExportModel, link: str) -> FloatArray:
    """Parameters ``(10,)`` of a link and of the payload found on it, which is a separate link of the URDF."""
    payload, parameters = model.bodies.get(payload_link(model.tree, link)), model.bodies[link].parameters
    return parameters if payload is None else parameters + payload.parameters


def _named(heading: str, names: Sequence[str]) -> list[str]:
    return [f"{heading} {', '.join(names)}"] if names else []


def _base(model: ExportModel, compiled: CompiledMjcf, path: Path) -> FloatArray:
    """Homogeneous matrix ``(4, 4)`` from the URDF's root to the MJCF's world: the placement of the body named like the
    root, or else the best fit of all axes. Raises InputError if neither fits."""
    axes = _urdf_axes(model, compiled.axes)
    named = compiled.bodies.get(model.tree.root, np.eye(4))
    fitted = _fitted(axes, compiled.axes)
    apart = [
        [name for name in axes if _deviation(base, axes[name], compiled.axes[name]) >= _FAR] for base in (named, fitted)
    ]
    if [] in apart:
        return (named, fitted)[apart.index([])]
    worst = ", ".join(apart[0] if len(apart[0]) < len(apart[1]) else apart[1])
    raise InputError(
        f"{path}: with all joints at zero, its axes are not where {model.urdf_path} has them ({worst}): another robot, "
        "or other zeros or signs of joints; an inertia cannot be moved from one to the other"
    )


def _urdf_axes(model: ExportModel, names: Iterable[str]) -> dict[str, FloatArray]:
    """Point and direction ``(2, 3)`` of the axes of the joints in ``names``, in the frame of the URDF's root."""
    axes = {}
    for joint in model.tree.joints:
        if joint.name in set(names) and np.any(joint.axis):
            placed = model.placements[joint.child]
            axes[joint.name] = np.array([placed[:3, 3], placed[:3, :3] @ joint.axis])
    return axes


def _fitted(axes: Mapping[str, FloatArray], seen: Mapping[str, FloatArray]) -> FloatArray:
    """Least-squares rigid motion from lines ``axes`` to lines ``seen``: the rotation of the directions, then the
    translation perpendicular to them."""
    base = np.eye(4)
    if not axes:
        return base
    source, target = (np.array([lines[name] for name in axes]) for lines in (axes, seen))
    base[:3, :3], _ = best_rotation(target[:, 1].T @ source[:, 1])
    across = np.eye(3) - target[:, 1, :, None] * target[:, 1, None, :]
    shifts = np.einsum("nij,nj->ni", across, target[:, 0] - source[:, 0] @ base[:3, :3].T)
    base[:3, 3] = np.linalg.lstsq(across.reshape(-1, 3), shifts.ravel(), rcond=None)[0]
    return base


def _deviation(base: FloatArray, line: FloatArray, seen: FloatArray) -> float:
    """Deviation of a ``line`` from the line ``seen``: the larger of the angle and the distance."""
    point, direction = base[:3, :3] @ line[0] + base[:3, 3], base[:3, :3] @ line[1]
    distance = np.linalg.norm(np.cross(point - seen[0], seen[1]))
    return float(max(distance, np.linalg.norm(direction - seen[1])))
