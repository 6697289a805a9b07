"""The ready configurations: every file is valid, typed as ROS needs it, explained, and good for its robot."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands.running import geomid
from files.recordings import Recorded, altered

from geomid_ros.checks.verdict import STATUS, USABLE
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.session.configuration import Configuration, find_parameter

ROOT = Path(__file__).parents[1]
README = (ROOT / "config/README.md").read_text(encoding="utf-8")
MEASURED = ROOT.parent / "shared" / "data"
SHIPPED = sorted(path for path in (ROOT / "config").glob("*.yaml") if path.name != "geomid.yaml")
EXAMPLE = re.compile(r"^( *)# ( *(?:# .*|[a-z_0-9.]+:(?: \S.*)?))$")  # a parameter that is only shown

needs_recordings = pytest.mark.skipif(not MEASURED.is_dir(), reason=f"the measured recordings are not at {MEASURED}")


def in_force(path: Path, folder: Path) -> Path:
    """A copy of a parameter file with everything in force that it only shows."""
    copy = folder / path.name
    lines = (EXAMPLE.sub(r"\1\2", line) for line in path.read_text(encoding="utf-8").splitlines())
    copy.write_text("\n".join(lines), encoding="utf-8")
    return copy


def leaves(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values by full name."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return found


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_a_file_is_valid_typed_and_explained(path: Path, tmp_path: Path) -> None:
    """As it is, and with what it shows. The node takes no integer for a real number, and cannot tell the type of an
    empty list; topics are relative, so that they move with the node into a namespace."""
    text, shown = path.read_text(encoding="utf-8"), in_force(path, tmp_path)
    configuration = Configuration.read(shown)
    assert configuration.given_values
    assert Configuration.read(path).given_values.keys() <= configuration.given_values.keys()
    for name, value in leaves(yaml.safe_load(shown.read_text())["/**"]["ros__parameters"]).items():
        default = find_parameter(name).default
        assert type(value) is type(default), name
        if isinstance(value, list):
            assert {type(entry) for entry in value} == {type(default[0])}, name
    assert all(re.fullmatch(r"[a-z0-9_]+(/[a-z0-9_]+)*", sensor.topic) for sensor in configuration.sensors)
    assert f"ros2 launch geomid_ros geomid.launch.py config:={path.name}" in text
    (heading,) = re.findall(r'Read first: "(.*)" in config/README.md', text)
    assert f"\n## {heading}\n" in README
    assert f"`{path.name}`" in README
    assert list(unexplained(text.splitlines())) == []


def unexplained(lines: list[str]) -> Iterator[str]:
    """Lines where a key stands for the first time without a comment above it, or above what it is part of."""
    seen: set[str] = set()
    for number, line in enumerate(lines):
        key, _, value = line.strip().partition(":")
        if line.strip().startswith("#") or not value or key in seen:
            continue
        seen.add(key)
        above = number - 1
        while lines[above].endswith(":") and not lines[above].strip().startswith("#"):
            above -= 1
        if not lines[above].strip().startswith("#"):
            yield line.strip()


def test_a_frame_may_have_another_name_in_messages() -> None:
    values = {"wrenches": ["wrist"], "wrench.wrist.frame": "tool0", "wrench.wrist.frame_id": "tool0_controller"}
    sensor = WrenchSensor("wrist", "tool0", "mounted", frame_id="tool0_controller")
    assert Configuration(values).sensors == [sensor]
    assert Configuration().with_sensors([sensor]).sensors == [sensor]


def in_amperes(bag: Path, folder: Path) -> Path:
    """A recording of the UR10 as its driver sends it."""
    gains = Configuration.read(ROOT / "config/ur.yaml").signals([]).effort_gain
    assert isinstance(gains, dict)

    def divided(item: Recorded) -> Recorded:
        return item.changed(effort=item.message.effort / np.array([gains[joint] for joint in item.message.name]))

    return altered(bag, folder, divided)


def identified(bag: Path, urdf: Path, config: str, out: Path, *more: str) -> dict[str, float]:
    """RMS residuals, summed over the channels: of the URDF, and of what is found, on the end of the bag.

    The result is usable.
    """
    arguments = ("--config", ROOT / "config" / config, "--hold-out", "0.3", "--json", "--out", out, *more)
    result = geomid("identify", bag, "--urdf", urdf, *arguments)
    assert result.exit_code == STATUS[USABLE], result.output
    rms = json.loads(result.stdout)["rms"]
    return {kind: sum(rms[kind].values()) for kind in ("nominal", "held_out")}


@needs_recordings
@pytest.mark.usefixtures("found_only")
def test_a_measured_universal_robot(tmp_path: Path) -> None:
    """Its efforts were written as N m; the driver gives A."""
    folder = MEASURED / "ur10_unisa_rosbag2"
    bag = in_amperes(folder / "ur10_exciting_trajectory", tmp_path / "bag")
    found = identified(bag, folder / "ur10.urdf", "ur.yaml", tmp_path / "out")
    assert found["held_out"] < 0.2 * found["nominal"]


@needs_recordings
@pytest.mark.usefixtures("found_only")
def test_a_measured_franka(tmp_path: Path) -> None:
    """Its driver called the joints otherwise than its description did. Its joint states were republished, which cost
    half of the accuracy while their stamps were believed."""
    folder = MEASURED / "panda_unisa_rosbag2"
    urdf = tmp_path / "fer.urdf"
    urdf.write_text((folder / "panda_nohand.urdf").read_text().replace("panda_joint", "fer_joint"))
    found = identified(folder / "panda_exciting_trajectory", urdf, "franka.yaml", tmp_path / "out")
    assert found["held_out"] < 0.45 * found["nominal"]
    links = json.loads((tmp_path / "out/estimate.json").read_text())["links"]
    assert sum(link["mass"] for link in links) == pytest.approx(16.1, rel=0.1)


@needs_recordings
@pytest.mark.usefixtures("found_only")
def test_a_measured_person(tmp_path: Path) -> None:
    folder = MEASURED / "human_forceplate"
    wrench = ("--wrench", "/wrench:odom:external")
    found = identified(folder / "first_60s", folder / "human_94kg.urdf", "force_plate.yaml", tmp_path / "out", *wrench)
    assert found["held_out"] < 0.7 * found["nominal"]
