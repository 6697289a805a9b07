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

from .running import NO_CHOICE, WRIST, done, read, refused, undrawn

HTML = "<script>alert(1)</script>"
# Tags, a link, a colour; an emoji, mathematics, HTML.
MARKUP = ("[/x]:skull:", "[link=file:///etc/passwd]link1[/link]$\\frac{$", f"[red]{HTML}[/red]")
UNPRINTABLE = ("a\nTotal 0 kg", "a\x9b31mb", "a\u202eb")  # a newline, a C1 control, from right to left


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


@pytest.fixture(scope="module")
def marked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a robot with such names, its results in ``out``, and what was printed."""
    folder = tmp_path_factory.mktemp("marked")
    urdf, bag = renamed(MARKUP, folder)
    return folder, done("identify", bag, "--urdf", urdf, *WRIST, "--out", folder / "out")


def test_markup_is_shown_as_it_is(marked: tuple[Path, str], tmp_path: Path) -> None:
    folder, shown = marked
    assert "\x1b]8" not in shown
    for name, link in zip(MARKUP, read(folder / "out")["links"], strict=False):
        assert name in re.sub(r"\s+", "", shown) or name in shown
        assert link["name"] == name
        bag, urdf = folder / "bag", folder / "renamed.urdf"
        message = refused("identify", bag, "--urdf", urdf, "--links", name + "!", "--out", tmp_path)
        assert name in " ".join(message.split())


def test_what_cannot_be_printed_is_shown_as_codes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    urdf, bag = renamed(UNPRINTABLE, tmp_path)
    arguments = ("identify", bag, "--urdf", urdf, *NO_CHOICE, "--out", tmp_path / "out")
    shown = done(*arguments)
    assert all(character.isprintable() or character == "\n" for character in shown)
    assert not re.search("^ *Total 0 kg", shown, re.MULTILINE)
    undrawn(monkeypatch)  # the same has been drawn
    assert json.loads(done(*arguments, "--json"))["links"]
    for name in UNPRINTABLE:
        message = refused("identify", BAGS / "arm3", "--urdf", described([name], tmp_path), "--out", tmp_path)
        assert all(character.isprintable() or character == "\n" for character in message)


def test_html_is_text_in_a_report(marked: tuple[Path, str]) -> None:
    """That of 'geomid gap' is looked at where it is made."""
    page = (marked[0] / "out/report.html").read_text(encoding="utf-8")
    assert HTML not in page
    assert "&lt;script&gt;alert(1)" in page


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
