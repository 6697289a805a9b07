"""Robot descriptions for other software: the format, the elements that it reads, and effects that it cannot represent.

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
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from geomid_ros.exports import formats
from geomid_ros.files.models.effects_file import joint_attributes, unrepresentable
from geomid_ros.files.models.readers import ELEMENTS
from geomid_ros.files.models.urdf import for_drake, for_gazebo, with_effects
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

if TYPE_CHECKING:
    from geomid_ros.exports.model import ExportModel
    from geomid_ros.exports.payload import Export

_MOVEIT_NOTE = (
    "What reads it: MoveIt plans by limits alone; its DynamicsSolver, and ros2_control's controllers that compute",
    "torques, read <inertial> of robot_description, many by kdl_parser, which takes none at the root link, and of",
    "<dynamics> nothing. The same elements stand in a xacro file.",
)
_ISAAC_NOTE = (
    "What reads it: Isaac Sim's URDF importer takes inertials (import_inertia_tensor); <dynamics> up to 6.0, 6.1 drops",
    "them without a word (IsaacSim issue 841). So give the actuators of Isaac Lab the numbers of isaac_joints.json:",
    "armature, friction (static), dynamic_friction and viscous_friction, efforts in N m since Isaac Sim 5.0 (PhysX's",
    "PxJointFrictionParams). Not tried here: there is no Isaac Sim on the machines that test this.",
)
_ISAAC_FILE = "isaac_joints.json"
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

_MOST_MISSING = 3  # sentences on missing shapes; the others are counted


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
    return DescriptionFiles(
        text, [f"{_ISAAC_FILE}: {json.dumps(joints)}"], {_ISAAC_FILE: json.dumps(joints, indent=2) + "\n"}
    )


def _gazebo(robot: RobotToDescribe) -> DescriptionFiles:
    return DescriptionFiles(for_gazebo(with_effects(robot.urdf, robot.effects), robot.effects), [])


def _drake(robot: RobotToDescribe) -> DescriptionFiles:
    return DescriptionFiles(for_drake(with_effects(robot.urdf, robot.effects), robot.effects, str(robot.path)), [])


def _mujoco(robot: RobotToDescribe) -> DescriptionFiles:
    # These imports take as long as all others, and only an MJCF needs them.
    from geomid_ros.files.models.mjcf import mjcf, mjcf_shapes  # noqa: PLC0415
    from geomid_ros.files.shapes import MeshFinder  # noqa: PLC0415

    shapes = mjcf_shapes(robot.urdf, str(robot.path), MeshFinder(robot.path, robot.packages).find)
    missing = list(dict.fromkeys(shapes.missing))
    summary = [f"{len(missing) - _MOST_MISSING} more shapes are missing"] if len(missing) > _MOST_MISSING else []
    text = mjcf(robot.read(), {}, robot.effects, gravity=robot.gravity, shapes=shapes)
    return DescriptionFiles(text, [*missing[:_MOST_MISSING], *summary])


def as_described(model: ExportModel, packages: Mapping[str, Path] = MappingProxyType({})) -> RobotToDescribe:
    """Return the input for a description of a model."""
    read = partial(described_robot, model)
    return RobotToDescribe(model.urdf, model.urdf_path, model.effects, model.gravity, read, packages)


def described_robot(model: ExportModel) -> Robot:
    """Return the robot with the identified bodies; joints between links identified as one body are locked."""
    merged = {link for body in model.bodies.values() for link in body.merged}
    return Robot(
        model.urdf,
        source=str(model.urdf_path),
        floating_base=model.tree.root in model.estimated,
        cuts=[joint.child for joint in model.tree.joints if joint.type == "fixed" and joint.child in model.estimated],
        locked_joints=[joint.name for joint in model.tree.joints if joint.child in merged and joint.type != "fixed"],
    )


DESCRIPTIONS = {
    "urdf": DescriptionFormat((), formats.urdf_inertial, _urdf),
    "moveit": DescriptionFormat(_MOVEIT_NOTE, formats.urdf_inertial, _urdf),
    "isaac": DescriptionFormat(_ISAAC_NOTE, formats.urdf_inertial, _isaac),
    "gazebo": DescriptionFormat(_GAZEBO_NOTE, formats.sdf_inertial, _gazebo),
    "drake": DescriptionFormat(_DRAKE_NOTE, formats.urdf_inertial, _drake),
    "mujoco": DescriptionFormat(_MUJOCO_NOTE, formats.mjcf_inertial, _mujoco),
}
"""Formats by reader: one for each of :data:`~geomid_ros.files.models.readers.DESCRIBED_FOR`."""
