"""What a command finds around it: shipped files, libraries, folders to write to. What is missing is named."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from files.recordings import BAGS

import geomid_ros
from geomid_ros.commands import COMMANDS, root
from geomid_ros.commands.live import shared_file
from geomid_ros.commands.options import Output
from geomid_ros.errors import InputError

from .running import refused

ROOT = Path(__file__).parents[2]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package without its sources, in a prefix after another one."""
    monkeypatch.setattr(geomid_ros, "__file__", str(tmp_path / "lib/geomid_ros/__init__.py"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", str(tmp_path / "other"), str(tmp_path / "prefix")]))
    file = tmp_path / "prefix/share/geomid_ros/bags/arm7.urdf"
    file.parent.mkdir(parents=True)
    file.touch()
    return file


def test_a_shipped_file_is_beside_the_sources_or_where_it_was_installed(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By ROS, or by pip. What is nowhere is answered with where it was looked for."""
    assert shared_file("bags/arm7.urdf") == installed
    with pytest.raises(InputError, match=r"bags/arm8 is not installed; looked in .*other/share/geomid_ros, .*prefix"):
        shared_file("bags/arm8")
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    monkeypatch.setattr(sys, "prefix", str(installed.parents[3]))
    assert shared_file("bags/arm7.urdf") == installed
    monkeypatch.undo()
    assert shared_file("bags/arm7.urdf") == ROOT / "bags/arm7.urdf"
    assert shared_file("bags/arm7").is_dir()


SCRIPT = """
import sys
from importlib import import_module

class Refusal:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == {library!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refusal())
sys.argv = {arguments!r}
import_module({module!r}).main()
"""


def said_without(library: str, module: str, *arguments: str) -> str:
    """The one line that a program says; fails unless it ends with status 2."""
    script = SCRIPT.format(library=library, arguments=[module, *arguments], module=module)
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 2, result.stderr
    (line,) = result.stderr.splitlines()
    return line


IDENTIFY = ("geomid_ros.commands", "identify", str(BAGS / "arm3"), "--urdf", str(BAGS / "arm3.urdf"))


@pytest.mark.parametrize(
    ("library", "command", "said"),
    [
        ("backports", IDENTIFY, "Error: backports is not installed: pip install backports.zstd"),
        ("pinocchio", IDENTIFY, "Error: pinocchio is not installed: pip install pin"),
        ("tornado", ("geomid_ros.commands", "dashboard"), "Error: tornado is not installed: pip install tornado"),
        (
            "rclpy",
            ("geomid_ros.ros.main",),
            "geomid_node: rclpy is not installed: pip install 'ros-jazzy-rclpy[fastrtps]' ",
        ),
    ],
)
def test_a_library_that_is_missing_is_named(library: str, command: tuple[str, ...], said: str) -> None:
    if "dashboard" in command:
        pytest.importorskip("rclpy")
    assert said_without(library, *command).startswith(said)


NOWHERE = "nowhere"  # no bag, URDF or model: work on it would be refused with its name
COMMAND_LINES = (
    ("identify", NOWHERE, "--out", "{}"),
    ("excite", "--urdf", NOWHERE, "--out", "{}"),
    ("excite", "run", NOWHERE, "--execute", "--out", "{}"),
    ("simulate", "{}/bag", "--robot", NOWHERE),
    ("prior", NOWHERE, "--mass", "3", "--out", "{}/prior.urdf"),
)


@pytest.mark.parametrize("line", COMMAND_LINES, ids=lambda line: " ".join(line[:2]))
def test_a_folder_that_cannot_be_made_is_told_at_once(line: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    folder = tmp_path / "file" / "folder"
    assert f"{folder}: cannot be written (Not a directory)" in refused(*(word.format(folder) for word in line))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_every_out_is_tried(tmp_path: Path) -> None:
    """And nothing is left of it. A design and a run of a motion alone try it later: the other of them must not be
    refused for it."""
    assert Output(file_okay=False).convert(str(tmp_path / "new/folder"), None, None) == tmp_path / "new/folder"
    assert not any(tmp_path.iterdir())
    context = click.Context(root)
    commands = [root.get_command(context, name) for name in COMMANDS]
    options = [
        (command.name, option)
        for command in commands
        if command is not None
        for option in command.params
        if "--out" in option.opts
    ]
    assert len(options) >= 6
    assert all(isinstance(option.type, Output) or name == "excite" for name, option in options)
