"""Names of links and joints as a hostile or a careless URDF has them (faults 103, 104 and 107): they are shown as they
are, never obeyed, and cost no more than their length."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from files.recordings import BAGS, Recorded, altered

from .running import NO_CHOICE, done, read, refused, undrawn

HTML = "<script>alert(1)</script>"
# Tags, a link, mathematics; a colour, an emoji, HTML; a newline, a C1 control, from right to left.
NAMES = (
    "[link=file:///etc/passwd]link1[/link]$\\frac{$",
    f"[/x][red]:skull:{HTML}[/red]",
    "a\nTotal 0 kg\x9b31mb\u202ec",
)


def described(names: Sequence[str], folder: Path) -> Path:
    """The URDF of the small arm with other names of its first links and joints."""
    urdf, text = folder / "renamed.urdf", (BAGS / "arm3.urdf").read_text()
    for number, name in enumerate(names, 1):
        quoted = quoteattr(name, {"\n": "&#10;"})
        text = text.replace(f'"link{number}"', quoted).replace(f'"joint{number}"', quoted)
    urdf.write_text(text, encoding="utf-8")
    return urdf


def renamed(names: Sequence[str], folder: Path) -> tuple[Path, Path]:
    """The same, and its recording."""
    new = {f"joint{number}": name for number, name in enumerate(names, 1)}

    def change(item: Recorded) -> Recorded:
        if item.topic != "/joint_states":
            return item
        return item.changed(name=[new.get(old, old) for old in item.message.name])

    return described(names, folder), altered(BAGS / "arm3", folder / "bag", change)


def printable(text: str) -> bool:
    return all(character.isprintable() or character == "\n" for character in text)


def test_names_are_shown_as_they_are_or_as_codes_and_never_obeyed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the terminal, in messages and on the page; that of 'geomid gap' is looked at where it is made."""
    urdf, bag = renamed(NAMES, tmp_path)
    arguments = ("identify", bag, "--urdf", urdf, *NO_CHOICE)
    shown = done(*arguments, "--out", tmp_path / "out")
    assert "\x1b]8" not in shown
    assert printable(shown)
    assert not re.search("^ *Total 0 kg", shown, re.MULTILINE)
    assert [link["name"] for link in read(tmp_path / "out")["links"][:3]] == list(NAMES)
    for name in NAMES[:2]:
        assert name in re.sub(r"\s+", "", shown) or name in shown
        assert name in " ".join(refused(*arguments, "--links", name + "!", "--out", tmp_path).split())
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert HTML not in page
    assert "&lt;script&gt;alert(1)" in page
    undrawn(monkeypatch)  # the same has been drawn
    assert json.loads(done(*arguments, "--json", "--out", tmp_path / "json"))["links"]
    message = refused("identify", BAGS / "arm3", "--urdf", described(NAMES[2:], tmp_path), "--out", tmp_path)
    assert printable(message)


def test_a_name_costs_no_more_than_its_length(tmp_path: Path) -> None:
    """Ten times as long: not a hundred times as slow."""
    seconds = []
    for length in (2_000, 20_000):
        folder = tmp_path / str(length)
        folder.mkdir()
        urdf, bag = renamed(["n" * length], folder)
        begin = time.process_time()
        done("identify", bag, "--urdf", urdf, *NO_CHOICE, "--out", folder / "out")
        refused("identify", bag, "--urdf", urdf, "--links", "n" * (length - 1) + "m", "--out", folder)
        seconds.append(time.process_time() - begin)
    assert seconds[1] < 3.0 * seconds[0] + 1.0
