"""Limits on what comes from outside, beside bags: what breaks one is refused by name before it costs much."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.files.models.effects_file import read_sidecar
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.model import urdf_tree
from geomid_ros.model.robot import Robot
from geomid_ros.session.configuration import Configuration

from .recordings import BAGS

ROOT = Path(__file__).parents[2]
ARM3 = (BAGS / "arm3.urdf").read_text(encoding="utf-8")


def nested(depth: int) -> str:
    return ARM3.replace("</robot>", "<x>" * depth + "</x>" * depth + "</robot>")


DESCRIPTIONS: dict[str, tuple[str, str]] = {
    "underscores": (ARM3.replace('<mass value="3"/>', '<mass value="1_0"/>'), 'value="1_0".*finite'),
    "two inertials": (ARM3.replace("</inertial>", "</inertial><inertial/>", 1), "more than one <inertial>"),
    "many elements": (ARM3.replace("</robot>", "<x/>" * 200_000 + "</robot>"), "more than 200000 elements"),
    "many joints": (
        ARM3.replace("</robot>", "<joint name='x' type='fixed'/>" * 2000 + "</robot>"),
        "more than the maximum of 1000",
    ),
}


@pytest.mark.parametrize("case", DESCRIPTIONS)
def test_a_description_beyond_the_limits_is_refused(case: str) -> None:
    text, message = DESCRIPTIONS[case]
    with pytest.raises(InputError, match=message):
        Robot(text, source="topic robot_description")


def test_a_large_file_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "large.urdf"
    with path.open("wb") as file:
        file.truncate(2**40)  # a hole: reading it all would need a terabyte
    for read in (read_urdf, Configuration.read, read_sidecar, lambda name: LoadedModel.read(str(name))):
        with pytest.raises(InputError, match=r"large.urdf: larger than (5|100) MB"):
            read(path)


OPENING = """
import sys
from pathlib import Path
from geomid_ros.commands import root
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
urdf, *command = sys.argv[1:]
Session(Path(urdf).read_text(), Configuration(), "robot.urdf")
root(command)
"""


def test_meshes_are_never_opened(tmp_path: Path) -> None:
    """Neither by the node's session, nor by a command. Whoever opened this pipe to read it would wait for ever."""
    pipe, path = tmp_path / "mesh.stl", tmp_path / "robot.urdf"
    os.mkfifo(pipe)
    mesh = f'<geometry><mesh filename="file://{pipe}"/></geometry>'
    text = ARM3.replace('<geometry><cylinder radius="0.07" length="0.1"/></geometry>', mesh)
    assert str(pipe) in text
    path.write_text(text)
    command = ["gap", str(BAGS / "arm3"), "--urdf", str(path), "--out", str(tmp_path / "out"), "--no-report"]
    subprocess.run([sys.executable, "-c", OPENING, path, *command], check=True, cwd=ROOT, timeout=300)
    assert str(pipe) in (tmp_path / "out" / "identified.urdf").read_text()
    assert str(pipe) not in urdf_tree.without_shapes(text, "robot.urdf")


YAML: dict[str, tuple[str, str]] = {
    "an alias": ("a: &x [1]\nb: *x", "aliases are not allowed, line 2"),
    "a tag": ("a: !!python/name:os.system", "the tag .*os.system is not allowed, line 1"),
    "a tag that breaks the parser": ("a: !!timestamp x", "the tag .*timestamp is not allowed"),
    "many values": ("[" + "1," * 50_000 + "]", "more than 40000 values"),
    "deep": ("[" * 2000, "recursion"),
    "large": ("#" * 5_000_001, "larger than 5 MB"),
    "no text": ("\ud800", "cannot be read"),
}


@pytest.mark.parametrize("case", YAML)
def test_yaml_beyond_the_limits_is_refused(case: str, tmp_path: Path) -> None:
    text, message = YAML[case]
    path = tmp_path / "file.yaml"
    path.write_bytes(text.encode(errors="surrogatepass"))
    with pytest.raises(InputError, match=rf"file.yaml: .*{message}"):
        read_yaml(path, "file")


def test_yaml_is_read_as_rcl_reads_it(tmp_path: Path) -> None:
    """Without times of day, dates and the like; the long one would take a minute as a number to the base of 60."""
    long = "1:" * 300_000 + "1"
    numbers = {"1e-3": 1e-3, "-.5": -0.5, "0x1F": 31, ".inf": float("inf"), "yes": True, "~": None}
    for text, value in {
        **numbers,
        "1:30": "1:30",
        "2001-02-30": "2001-02-30",
        "'1'": "1",
        "<<": "<<",
        long: long,
    }.items():
        (tmp_path / "file.yaml").write_text(f"- {text}")
        (found,) = read_yaml(tmp_path / "file.yaml", "file")
        assert (type(found), found) == (type(value), value)


def test_an_error_shows_control_characters_as_codes_and_stays_short() -> None:
    assert str(GeomidError("\x1b[2J\x00\r\x9b\u202e ä\n")) == "\\x1b[2J\\x00\\r\\x9b\\u202e ä\n"
    long = str(InputError("begin " + "x" * 100_000 + " end"))
    assert len(long) < 5000
    assert long.startswith("begin")
    assert long.endswith("end")
