"""Reading YAML exactly as rcl does: ROS parameter files, and ``joint_limits.yaml`` of MoveIt and ros2_control."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import yaml

from geomid_ros.errors import InputError, refusing, unknown_name
from geomid_ros.excitation.limits import JointLimits
from geomid_ros.files.disk import read_text
from geomid_ros.files.schema import MOST_ENTRIES
from geomid_ros.model.urdf_tree import MOST_URDF_BYTES


class _Loader(yaml.SafeLoader):
    """YAML with the number and boolean forms of rcl, so that ``1e-3`` is a number.

    Aliases are refused, as they can expand a small file beyond memory; so are tags, whose types rcl does not have.
    """

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 as the base class has it

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        where = f"line {event.start_mark.line + 1}"
        self._nodes += 1
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError(f"aliases are not allowed, {where}")
        if getattr(event, "tag", None) is not None:
            raise yaml.YAMLError(f"the tag {event.tag} is not allowed, {where}")
        if self._nodes > MOST_ENTRIES:
            raise yaml.YAMLError(f"more than {MOST_ENTRIES} values, {where}")
        return super().compose_node(parent, index)


for _kind, _form, _beginnings in (
    ("null", r"(~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("bool", r"(true|True|TRUE|false|False|FALSE|yes|Yes|YES|no|No|NO|on|On|ON|off|Off|OFF)$", list("tTfFyYnNoO")),
    ("int", r"[-+]?(0|[1-9][0-9]{0,30}|0x[0-9a-fA-F]{1,30})$", list("-+0123456789")),
    ("float", r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?$", list("-+.0123456789")),
    ("float", r"[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$", list("-+.")),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(_form), _beginnings)


def read_yaml(path: Path, what: str) -> Any:
    """Content of a YAML file; ``what`` names it in messages. Raises InputError naming the file."""
    text = read_text(path, what, MOST_URDF_BYTES)  # a parameter may contain a robot description
    with refusing(f"{path}: the {what} cannot be read", Exception):  # the parser raises many types of errors
        return yaml.load(text, _Loader)  # noqa: S506 it is a safe loader


def read_parameter_file(path: Path) -> dict[str, Any]:
    """Parameters of ``node_name: ros__parameters: ...`` by full name. Raises InputError naming the file."""
    document = read_yaml(path, "parameter file")
    nodes = list(document.values()) if isinstance(document, dict) else []
    sections = [node["ros__parameters"] for node in nodes if isinstance(node, dict) and "ros__parameters" in node]
    if len(sections) != 1 or not isinstance(sections[0], dict):
        raise InputError(f"{path}: expected one node with a 'ros__parameters' section, found {len(sections)}")
    return _flat(sections[0])


def _flat(tree: Mapping[Any, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat


_LIMITS = ("velocity", "acceleration", "jerk", "effort")


def read_joint_limits(path: Path, joints: Collection[str]) -> dict[str, JointLimits]:
    """Limits of a robot's ``joints`` in a file, by name; the file may have other joints, too.

    Raises InputError naming the file and the key.
    """
    document = read_yaml(path, "file of joint limits")
    entries = document.get("joint_limits") if isinstance(document, dict) else None
    if not isinstance(entries, dict):
        raise InputError(f"{path}: has no 'joint_limits' by joint, as MoveIt's joint_limits.yaml has")
    if not set(entries) & set(joints):
        names = [str(name) for name in entries]
        raise InputError(f"{path}: {unknown_name('joint', names[0] if names else '', joints)}")
    return {name: _limits_of(entries[name], f"{path}: joint '{name}'") for name in joints if name in entries}


def _limits_of(entry: Any, where: str) -> JointLimits:
    if not isinstance(entry, dict):
        raise InputError(f"{where} is not a mapping of limits")
    limits = {kind: _limit(entry, f"max_{kind}", f"has_{kind}_limits", where) for kind in _LIMITS}
    for kind, value in limits.items():
        if value is not None and not value > 0.0:
            raise InputError(f"{where}: max_{kind} is {value:g}, expected a number greater than zero")
    ends = {end: _limit(entry, f"{key}_position", "has_position_limits", where) for end, key in _ENDS.items()}
    return JointLimits(**ends, **limits)


_ENDS = {"lower": "min", "upper": "max"}


def _limit(entry: Mapping[str, Any], key: str, switch: str, where: str) -> float | None:
    """Value of a limit; None if it is absent or switched off."""
    if entry.get(switch) is False or entry.get(key) is None:
        if entry.get(switch) is True:
            raise InputError(f"{where}: {switch} is true and {key} is absent; give it a number")
        return None
    value = entry[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key} is {value!r}, expected a finite number")
    return float(value)
