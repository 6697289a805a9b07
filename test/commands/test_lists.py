"""Lists of names on the command line: one form in all commands, and nothing that is empty passes unnoticed."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest
from files.recordings import BAGS

from geomid_ros.commands import root
from geomid_ros.commands.options import Names

from .running import refused

IDENTIFY = ("identify", BAGS / "arm3", "--urdf", BAGS / "arm3.urdf", "--out", "nowhere")


def commands(group: click.Group) -> Iterator[click.Command]:
    for name in group.list_commands(click.Context(group)):
        command = group.get_command(click.Context(group), name)
        assert command is not None
        yield command
        if isinstance(command, click.Group):
            yield from commands(command)


def test_every_option_that_takes_names_takes_them_in_the_same_way() -> None:
    lists = [
        option
        for command in commands(root)
        for option in command.params
        if isinstance(option, click.Option) and "separated by commas" in (option.help or "") and option.name != "start"
    ]
    assert {option.name for option in lists} == {"effects", "candidates", "links", "lock", "keep", "contacts"}
    assert all(isinstance(option.type, Names) for option in lists)
    assert all(
        ("'none'" in (option.help or "")) == (option.type.convert("none", option, None) == []) for option in lists
    )


@pytest.mark.parametrize(
    ("option", "text"),
    [("effects", "link1,"), ("candidates", "link1,"), ("links", ""), ("links", " "), ("contacts", "a,,b")],
)
def test_an_empty_name_is_refused(option: str, text: str) -> None:
    message = " ".join(refused(*IDENTIFY, f"--{option}", text).split())
    assert f"'--{option}': there is an empty name in '{text}'. Write NAME,NAME,..." in message
    assert ("'none' for none" in message) == (option in ("effects", "candidates"))


def test_an_empty_mass_is_refused() -> None:
    assert "known: the text is empty" in refused(*IDENTIFY, "--known", "")
