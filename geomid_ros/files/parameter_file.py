"""Reading YAML, ROS parameter files above all: what rcl reads, and no more of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from geomid_ros.errors import InputError

_MOST_CHARACTERS = 10_000_000


class _Loader(yaml.SafeLoader):
    """YAML without aliases, which can make a small file as large as memory, and with ``1e-3`` a number, as in rcl."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError(f"aliases are not allowed, line {self.line + 1}")
        return super().compose_node(parent, index)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_yaml(path: Path, what: str) -> Any:
    """The content of a YAML file; ``what`` it is for messages. Raises InputError naming the file."""
    try:
        text = path.read_text(encoding="utf-8")
        if len(text) > _MOST_CHARACTERS:
            raise InputError(f"{path}: larger than {_MOST_CHARACTERS / 1e6:g} MB, not a {what}")
        return yaml.load(text, _Loader)  # noqa: S506 it is a safe loader
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        raise InputError(f"{path}: the {what} cannot be read ({' '.join(str(error).split())})") from error


def read_parameter_file(path: Path) -> dict[str, Any]:
    """The parameters of ``node_name: ros__parameters: ...`` by full name. Raises InputError naming the file."""
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
