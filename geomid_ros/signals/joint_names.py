"""What is wrong with the joints' names in messages, in words that lead to what mends it."""

from __future__ import annotations

from collections.abc import Sequence

from geomid_ros.signals.limits import MOST_NAMES

NOBODY = (
    "if nobody publishes it, name it in the parameter locked_joints (--lock); if another node does, set "
    "merge_joint_states"
)
"""What to do about a joint that is missing."""


def missing_joint(joints: Sequence[str], names: Sequence[str]) -> str:
    """Why messages with these names are not of all joints; empty if they are.

    Args:
        joints: the robot's.
        names: those in the messages.
    """
    present = set(names)
    missing = next((joint for joint in joints if joint not in present), None)
    if missing is None:
        return ""
    sentence = f"joint '{missing}' is missing"
    if prefix := _prefix(joints, names):
        return f"{sentence}: the messages' names have the prefix '{prefix}'. Give the URDF with it (tf_prefix)"
    if prefix := _prefix(names, joints):
        return (
            f"{sentence}: the URDF's names have the prefix '{prefix}', the messages' do not. Give the URDF without it"
        )
    if present.isdisjoint(joints):
        quoted = ", ".join(f"'{name}'" for name in names[:MOST_NAMES])
        return f"{sentence}: none of the messages' names is a joint of this URDF ({quoted} ...)"
    strange = next((name for name in names if name not in joints), None)
    other = f"; or is it '{strange}'?" if strange else ""
    return f"{sentence}: {NOBODY}{other}"


def _prefix(plain: Sequence[str], prefixed: Sequence[str]) -> str:
    """The one beginning with which all ``plain`` names are among the ``prefixed``; empty if there is none."""
    first = plain[0] if plain else ""
    beginnings = (name.removesuffix(first) for name in prefixed if first and name.endswith(first))
    every = set(prefixed)
    return next((start for start in beginnings if start and all(start + name in every for name in plain)), "")
