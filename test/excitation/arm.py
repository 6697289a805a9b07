"""A small arm with shapes, and what a search needs of it."""

from __future__ import annotations

from pathlib import Path

from geomid_ros.session.configuration import Configuration
from geomid_ros.session.excitation import DesignTask, design_task
from geomid_ros.session.options import MotionOptions

_LINK = """
  <link name="{name}">
    <inertial><origin xyz="0 0 {half}"/><mass value="{mass}"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/></inertial>
    <collision><origin xyz="0 0 {half}"/><geometry><box size="0.06 0.06 {length}"/></geometry></collision>
  </link>"""
_JOINT = """
  <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 {height}"/>
    <axis xyz="{axis}"/>{limit}</joint>"""
LIMIT = '<limit lower="-2.5" upper="2.5" effort="60" velocity="2"/>'


def urdf(limit: str = LIMIT, kind: str = "revolute") -> str:
    """Three joints about z, y and y; ``limit`` and ``kind`` are those of the last."""
    parts = [
        '<robot name="small"><link name="base">',
        '<collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>',
        *(
            _LINK.format(name=name, mass=mass, length=length, half=0.5 * length)
            for name, mass, length in (("turret", 3.0, 0.3), ("upper", 2.0, 0.4), ("fore", 1.0, 0.4))
        ),
        _JOINT.format(name="j1", kind="revolute", parent="base", child="turret", height=0.1, axis="0 0 1", limit=LIMIT),
        _JOINT.format(
            name="j2", kind="revolute", parent="turret", child="upper", height=0.35, axis="0 1 0", limit=LIMIT
        ),
        _JOINT.format(name="j3", kind=kind, parent="upper", child="fore", height=0.45, axis="0 1 0", limit=limit),
        "</robot>",
    ]
    return "".join(parts)


def small_task(wish: MotionOptions | None = None, text: str | None = None) -> DesignTask:
    """The search for a motion of this arm."""
    asked = wish or MotionOptions(duration=6.0, repeats=1)
    return design_task(text or urdf(), Path("small.urdf"), Configuration({}, "test"), asked)
