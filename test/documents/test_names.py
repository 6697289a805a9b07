"""What the documents name exists: files, make targets, rooms of the house."""

from __future__ import annotations

import re

from .reading import DOCUMENTS, ROOT, text_of

FOLDERS = "geomid_ros|test|config|launch|security|bags|docs|benchmarks|examples"
HIDDEN = {"robots"}  # a room's folder of data
# What the recipe in CONTRIBUTING.md makes.
PLANNED = {"geomid_ros/model/effects/gear_ripple.py"}


def test_files_and_make_targets_that_are_named_exist() -> None:
    text = "\n".join(map(text_of, DOCUMENTS))
    files = set(re.findall(rf"`((?:{FOLDERS})/[\w./]*)`", text)) - PLANNED
    assert len(files) > 20
    assert not [name for name in files if not (ROOT / name).exists()]
    targets = set(re.findall(r"(?:`|    )make ([a-z]+)", text))
    assert len(targets) > 3
    assert targets <= set(re.findall(r"^([a-z]+):", text_of("Makefile"), re.MULTILINE))


def test_the_map_of_the_house_shows_every_room() -> None:
    """No more and no less, and each floor as it is held by the test of the house."""
    from test_house import FLOORS  # noqa: PLC0415 it parses the package

    rows = re.findall(r"^\| (below|\d+) \| ([^|]+) \|", text_of("CONTRIBUTING.md"), re.MULTILINE)
    shown = {
        room.removesuffix("/").removesuffix(".py"): -1 if floor == "below" else int(floor)
        for floor, rooms in rows
        for room in re.findall(r"`([\w./]+)`", rooms)
    }
    assert shown == FLOORS


def test_folders_within_rooms_are_shown() -> None:
    rows = re.findall(r"^\| \d+ \| `(\w+)/` \| (.+) \|$", text_of("CONTRIBUTING.md"), re.MULTILINE)
    for room, what in rows:
        within = {path.parent.name for path in (ROOT / "geomid_ros" / room).glob("*/__init__.py")}
        assert set(re.findall(r"`(\w+)/`:", what)) == within - HIDDEN, room
