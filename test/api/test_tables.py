"""Tables as CSV: what a spreadsheet reads is what the document says."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from geomid_ros.api.rebuild import tables, write_tables

EVIL = 'a "link", with; commas\nand lines'
LINK = {
    "name": EVIL,
    "merged": ["tool", "hand"],
    "mass": 1.25,
    "com": [0.1, -0.2, 0.3],
    "inertia": [[1.0, 2.0, 4.0], [2.0, 3.0, 5.0], [4.0, 5.0, 6.0]],
    "std": {"mass": 0.01, "com": [0.001, 0.002, 0.003], "inertia": [[0.1, 0.2, 0.4], [0.2, 0.3, 0.5], [0.4, 0.5, 0.6]]},
    "distance_from_prior": 0.5,
    "from_data": 0.75,
    "cannot_tell": ["com z", "Ixy"],
}
PARAMETERS = {"level": {"value": 0.5, "std": 0.1, "unit": "N m"}, "excess": {"value": 0.2, "std": None, "unit": "N m"}}
FRICTION = {"effect": "stribeck_friction", "joint": "joint2", "link": "", "parameters": PARAMETERS}
ESTIMATE: dict[str, Any] = {
    "links": [LINK],
    "urdf_masses": {EVIL: 1.5},
    "effects": [],
    "added": [FRICTION],
    "channels": [{"channel": "joint1", "unit": "N m", "judged_on": "held-out data", "urdf": 2.0, "identified": 1.0}],
}


def read(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text, newline="")))


def test_a_link_has_all_its_numbers(tmp_path: Path) -> None:
    write_tables(tmp_path, tables(ESTIMATE))
    (row,) = read((tmp_path / "links.csv").read_bytes().decode())
    assert row["link"] == EVIL
    assert row["merged"].split(";") == ["tool", "hand"]
    assert float(row["urdf_mass"]) == 1.5
    assert [float(row[name]) for name in ("mass", "com_x", "com_y", "com_z")] == [1.25, 0.1, -0.2, 0.3]
    assert [float(row[name]) for name in ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert [float(row[f"std_{name}"]) for name in ("mass", "com_z", "Iyz")] == [0.01, 0.003, 0.5]
    assert row["not_identifiable"].split(";") == ["com z", "Ixy"]
    (row,) = read((tmp_path / "channels.csv").read_text())
    assert row == {key: str(value) for key, value in ESTIMATE["channels"][0].items()}


def test_findings_of_a_gap(tmp_path: Path) -> None:
    finding = FRICTION | {"confidence": "confident", "share": 0.4, "sentence": "Stribeck friction, with a comma"}
    (path,) = write_tables(tmp_path, tables({"findings": [finding]}))
    assert path.name == "findings.csv"
    rows = read(path.read_text())
    assert [(row["parameter"], row["confidence"], row["share"], row["sentence"]) for row in rows] == [
        ("level", "confident", "0.4", "Stribeck friction, with a comma"),
        ("excess", "confident", "0.4", "Stribeck friction, with a comma"),
    ]
