"""Writes the tables of the reference from the code; with ``--check`` it only says whether they are stale."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import diagnostic_keys
import interface

from geomid_ros.session.configuration import PARAMETERS, Parameter

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs/pages/reference.md"
_BLOCK = re.compile(r"(<!-- table (\w+)[^\n]*-->\n).*?(<!-- end -->)", re.DOTALL)
_TYPES = {bool: "bool", float: "double", str: "string"}


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def code(text: str) -> str:
    """A name as it is typed."""
    return f"`{text}`"


def ros_type(parameter: Parameter) -> str:
    """The type of a parameter in ROS."""
    default = parameter.default
    return f"{_TYPES[type(default[0])]}[]" if isinstance(default, list) else _TYPES[type(default)]


def parameter_row(parameter: Parameter) -> list[str]:
    """Name, type, default, range, when it may change, meaning."""
    low, high = parameter.minimum, parameter.maximum
    limits = "" if low is None or high is None else f"{low:g} to {high:g}"
    return [
        code(parameter.name),
        ros_type(parameter),
        code(json.dumps(parameter.default)),
        limits,
        parameter.change,
        parameter.description,
    ]


def tables() -> dict[str, str]:
    """Every table by its name in the files."""
    found = interface.of_the_node()
    topics, services = ("topic", "type", "QoS", "what it is"), ("service", "type", "what it does")
    keys = ([code(status), code(key), meaning] for status, key, meaning in diagnostic_keys.rows())
    return {
        "inputs": table(topics, ([code(t.name), code(t.kind), t.qos, t.meaning] for t in found.inputs)),
        "outputs": table(topics, ([code(t.name), code(t.kind), t.qos, t.meaning] for t in found.outputs)),
        "services": table(services, ([code(s.name), code(s.kind), s.meaning] for s in found.services)),
        "of_every_node": table(
            ("name", "type", "direction"), ([code(e.name), code(e.kind), e.meaning] for e in found.of_every_node)
        ),
        "parameters": table(
            ("parameter", "type", "default", "range", "may change", "meaning"), map(parameter_row, PARAMETERS)
        ),
        "diagnostics": table(("status", "key", "meaning"), keys),
    }


def filled(text: str, by_name: Mapping[str, str]) -> str:
    """A document with its tables as they should be."""
    return _BLOCK.sub(lambda match: f"{match[1]}{by_name[match[2]]}{match[3]}", text)


def main() -> None:
    """Write the file, or check it: status 1 when it is stale."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, but fail when a table is stale")
    checking = parser.parse_args().check
    text = REFERENCE.read_text(encoding="utf-8")
    new = filled(text, tables())
    stale = new != text
    if stale:
        print(f"{REFERENCE.relative_to(ROOT)} {'is stale: make docs' if checking else 'is written'}")
    if stale and not checking:
        REFERENCE.write_text(new, encoding="utf-8")
    sys.exit(1 if checking and stale else 0)


if __name__ == "__main__":
    main()
