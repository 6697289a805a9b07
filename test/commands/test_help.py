"""The command line explains itself."""

from __future__ import annotations

import subprocess
import sys

import click
import pytest

import geomid_ros
from geomid_ros.commands.root import COMMANDS, root

from .running import done

NAMES = sorted(COMMANDS)
HEAVY = ("pinocchio", "numba", "numpy", "matplotlib", "scipy", "rclpy")


def command(name: str) -> click.Command:
    found = root.get_command(click.Context(root), name)
    assert found is not None
    return found


def test_the_commands() -> None:
    text = done("--help")
    assert NAMES == ["demo", "export", "gap", "identify", "payload", "play", "prior", "simulate"]
    assert "..." not in text.partition("Commands:")[2], "a command's first sentence is too long for the list"
    assert all(f"  {name} " in text for name in NAMES)


def test_the_list_loads_nothing_of_the_commands() -> None:
    run = "from geomid_ros.commands.root import root\nroot(['--help'], standalone_mode=False)"
    script = f"import sys\n{run}\nassert not sys.modules.keys() & {set(HEAVY)!r}, sys.modules.keys()"
    subprocess.run([sys.executable, "-c", script], capture_output=True, check=True, timeout=60)


@pytest.mark.parametrize("name", NAMES)
def test_the_list_has_the_first_sentence_of_each_command(name: str) -> None:
    assert command(name).get_short_help_str(limit=1000) == COMMANDS[name]


@pytest.mark.parametrize("name", NAMES)
def test_every_option_is_explained(name: str) -> None:
    text = done(name, "--help")
    assert text == done(name, "-h")
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
