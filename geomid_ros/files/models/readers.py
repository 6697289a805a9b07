"""Programs that read robot descriptions, and the elements that each of them supports."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

URDF, MUJOCO, EXISTING_MJCF = "urdf", "mujoco", "mjcf_joints"
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
"""Elements of a whole robot's description that each reader supports, by the reader's name; see
:meth:`~geomid_ros.model.effects.ParameterForm.said_by`. Isaac's armature is in a file next to its URDF. An existing
MJCF of the user (:data:`EXISTING_MJCF`) supports the entries of its bodies and joints."""

READERS = tuple(reader for reader in ELEMENTS if reader != "moveit")
"""Readers with different files."""


def with_same_files(reader: str) -> str:
    """Reader of :data:`READERS` with the same files; ``reader`` itself if there is none."""
    return next((name for name in READERS if ELEMENTS[name] == ELEMENTS.get(reader)), reader)


DESCRIBED_FOR = tuple(reader for reader in ELEMENTS if reader != EXISTING_MJCF)
"""Readers for which a description of the whole robot is written."""
