"""The command line explains itself."""

from __future__ import annotations

import subprocess
import sys

import click
import pytest

import geomid_ros
from geomid_ros.commands.root import root

from .running import done

NAMES = sorted(root.commands)


def test_the_commands() -> None:
    text = done("--help")
    assert NAMES == ["demo", "export", "gap", "identify", "play", "prior", "simulate"]
    assert "..." not in text.partition("Commands:")[2], "a command's first sentence is too long for the list"
    assert all(f"  {name} " in text for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_option_is_explained(name: str) -> None:
    text = done(name, "--help")
    assert text == done(name, "-h")
    for parameter in root.commands[name].params:
        if isinstance(parameter, click.Option):
            assert parameter.opts[0] in text
            assert parameter.help
            assert parameter.help.endswith((".", "]", ")")), parameter.help
        else:
            assert str(parameter.human_readable_name) in (root.commands[name].help or "")


def test_version() -> None:
    assert done("--version").split() == ["geomid,", "version", geomid_ros.__version__]
    command = [sys.executable, "-m", "geomid_ros", "--version"]
    assert geomid_ros.__version__ in subprocess.run(command, capture_output=True, text=True, check=True).stdout
