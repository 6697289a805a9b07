"""``geomid prior``: a URDF without usable inertials gets some, and nothing else of it changes."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib.metadata import files
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model import urdf_tree
from geomid_ros.model.robot import Robot

from .running import geomid, refused

INERTIAL = re.compile(r"<inertial\b.*?</inertial\s*>\s*", re.DOTALL)
ARM = """<robot name="arm">
  <link name="base"><visual><geometry><box size="1 1 0.1"/></geometry></visual></link>
  <link name="upper"><!-- keep me -->
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <collision><geometry><box size="0.1 0.1 0.5"/></geometry></collision></link>
  <link name="fore"/>
  <link name="tip"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit effort="1" velocity="1" lower="-1" upper="1"/></joint>
  <joint name="j2" type="continuous"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/></joint>
  <joint name="j3" type="continuous"><parent link="fore"/><child link="tip"/><axis xyz="1 0 0"/></joint>
</robot>
"""


def example(name: str) -> Path:
    """The one URDF of example-robot-data whose path ends with ``/name``."""
    (file,) = (f for f in files("example-robot-data") or () if f.as_posix().endswith(f"/{name}"))
    return Path(str(file.locate())).resolve()


def beside(source: Path, text: str, folder: Path) -> tuple[Path, str]:
    """A changed URDF elsewhere, and the option that says where its package is."""
    path = folder / source.name
    path.write_text(text)
    package = next(parent for parent in source.parents if parent.name == "example-robot-data")
    return path, f"example-robot-data={package}"


def prior(urdf: Path, mass: float, folder: Path, *arguments: str | Path, drawn: bool = False) -> tuple[str, str, str]:
    """The URDF that is written, the output and the warnings."""
    out = folder / "out" / "prior.urdf"
    with pytest.MonkeyPatch.context() as patch:
        if not drawn:
            patch.setattr("geomid_ros.report.pictures.prior_picture", lambda *_: None)
        result = geomid("prior", urdf, "--mass", str(mass), "--out", out, *arguments)
    assert result.exit_code == 0, result.output
    return out.read_text(), result.stdout, result.stderr


def parameters(text: str) -> dict[str, np.ndarray]:
    return urdf_tree.parse(text, "prior").inertials


def total_mass(text: str) -> float:
    """By pinocchio, with a base that moves: of one that stands it does not count the root."""
    return float(pin.computeTotalMass(pin.buildModelFromXML(text, pin.JointModelFreeFlyer())))


@pytest.mark.parametrize("name", ["ur5_gripper.urdf", "panda.urdf"])
def test_a_robot_without_inertials_becomes_possible(name: str, tmp_path: Path) -> None:
    source = example(name)
    stripped = INERTIAL.sub("", source.read_text())
    assert "inertial" not in stripped
    urdf, package = beside(source, stripped, tmp_path)
    text, shown, warnings = prior(urdf, 21.5, tmp_path, "--package-path", package, drawn=True)
    assert re.sub(r"\n    <inertial>.*?</inertial>", "", text, flags=re.DOTALL) == stripped
    assert total_mass(text) == pytest.approx(21.5, rel=1e-8)
    found = parameters(text)
    assert all(pseudo_inertia.is_body(body) for body in found.values())
    robot = Robot(text)
    assert {joint.child for joint in robot.tree.joints if joint.type != "fixed"} <= set(robot.body_names)
    assert "21.500" in shown
    assert "missing" in shown
    assert "refuse" not in warnings
    assert (tmp_path / "out/prior.png").read_bytes().startswith(b"\x89PNG")


def written(text: str, folder: Path) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def test_links_have_the_density_of_the_whole_but_for_those_that_are_kept(tmp_path: Path) -> None:
    text, _, warnings = prior(written(ARM, tmp_path), 10.0, tmp_path)
    volumes = {"base": 0.1, "upper": 0.005, "tip": 4e-3 * np.pi / 3}
    for name, volume in volumes.items():
        assert parameters(text)[name][0] == pytest.approx(10.0 * volume / sum(volumes.values()), rel=1e-8)
    assert warnings == "Warning: massless links, which is right only between the axes of one joint: fore\n"
    text, shown, _ = prior(written(ARM, tmp_path), 10.0, tmp_path, "--keep", "upper, base")
    assert "upper       kept" in re.sub(" {3,}", "       ", shown)
    assert text.startswith(ARM.partition('<link name="tip">')[0])
    assert parameters(text)["tip"][0] == pytest.approx(9.0, rel=1e-8)
    assert "base" not in parameters(text)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (re.sub('<link name="tip">.*?</link>', '<link name="tip"/>', ARM), "neither a shape nor a mass: fore, tip"),
        (ARM.replace("0.1 0.1 0.5", "100 100 500"), "a density of 2e-06 kg/m³ is out of range for a machine"),
    ],
)
def test_what_cannot_be_right_is_spoken_of(change: str, said: str, tmp_path: Path) -> None:
    assert said in prior(written(change, tmp_path), 10.0, tmp_path)[2]


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        (lambda text: text, "mass beyond its shape"),
        (lambda text: text.replace('<mass value="1"/>', '<mass value="0"/>'), "zero mass"),
        (lambda text: text.replace('<mass value="1"/>', '<mass value="one"/>'), "unreadable"),
        (lambda text: text.replace('ixx="1"', 'ixx="3"'), "impossible"),
        (lambda text: INERTIAL.sub("", text), "missing"),
        (lambda text: text.replace('="1" i', '="0.002" i').replace('izz="1"', 'izz="0.0003"'), "far too light"),
    ],
)
def test_the_table_says_what_was_wrong(change: Callable[[str], str], verdict: str, tmp_path: Path) -> None:
    text, shown, _ = prior(written(change(ARM), tmp_path), 100.0, tmp_path, "--keep", "base")
    (line,) = (line for line in shown.splitlines() if line.startswith(" upper"))
    assert line.rstrip().endswith(verdict)
    assert pseudo_inertia.is_body(parameters(text)["upper"])


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (str, ["--keep", "uper"], "unknown link to keep 'uper'. Did you mean 'upper'? Valid: base, fore, tip, upper"),
        (str, ["--package-path", "x"], "'x' is not of the form NAME=FOLDER"),
        (lambda text: text.replace('<mass value="1"/>', ""), ["--keep", "upper"], "link 'upper': its <mass> is absent"),
        (
            lambda text: text.replace('<mass value="1"/>', '<mass value="9"/>'),
            ["--keep", "upper"],
            "already have 9.000 kg",
        ),
        (lambda text: text.replace("<box", "<mesh"), [], "the mesh '' was not found"),
        (lambda text: text.replace('child link="fore"', 'child link="four"'), [], "'four', which does not exist"),
    ],
)
def test_refusals(change: Callable[[str], str], arguments: list[str], message: str, tmp_path: Path) -> None:
    out = tmp_path / "prior.urdf"
    text = refused("prior", written(change(ARM), tmp_path), "--mass", "5", "--out", out, *arguments)
    assert message in text
    assert not out.exists()
