"""``<inertial>`` elements of robot descriptions, in the axes and about the origin of a link, to paste.

====  ==================================================================================================================
URDF  inertia about the centre of mass, in the axes of ``<origin>``, here those of the link (ROS wiki, urdf/XML/link)
SDF   the same with ``<pose>``; products of inertia are entries of the matrix, -m x y (SDFormat 1.10, inertial.sdf)
MJCF  ``fullinertia`` about ``pos`` in the body's axes: Ixx Iyy Izz Ixy Ixz Iyz (MuJoCo's XML reference, body/inertial)
====  ==================================================================================================================
"""

from __future__ import annotations

from collections.abc import Sequence

from geomid_ros.exports.inertial import Export
from geomid_ros.exports.text import comments, inertia_entries, number, numbers, xml_comment

_MOVEIT = (
    "What reads it: MoveIt plans by limits alone; its DynamicsSolver, and ros2_control's controllers that compute",
    "torques, read <inertial> of robot_description, many by kdl_parser, which takes none at the root link.",
    "All links at once: identified.urdf. The same element stands in a xacro file.",
)
_GAZEBO = ("All links at once: gz sdf -p identified.urdf, which lumps links together that are fixed to one another.",)
_MUJOCO = ('<compiler inertiafromgeom="true"/> would override it; the default, "auto", does not.',)


def urdf(exports: Sequence[Export]) -> str:
    """For MoveIt, ros2_control and all else that reads a URDF."""
    return xml_comment(_MOVEIT) + "".join(_block(export, _urdf_inertial(export)) for export in exports)


def sdf(exports: Sequence[Export]) -> str:
    """For Gazebo."""
    return xml_comment(_GAZEBO) + "".join(_block(export, _sdf_inertial(export)) for export in exports)


def mjcf(exports: Sequence[Export]) -> str:
    """For MuJoCo."""
    return xml_comment(_MUJOCO) + "".join(_block(export, _mjcf_inertial(export)) for export in exports)


def _block(export: Export, element: str) -> str:
    return "\n" + xml_comment([*comments(export), f"  in the frame of link '{export.frame}'"]) + element


def _urdf_inertial(export: Export) -> str:
    entries = " ".join(f'{key}="{number(value)}"' for key, value in inertia_entries(export).items())
    return (
        f'<inertial>\n  <origin xyz="{numbers(export.inertial.com, " ")}" rpy="0 0 0"/>\n'
        f'  <mass value="{number(export.inertial.mass)}"/>\n  <inertia {entries}/>\n</inertial>\n'
    )


def _sdf_inertial(export: Export) -> str:
    entries = "".join(f"<{key}>{number(value)}</{key}>" for key, value in inertia_entries(export).items())
    return (
        f"<inertial>\n  <pose>{numbers(export.inertial.com, ' ')} 0 0 0</pose>\n"
        f"  <mass>{number(export.inertial.mass)}</mass>\n  <inertia>{entries}</inertia>\n</inertial>\n"
    )


def _mjcf_inertial(export: Export) -> str:
    entries = inertia_entries(export)
    full = numbers((entries[key] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")), " ")
    position, mass = numbers(export.inertial.com, " "), number(export.inertial.mass)
    return f'<inertial pos="{position}" mass="{mass}" fullinertia="{full}"/>\n'
