"""Who reads descriptions of robots, and which of their elements each takes."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

URDF, INTO = "urdf", "mjcf_joints"
ELEMENTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        URDF: ("urdf",),
        "moveit": ("urdf",),
        "isaac": ("urdf", "mjcf/joint/armature"),
        "gazebo": ("urdf", "gazebo"),
        "drake": ("urdf/link", "drake"),
        "mujoco": ("mjcf",),
        "mjcf_joints": ("mjcf/joint", "mjcf/body"),
    }
)
"""By the name of who reads a description of the whole robot, the elements that it takes; see
:meth:`~geomid_ros.model.effects.ParameterForm.said_by`. Isaac's armature stands in a file beside its URDF; an MJCF of
the user's own takes what its bodies and joints say (:data:`INTO`)."""

READERS = tuple(reader for reader in ELEMENTS if reader != "moveit")
"""Those whose files differ."""
DESCRIBED_FOR = tuple(reader for reader in ELEMENTS if reader != INTO)
"""Those that a description of a whole robot is written for."""
