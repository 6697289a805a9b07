"""A new effect of any kind is one file: here in a copy of the package.

The file that CONTRIBUTING.md shows and those of ``test/new_effects`` are put into it. What they describe is added to
the messages of a simulated robot, by formulas of this file.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands.running import NO_CHOICE
from files.recordings import BAGS, QUICK, Recorded, recorded, write_bag

from geomid_ros.simulation.description import WRIST_FRAME
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate
from geomid_ros.types import FloatArray

ROOT = Path(__file__).parents[1]
OTHERS = Path(__file__).parent / "new_effects"
URDF = BAGS / "arm3.urdf"
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
WRENCH = f"/wrench:{WRIST_FRAME}:mounted"
# Runs commands, of which each line has the arguments in JSON, and whether to draw; prints what each printed.
DRIVER = """
import json, sys
import pytest
from click.testing import CliRunner
from commands.running import undrawn
from geomid_ros.commands import root
for line in sys.stdin:
    arguments, drawn = json.loads(line)
    with pytest.MonkeyPatch.context() as patch:
        if not drawn:
            undrawn(patch)
        result = CliRunner().invoke(root, arguments, catch_exceptions=False)
    assert result.exit_code == 0 or "the file cannot represent " in result.output, result.output
    print(json.dumps(result.stdout), flush=True)
"""
Planted = Callable[[FloatArray, FloatArray], FloatArray]
"""What is added to the efforts ``(J,)`` or to the wrench ``(6,)``, from position and velocity ``(J,)``."""


@dataclass(frozen=True)
class Kind:
    """A new effect with the true values of its parameters, at the ``place`` of that name."""

    name: str
    label: str
    place: str
    true: Mapping[str, float]
    units: Mapping[str, str]
    planted: Planted
    sensor: bool = False

    @property
    def where(self) -> str:
        """As tables say it."""
        return f"at {self.place}" if self.place else "of the whole robot"


def at_second(effort: Callable[[float], float]) -> Planted:
    return lambda _, v: np.array([0.0, effort(v[1]), 0.0])


CABLE = {"fx": 2.0, "fy": -1.0, "fz": 1.5, "tx": 0.1, "ty": 0.2, "tz": -0.15}
SLIP = np.array([0.0, 1.0, -1.0])
KINDS = {
    "one joint": Kind(
        "gear_ripple",
        "Gear ripple",
        "joint2",
        {"amplitude": 0.6},
        {"amplitude": "N m"},
        lambda q, _: np.array([0.0, 0.6 * np.sin(5.0 * q[1]), 0.0]),
    ),
    "a constant": Kind(
        "shear_thinning",
        "A lubricant that grows thin",
        "joint2",
        {"coefficient": 3.0, "speed": 0.5},
        {"coefficient": "N m s/rad", "speed": "rad/s"},
        at_second(lambda v: 3.0 * v / (1.0 + (v / 0.5) ** 2)),
    ),
    "two joints": Kind(
        "coaxial_friction",
        "Friction between two shafts",
        "joint2+joint3",
        {"coefficient": 0.3},
        {"coefficient": "N m s^2/rad^2"},
        lambda _, v: 0.3 * (v[1] - v[2]) * abs(v[1] - v[2]) * SLIP,
    ),
    "whole robot": Kind(
        "supply_sag",
        "A supply that sags",
        "",
        {"coefficient": 0.2},
        {"coefficient": "N m s^2/rad^2"},
        lambda _, v: 0.2 * v * np.sqrt(v @ v),
    ),
    "sensor": Kind(
        "cable_pull",
        "A cable that pulls at the wrench sensor",
        "/wrench",
        CABLE,
        {axis: "N/rad" if axis[0] == "f" else "N m/rad" for axis in CABLE},
        lambda q, _: q[0] * np.array(list(CABLE.values())),
        sensor=True,
    ),
}


# To draw takes longer than all the rest, and to look for a gap again as long: of one effect.
DRAWN = "gear_ripple"


def recipe() -> tuple[Path, str]:
    """The path and the text of the file that CONTRIBUTING.md shows."""
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Add an effect")[2]
    ((path, text),) = re.findall(r"`(geomid_ros/[\w/]+\.py)`:\n\n```python\n(.*?)```", section, re.DOTALL)
    return Path(path), text


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a copy of the package, with a file more for each effect."""
    folder = tmp_path_factory.mktemp("package")
    shutil.copytree(ROOT / "geomid_ros", folder / "geomid_ros")
    path, text = recipe()
    assert not (ROOT / path).exists()
    (folder / path).write_text(text, encoding="utf-8")
    for file in OTHERS.glob("*.py"):
        shutil.copy(file, folder / path.parent)
    names = [path.stem, *(file.stem for file in OTHERS.glob("*.py"))]
    assert sorted(names) == sorted(kind.name for kind in KINDS.values())
    return folder


@dataclass(frozen=True)
class Driver:
    """A process of the copied package, which runs one command after the other."""

    process: subprocess.Popen[str]
    errors: Path

    def printed(self, arguments: list[str], drawn: bool) -> str:
        """What a command prints."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(json.dumps([arguments, drawn]), file=self.process.stdin, flush=True)
        answer = self.process.stdout.readline()
        assert answer, self.errors.read_text()
        return str(json.loads(answer))


@pytest.fixture(scope="module")
def driver(package: Path) -> Iterator[Driver]:
    folders = filter(None, (str(package), str(ROOT / "test"), os.environ.get("PYTHONPATH")))
    path, errors = os.pathsep.join(folders), package / "log"
    with (
        errors.open("w") as log,
        subprocess.Popen(
            [sys.executable, "-c", DRIVER],
            env=os.environ | {"PYTHONPATH": path},
            cwd=package,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        ) as process,
    ):
        yield Driver(process, errors)


@pytest.fixture(scope="module")
def dry(tmp_path_factory: pytest.TempPathFactory) -> list[Recorded]:
    """The messages of a robot without any effects."""
    pytest.importorskip("mujoco")
    bag = tmp_path_factory.mktemp("dry") / "bag"
    simulate(
        bag,
        SimulationOptions(robot="arm3", seed=8, duration=14.0, longest_step=QUICK, hide=(), wrench_frame=WRIST_FRAME),
    )
    return recorded(bag)


@dataclass(frozen=True)
class Round:
    """What the commands of the copied package made of a recording with an effect in it."""

    kind: Kind
    driver: Driver
    folder: Path

    @cached_property
    def printed(self) -> dict[str, str]:
        """What each command printed."""
        known = ("--model", self.folder / "gap/estimate.json")
        commands = {
            "gap": self._command("gap", "gap"),
            "identify": self._command(
                "identify", "identify", *NO_CHOICE, "--effects", f"effort_offset,{self.kind.name}"
            ),
            "later": self._command("identify", "later", *known, *NO_CHOICE, "--effects", "effort_offset"),
        }
        drawn = {"gap", "identify"} if self.kind.name == DRAWN else set()
        if drawn:
            commands["again"] = self._command("gap", "again", *known)
        return {name: self.driver.printed(arguments, name in drawn) for name, arguments in commands.items()}

    def _command(self, command: str, out: str, *arguments: str | Path) -> list[str]:
        wrench = ("--wrench", WRENCH) if self.kind.sensor else ()
        return [
            *map(str, (command, self.folder / "bag", "--urdf", URDF, "--out", self.folder / out, *wrench, *arguments))
        ]

    def document(self, out: str, name: str) -> dict[str, Any]:
        """A file of results."""
        assert self.printed
        found: dict[str, Any] = json.loads((self.folder / out / name).read_text())
        return found

    def estimated(self, out: str) -> dict[str, dict[str, dict[str, Any]]]:
        """The effect's parameters in an estimate, by its place: of one, or of several."""
        document = self.document(out, "estimate.json")
        ((first, *_),) = [list(self.kind.true)]
        single = {e["joint"]: {first: e} for e in document["effects"] if e["name"] == self.kind.name}
        several = {e["joint"]: e["parameters"] for e in document["added"] if e["effect"] == self.kind.name}
        return single | several

    def assert_true(self, parameters: Mapping[str, Mapping[str, Any]], *, constants: bool = True) -> None:
        """Compare with what was planted."""
        assert parameters.keys() == self.kind.true.keys()
        for name, true in self.kind.true.items():
            assert parameters[name]["unit"] == self.kind.units[name]
            if constants or name != "speed":
                assert abs(parameters[name]["value"] - true) < 0.06 * abs(true)


@pytest.fixture(scope="module", params=KINDS)
def found(
    request: pytest.FixtureRequest, driver: Driver, dry: list[Recorded], tmp_path_factory: pytest.TempPathFactory
) -> Round:
    kind, folder = KINDS[request.param], tmp_path_factory.mktemp("new")
    states = {item.time: item.message for item in dry if item.topic == "/joint_states"}

    def changed(item: Recorded) -> Recorded:
        if item.topic != ("/wrench" if kind.sensor else "/joint_states") or item.time not in states:
            return item
        state = states[item.time]
        order = [state.name.index(f"joint{number}") for number in (1, 2, 3)]
        added = kind.planted(state.position[order], state.velocity[order])
        if kind.sensor:
            return item.changed(wrench=with_wrench(item.message.wrench, added))
        effort = state.effort.copy()
        effort[order] += added
        return item.changed(effort=effort)

    write_bag(folder / "bag", map(changed, dry))
    return Round(kind, driver, folder)


def with_wrench(wrench: Any, added: FloatArray) -> Any:
    parts = {part: getattr(wrench, part) for part in ("force", "torque")}
    types = {part: type(vector) for part, vector in parts.items()}
    sums = {
        part: types[part](*(getattr(v, axis) + more for axis, more in zip("xyz", extra, strict=True)))
        for (part, v), extra in zip(parts.items(), np.split(added, 2), strict=True)
    }
    return type(wrench)(**sums)


def test_it_is_identified(found: Round) -> None:
    """At each of its places, and at one of them it is there."""
    estimated = found.estimated("identify")
    found.assert_true(estimated.pop(found.kind.place), constants=False)
    first, *_ = found.kind.true.items()
    assert all(abs(parameters[first[0]]["value"]) < 0.05 * first[1] for parameters in estimated.values())
    assert (found.folder / "identify/identification.png").is_file()


def test_it_is_named(found: Round) -> None:
    """With its place and its parameters, in all files; MJCF cannot say it, the sidecar does."""
    document, sidecar = found.document("gap", "gap.json"), (found.folder / "gap/effects.yaml").read_text()
    assert document["verdict"] == "named"
    (finding,), (entry,) = document["findings"], yaml.safe_load(sidecar)["effects"]
    place = finding["effect"], finding["joint"], finding["confidence"]
    assert place == (found.kind.name, found.kind.place, "confident")
    assert finding["sentence"].startswith(found.kind.label)
    assert f"#   {found.kind.name}: " in sidecar
    assert (entry["effect"], entry.get("joint", "")) == (found.kind.name, found.kind.place)
    assert entry["urdf"] == entry["mjcf"] == []
    for parameters in (finding["parameters"], entry["parameters"], found.estimated("gap")[found.kind.place]):
        found.assert_true(parameters)
    worst = {when: max(document["resimulated"][when].values()) for when in ("before", "after")}
    assert worst["before"] > 5.0 * worst["after"]
    assert worst["after"] < 1.6


def test_a_later_run_starts_from_it(found: Round) -> None:
    if found.kind.name == DRAWN:
        again = found.document("again", "gap.json")
        assert (again["verdict"], again["findings"]) == ("no gap", [])
        found.assert_true(found.estimated("again")[found.kind.place])
    assert list(found.estimated("later")) == [found.kind.place]
    found.assert_true(found.estimated("later")[found.kind.place])


def test_tables_and_pages_show_it(found: Round) -> None:
    name = found.kind.name.replace("_", " ")
    assert found.printed
    if found.kind.name == DRAWN:
        assert name in (found.folder / "gap/report.html").read_text().lower()
    for command in ("gap", "identify", "later"):
        text = " ".join(found.printed[command].lower().split())
        first, _, second = name.partition(" ")
        assert name in text or (first in text and second in text), command
    assert found.kind.where in " ".join(found.printed["gap"].split())
