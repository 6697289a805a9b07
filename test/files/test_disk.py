"""A file is written whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import nullcontext
from pathlib import Path

import pytest

from geomid_ros.errors import GeomidError, refusing
from geomid_ros.files.disk import staged, write_bytes, write_text

BEFORE = "what was there before"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "estimate.json"
    path.write_text(BEFORE)
    return path


@pytest.mark.parametrize("mask", [0o000, 0o077])
def test_it_is_for_its_owner_alone(mask: int, tmp_path: Path) -> None:
    """So are the folders that are made for it; one that was there stays as it is, and so does what is in it."""
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o755)
    path = tmp_path / "shared" / "new" / "folders" / "estimate.json"
    before = os.umask(mask)
    try:
        write_text(path, "new")
    finally:
        os.umask(before)
    modes = [stat.S_IMODE(made.stat().st_mode) for made in (path, *path.parents[:3])]
    assert modes == [0o600, 0o700, 0o700, 0o755]


@pytest.mark.parametrize("step", ["fsync", "replace", "chmod"])
@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_what_was_there_and_nothing_else(
    error: BaseException, step: str, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    expected = GeomidError if isinstance(error, OSError) else KeyboardInterrupt
    said = r"estimate.json: cannot be written \(No space left on device\)$" if isinstance(error, OSError) else None
    monkeypatch.setattr(os if step == "fsync" else Path, step, fail)
    with pytest.raises(expected, match=said):
        write_text(path, "new")
    monkeypatch.undo()
    assert path.read_text() == BEFORE
    assert list(path.parent.iterdir()) == [path]


def test_it_is_on_the_disk_before_it_has_its_name_and_then_its_name_is(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a loss of power could leave an empty file, or the one before."""
    steps: list[str] = []

    def sync(descriptor: int) -> None:
        folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        steps.append(f"{'folder' if folder else 'file'}, {Path(f'/proc/self/fd/{descriptor}').readlink()}")

    def replaced(self: Path, target: Path) -> Path:
        steps.append(f"{self} becomes {target}")
        return Path(os.replace(self, target) or target)  # noqa: PTH105 it is what is replaced

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(Path, "replace", replaced)
    write_bytes(path, b"new")
    temporary = steps[0].removeprefix("file, ")
    assert steps == [f"file, {temporary}", f"{temporary} becomes {path}", f"folder, {path.parent}"]
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize("number", [errno.EINVAL, errno.EIO])
def test_a_folder_that_cannot_be_synchronised(number: int, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some network file systems have no such thing; a disk that fails is another matter."""

    def sync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", sync)
    with pytest.raises(GeomidError, match="Input/output error") if number == errno.EIO else nullcontext():
        write_text(path, "new")


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


@pytest.mark.parametrize("there", [False, True])
def test_a_stage_that_fails_leaves_what_was_there(there: bool, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    if there:
        write_text(folder / "a", "kept")
    with pytest.raises(GeomidError, match=rf"^{folder}/.*cannot be written"), staged(folder) as stage:
        (write_text(stage / "a", "other"), write_text(stage / "a" / "b", "a file is no folder"))
    assert folder.exists() == there
    assert not there or [path.read_text() for path in folder.iterdir()] == ["kept"]


def test_a_library_s_error_becomes_one_sentence_with_its_reason_and_advice() -> None:
    """Errors of other kinds pass."""
    for advice, end in (("", "$"), ("look elsewhere", "; look elsewhere$")):
        sentence = r"^x: cannot be read \(No such file or directory\)" + end
        refused = refusing("x: cannot be read", OSError, advice=advice, kind=GeomidError)
        with pytest.raises(GeomidError, match=sentence), refused:
            Path("/nowhere").read_text(encoding="utf-8")
    with pytest.raises(ZeroDivisionError), refusing("x", OSError):
        _ = 1 / 0
