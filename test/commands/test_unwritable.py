"""Where results cannot be written is told before any work is done, by every command that writes some."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from geomid_ros.commands.options import Output
from geomid_ros.commands.root import COMMANDS, root

from .running import refused

NOWHERE = "nowhere"  # no bag, URDF or model: work on it would be refused with its name
COMMAND_LINES = (
    ("identify", NOWHERE, "--out", "{}"),
    ("gap", NOWHERE, "--out", "{}"),
    ("fleet", NOWHERE, "--out", "{}"),
    ("sample", NOWHERE, "--for", "json", "--out", "{}"),
    ("excite", "--urdf", NOWHERE, "--out", "{}"),
    ("excite", "run", NOWHERE, "--execute", "--out", "{}"),
    ("demo", "--out", "{}"),
    ("simulate", "{}/bag", "--robot", NOWHERE),
    ("prior", NOWHERE, "--mass", "3", "--out", "{}/prior.urdf"),
)


@pytest.mark.parametrize("line", COMMAND_LINES, ids=lambda line: " ".join(line[:2]))
def test_a_folder_that_cannot_be_made_is_told_at_once(line: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    folder = tmp_path / "file" / "folder"
    assert f"{folder}: cannot be written (Not a directory)" in refused(*(word.format(folder) for word in line))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_nothing_is_left_of_the_trial(tmp_path: Path) -> None:
    found = Output(file_okay=False).convert(str(tmp_path / "new" / "folder"), None, None)
    assert found == tmp_path / "new" / "folder"
    assert not any(tmp_path.iterdir())


def test_every_out_is_tried() -> None:
    """Only a design and a run of a motion try it later: the other of them must not be refused for it."""
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
