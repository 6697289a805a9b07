"""Names of links and joints as a hostile or a careless URDF has them (faults 103, 104 and 107): they are shown as they
are, never obeyed, and cost no more than their length."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from files.recordings import BAGS, Recorded, altered
from matplotlib.figure import Figure

from geomid_ros.api import identify as front_door

from .running import WRIST, done, read, refused

NAMES = {
    "closing tag": "[/x]",
    "a link": "[link=file:///etc/passwd]link1[/link]",
    "a colour": "[red]x[/red]",
    "an emoji": ":skull:",
    "mathematics": "$\\frac{$",
    "HTML": "<script>alert(1)</script>",
}
UNPRINTABLE = {"newline": "a\nTotal 0 kg", "C1": "a\x9b31mb", "right to left": "a\u202eb"}


def renamed(name: str, folder: Path) -> tuple[Path, Path]:
    """The small arm with another name of a link and of a joint: its URDF and its recording."""
    urdf = folder / "renamed.urdf"
    quoted = quoteattr(name, {"\n": "&#10;"})
    text = (BAGS / "arm3.urdf").read_text()
    urdf.write_text(text.replace('"link1"', quoted).replace('"joint1"', quoted), encoding="utf-8")

    def change(item: Recorded) -> Recorded:
        if item.topic != "/joint_states":
            return item
        return item.changed(name=[name if old == "joint1" else old for old in item.message.name])

    return urdf, altered(BAGS / "arm3", folder / "bag", change)


@pytest.mark.parametrize("case", NAMES)
def test_markup_is_shown_as_it_is(case: str, tmp_path: Path) -> None:
    name = NAMES[case]
    urdf, bag = renamed(name, tmp_path)
    shown = done("identify", bag, "--urdf", urdf, *WRIST, "--out", tmp_path / "out")
    assert name in re.sub(r"\s+", "", shown) or name in shown
    assert "\x1b]8" not in shown
    assert read(tmp_path / "out")["links"][0]["name"] == name
    assert name in " ".join(refused("identify", bag, "--urdf", urdf, "--links", name + "!", "--out", tmp_path).split())


@pytest.mark.parametrize("case", UNPRINTABLE)
def test_what_cannot_be_printed_is_shown_as_codes(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = UNPRINTABLE[case]
    urdf, bag = renamed(name, tmp_path)
    shown = done("identify", bag, "--urdf", urdf, "--out", tmp_path / "out")
    assert all(character.isprintable() or character == "\n" for character in shown)
    assert not re.search("^ *Total 0 kg", shown, re.MULTILINE)
    monkeypatch.setattr(front_door, "draw_identification", lambda *_: Figure())  # the same has been drawn
    assert json.loads(done("identify", bag, "--urdf", urdf, "--out", tmp_path / "out", "--json"))["links"]
    message = refused("identify", BAGS / "arm3", "--urdf", urdf, "--out", tmp_path)
    assert all(character.isprintable() or character == "\n" for character in message)


def test_html_is_text_in_a_report(tmp_path: Path) -> None:
    urdf, bag = renamed(NAMES["HTML"], tmp_path)
    shown = done("gap", bag, "--urdf", urdf, "--hold-out", "0.2", "--out", tmp_path / "out")
    assert NAMES["HTML"] in re.sub(r"\s+", "", shown)
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert NAMES["HTML"] not in page
    assert "&lt;script&gt;alert(1)" in page


def test_a_name_costs_no_more_than_its_length(tmp_path: Path) -> None:
    """Ten times as long: not a hundred times as slow."""
    seconds = []
    for length in (2_000, 20_000):
        folder = tmp_path / str(length)
        folder.mkdir()
        urdf, bag = renamed("n" * length, folder)
        begin = time.process_time()
        done("identify", bag, "--urdf", urdf, "--out", folder / "out")
        refused("identify", bag, "--urdf", urdf, "--links", "n" * (length - 1) + "m", "--out", folder)
        seconds.append(time.process_time() - begin)
    assert seconds[1] < 3.0 * seconds[0] + 1.0
