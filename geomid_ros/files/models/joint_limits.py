"""``joint_limits.yaml`` as MoveIt and ros2_control write it: limits of joints, beside those of a URDF."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.limits import JointLimits
from geomid_ros.files.parameter_file import read_yaml

_KINDS = ("velocity", "acceleration", "jerk", "effort")


def read_joint_limits(path: Path, joints: Collection[str]) -> dict[str, JointLimits]:
    """The limits of a robot's ``joints`` in a file, by name; other joints may be in it.

    Raises InputError naming the file and the key.
    """
    document = read_yaml(path, "file of joint limits")
    entries = document.get("joint_limits") if isinstance(document, dict) else None
    if not isinstance(entries, dict):
        raise InputError(f"{path}: has no 'joint_limits' by joint, as MoveIt's joint_limits.yaml has")
    if not set(entries) & set(joints):
        named = [str(name) for name in entries]
        raise InputError(f"{path}: {unknown_name('joint', named[0] if named else '', joints)}")
    return {name: _limits(entries[name], f"{path}: joint '{name}'") for name in joints if name in entries}


def _limits(entry: Any, where: str) -> JointLimits:
    if not isinstance(entry, dict):
        raise InputError(f"{where} is no mapping of limits")
    found = {kind: _number(entry, f"max_{kind}", f"has_{kind}_limits", where) for kind in _KINDS}
    for kind, value in found.items():
        if value is not None and not value > 0.0:
            raise InputError(f"{where}: max_{kind} is {value:g}, expected a number greater than zero")
    ends = {end: _number(entry, f"{key}_position", "has_position_limits", where) for end, key in _ENDS.items()}
    return JointLimits(**ends, **found)


_ENDS = {"lower": "min", "upper": "max"}


def _number(entry: Mapping[str, Any], key: str, switch: str, where: str) -> float | None:
    """The number of a limit; None where it is absent or switched off."""
    if entry.get(switch) is False or entry.get(key) is None:
        if entry.get(switch) is True:
            raise InputError(f"{where}: {switch} is true and {key} is absent; give it a number")
        return None
    value = entry[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key} is {value!r}, expected a finite number")
    return float(value)
