"""A file is written whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from geomid_ros.errors import GeomidError
from geomid_ros.files.atomic import write_text

BEFORE = "what was there before"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "estimate.json"
    path.write_text(BEFORE)
    return path


def test_text_is_written_as_it_is(tmp_path: Path) -> None:
    text = "lines\nof Unix,\r\nof Windows, \N{SNOWMAN}\ufeff"
    path = tmp_path / "new/folders/file.urdf"
    write_text(path, text)
    assert path.read_bytes() == text.encode()
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    assert os.listdir(path.parent) == [path.name]  # noqa: PTH208 names are enough


def test_a_file_is_replaced(path: Path) -> None:
    write_text(path, "new")
    assert path.read_text() == "new"


@pytest.mark.parametrize("step", ["fsync", "replace", "chmod"])
def test_a_failure_leaves_what_was_there_and_nothing_else(
    step: str, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    owner = os if step == "fsync" else Path
    monkeypatch.setattr(owner, step, fail)
    with pytest.raises(GeomidError, match=r"estimate.json: cannot be written \(No space left on device\)"):
        write_text(path, "new")
    monkeypatch.undo()
    assert path.read_text() == BEFORE
    assert list(path.parent.iterdir()) == [path]


def test_an_interrupt_leaves_no_file_behind(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_text(path, "new")
    assert list(path.parent.iterdir()) == [path]


def test_text_that_has_no_bytes_is_refused(path: Path) -> None:
    with pytest.raises(GeomidError, match=r"estimate.json: cannot be written .*surrogates"):
        write_text(path, "\ud800")
    assert list(path.parent.iterdir()) == [path]


def test_a_folder_that_cannot_be_made_is_named(path: Path) -> None:
    for folder in (path, path / "below"):
        with pytest.raises(GeomidError, match=r"estimate.json.*new.json: cannot be written"):
            write_text(folder / "new.json", "new")
    with pytest.raises(GeomidError, match=r"/proc/geomid/new.json: cannot be written"):
        write_text(Path("/proc/geomid/new.json"), "new")
    assert path.read_text() == BEFORE


def test_a_folder_in_the_file_s_place_stays(tmp_path: Path) -> None:
    (tmp_path / "file").mkdir()
    with pytest.raises(GeomidError, match="cannot be written"):
        write_text(tmp_path / "file", "new")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_named(path: Path) -> None:
    path.parent.chmod(0o555)
    try:
        with pytest.raises(GeomidError, match="Permission denied"):
            write_text(path, "new")
    finally:
        path.parent.chmod(0o755)
    assert path.read_text() == BEFORE
