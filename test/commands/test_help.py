"""The command line explains itself."""

from __future__ import annotations

import os
import subprocess
import sys

import click
import pytest

import geomid_ros
from geomid_ros.commands import COMMANDS, root

from .running import done

NAMES = sorted(COMMANDS)
SECOND = ("excite run", "excite learn")  # commands of a command
LIBRARIES = {
    *("jinja2", "matplotlib", "mujoco", "pinocchio", "plotly", "rclpy", "rosbags", "scipy", "trimesh", "yaml"),
}
HEAVY = LIBRARIES | {"numpy", "rich"}


def command(name: str) -> click.Command:
    found: click.Command | None = root
    for word in name.split():
        assert isinstance(found, click.Group)
        found = found.get_command(click.Context(found), word)
    assert found is not None
    return found


def test_the_commands() -> None:
    text = done("--help")
    assert "..." not in text.partition("Commands:")[2], "a command's first sentence is too long for the list"
    assert all(f"  {name} " in text for name in NAMES)


def loaded(*lines: tuple[str, ...], completing: str = "") -> set[str]:
    """The modules that a process has imported that runs ``geomid`` with these arguments, one after the other.

    ``completing``: the line that it completes instead.
    """
    script = (
        "import sys\n"
        "from contextlib import suppress\n"
        "from geomid_ros.commands import main\n"
        f"for arguments in {lines or ((),)!r}:\n"
        "    sys.argv = ['geomid', *arguments]\n"
        "    with suppress(SystemExit):\n"
        "        main()\n"
        "print(*sys.modules, file=sys.__stdout__)"
    )
    asked = {"_GEOMID_COMPLETE": "bash_complete", "COMP_WORDS": completing, "COMP_CWORD": str(completing.count(" "))}
    environment = os.environ | (asked if completing else {})
    command = [sys.executable, "-c", script]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert "--urdf" in run.stdout or "identify" in run.stdout, run.stderr
    assert "Traceback" not in run.stderr
    modules = set(run.stdout.splitlines()[-1].split())
    assert {"click", "geomid_ros"} <= modules
    return modules


def test_what_computes_nothing_loads_nothing_that_computes() -> None:
    """Neither the list of commands, which loads none of them, nor a mistake, nor completion; a command's help loads no
    library that the command needs."""
    listed = loaded(("--help",), ("--version",), (), ("unknown",), ("--unknown",))
    assert not listed & HEAVY
    assert not {f"geomid_ros.commands.{name}" for name in NAMES} & listed
    assert not loaded(("identify", "--help"), ("identify",)) & HEAVY

    assert not loaded(completing="geomid ") & {*HEAVY, "geomid_ros.commands.recordings"}
    completed = loaded(completing="geomid identify --u")
    assert "geomid_ros.commands.recordings" in completed
    assert not completed & HEAVY
    assert not loaded(*((*name.split(), "--help") for name in (*NAMES, *SECOND))) & LIBRARIES


@pytest.mark.parametrize("name", [*NAMES, *SECOND])
def test_every_option_is_explained_and_the_list_has_the_first_sentence(name: str) -> None:
    if name in COMMANDS:
        assert command(name).get_short_help_str(limit=1000) == COMMANDS[name]
    text = done(*name.split(), "--help")
    assert text == done(*name.split(), "-h")
    names = [parameter.name for parameter in command(name).params]
    assert len(names) == len(set(names))
    for parameter in command(name).params:
        if isinstance(parameter, click.Option):
            assert parameter.opts[0] in text
            assert parameter.help
            assert parameter.help.endswith((".", "]", ")")), parameter.help
        else:
            assert str(parameter.human_readable_name) in (command(name).help or "")


def test_version() -> None:
    assert done("--version").split() == ["geomid,", "version", geomid_ros.__version__]
    command = [sys.executable, "-m", "geomid_ros", "--version"]
    assert geomid_ros.__version__ in subprocess.run(command, capture_output=True, text=True, check=True).stdout
