"""A new effect is one file: the one that CONTRIBUTING.md shows, in a copy of the package, is identified and named."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands.running import refused
from files.recordings import BAGS, Recorded, altered

from geomid_ros.simulation import SimulationOptions, simulate

ROOT = Path(__file__).parents[1]
URDF = BAGS / "arm3.urdf"
NAME, UNIT = "quadratic_drag", "N m s^2/rad^2"
JOINT, DRAG = "joint2", 0.6
ESTIMATED = f"viscous_friction,coulomb_friction,effort_offset,{NAME}"


# One process for all, as to import the package takes longer than any.
RUN = """
import sys
from geomid_ros.commands.root import root
for line in sys.stdin:
    root.main(line.rstrip("\\n").split("\\t"), standalone_mode=False)
"""


@dataclass(frozen=True)
class Extended:
    """A copy of the package with one file more, a bag with the drag in it, and where results go."""

    package: Path
    bag: Path
    out: Path

    def geomid(self, *lines: tuple[str | Path, ...]) -> list[dict[str, Any]]:
        """What commands, each with the name of its folder and its arguments, print as JSON, one after the other."""
        given = [
            [command, self.bag, "--urdf", URDF, "--out", self.out / out, "--json", *arguments]
            for command, out, *arguments in lines
        ]
        path = os.pathsep.join([str(self.package), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
        run = subprocess.run(
            [sys.executable, "-c", RUN],
            input="".join("\t".join(map(str, line)) + "\n" for line in given),
            env=os.environ | {"PYTHONPATH": path},
            cwd=self.package,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        assert run.returncode == 0, run.stderr
        documents, text = [], run.stdout
        while text := text.lstrip():
            document, end = json.JSONDecoder().raw_decode(text)
            documents.append(document)
            text = text[end:]
        assert len(documents) == len(lines), run.stdout
        return documents


def recipe() -> tuple[Path, str]:
    """The path and the text of the file that CONTRIBUTING.md shows."""
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Add an effect")[2]
    ((path, text),) = re.findall(r"`(geomid_ros/[\w/]+\.py)`:\n\n```python\n(.*?)```", section, re.DOTALL)
    return Path(path), text


def with_drag(item: Recorded) -> Recorded:
    """A message of joints, of which one is in a fluid."""
    if item.topic != "/joint_states":
        return item
    joint = item.message.name.index(JOINT)
    effort = item.message.effort.copy()
    velocity = item.message.velocity[joint]
    effort[joint] += DRAG * velocity * abs(velocity)
    return item.changed(effort=effort)


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Extended:
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("effect")
    shutil.copytree(ROOT / "geomid_ros", folder / "package/geomid_ros")
    path, text = recipe()
    assert not (ROOT / path).exists()
    (folder / "package" / path).write_text(text, encoding="utf-8")
    simulate(folder / "dry", SimulationOptions(robot="arm3", seed=8, duration=20.0, hide=()))
    return Extended(folder / "package", altered(folder / "dry", folder / "bag", with_drag), folder)


@pytest.fixture(scope="module")
def said(extended: Extended) -> dict[str, dict[str, Any]]:
    """What the commands say, by their folders."""
    lines: list[tuple[str | Path, ...]] = [
        ("gap", "gap"),
        ("identify", "estimate", "--effects", ESTIMATED),
        ("identify", "again", "--model", extended.out / "gap/estimate.json", "--effects", "effort_offset"),
        ("identify", "default"),
    ]
    return {str(line[1]): document for line, document in zip(lines, extended.geomid(*lines), strict=True)}


@pytest.fixture(scope="module")
def found(said: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What the gap workflow says."""
    return said["gap"]


def coefficients(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The drag's entries in an estimate, by joint."""
    return {entry["joint"]: entry for entry in document["effects"] if entry["name"] == NAME}


def assert_is_the_drag(quantity: dict[str, Any]) -> None:
    assert quantity["unit"] == UNIT
    assert abs(quantity["value"] - DRAG) < min(3.0 * quantity["std"], 0.05 * DRAG)


def test_without_the_file_it_is_unknown(extended: Extended) -> None:
    message = refused("identify", extended.bag, "--urdf", URDF, "--out", extended.out / "no", "--effects", NAME)
    assert f"unknown effect '{NAME}'" in message


def test_it_is_identified(extended: Extended, said: dict[str, dict[str, Any]]) -> None:
    drags = coefficients(said["estimate"])
    assert len(drags) == 3
    assert_is_the_drag(drags.pop(JOINT))
    assert all(entry["value"] < 0.02 * DRAG for entry in drags.values())
    assert (extended.out / "estimate/identification.png").is_file()


def test_it_is_named(found: dict[str, Any]) -> None:
    assert found["verdict"] == "named"
    (finding,) = found["findings"]
    assert (finding["effect"], finding["joint"], finding["confidence"]) == (NAME, JOINT, "confident")
    assert finding["sentence"].startswith(f"Drag of a fluid at '{JOINT}': coefficient 0.")
    (quantity,) = finding["parameters"].items()
    assert quantity[0] == "coefficient"
    assert_is_the_drag(quantity[1])


def test_it_is_simulated_again(found: dict[str, Any]) -> None:
    """MJCF cannot say it, the sidecar does."""
    before, after = (found["resimulated"][when][JOINT] for when in ("before", "after"))
    assert before > 5.0 * after
    assert after < 1.5


def test_files_tell_it_and_a_later_run_starts_from_it(extended: Extended, said: dict[str, dict[str, Any]]) -> None:
    out = extended.out / "gap"
    assert f"#   {NAME}: effort coefficient v |v|" in (out / "effects.yaml").read_text()
    (entry,) = yaml.safe_load((out / "effects.yaml").read_text())["effects"]
    assert (entry["effect"], entry["joint"], entry["urdf"], entry["mjcf"]) == (NAME, JOINT, [], [])
    assert "Drag of a fluid" in (out / "report.html").read_text()
    again = coefficients(said["again"])
    assert list(again) == [JOINT]
    assert_is_the_drag(again[JOINT])


def test_it_is_not_identified_unless_asked_for(said: dict[str, dict[str, Any]]) -> None:
    """The list of defaults is not what lies in the folder."""
    assert not coefficients(said["default"])
