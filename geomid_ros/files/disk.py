"""Bounded reading of files, and atomic writing of files that only their owner can read."""

from __future__ import annotations

import errno
import json
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from geomid_ros.errors import GeomidError, InputError, refusing

MOST_BYTES = 100_000_000
"""Maximum size of a file that is read as a whole, unless a smaller bound is given [bytes]; also of a message, or of a
chunk of messages in a recording. Recorders make chunks of 1 or 4 MB, or of one message that is larger."""

FOR_OWNER = stat.S_IRUSR | stat.S_IWUSR


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path``. Raises GeomidError naming the file."""
    with refusing(f"{path}: cannot be written", UnicodeEncodeError, kind=GeomidError):
        content = text.encode()
    write_bytes(path, content)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document as indented JSON. Raises GeomidError naming the file."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` through a temporary file in the same folder. It is on the disk when this returns.

    Only the owner may read it. Missing folders are made. Raises GeomidError naming the file.
    """
    with refusing(f"{path}: cannot be written", OSError, kind=GeomidError):
        make_folder(path.parent)
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.chmod(FOR_OWNER)
            temporary.replace(path)
        except BaseException:
            temporary.unlink()
            raise
        _sync_folder(path.parent)


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder. Its files move to ``folder`` when the block ends, none if it ends with an error.

    Raises GeomidError naming the file.
    """
    fresh = not folder.exists()
    try:
        make_folder(folder)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".") as name:
            try:
                yield Path(name)
            except GeomidError as error:
                raise GeomidError(str(error).replace(name, str(folder))) from error
            for file in sorted(Path(name).iterdir()):
                file.replace(folder / file.name)
        _sync_folder(folder)
    except OSError as error:
        raise GeomidError(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        if fresh and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def make_folder(path: Path) -> None:
    """Make a folder and its missing parents, for the owner alone; existing ones stay as they are. Raises OSError."""
    for folder in reversed(path.parents):
        if not folder.exists():
            folder.mkdir(stat.S_IRWXU, exist_ok=True)
    path.mkdir(stat.S_IRWXU, exist_ok=True)


def check_writable(folder: Path) -> None:
    """Refuse a folder that cannot be made, or in which no file can be made. Nothing is left behind.

    Raises GeomidError naming it.
    """
    with refusing(f"{folder}: cannot be written", OSError, kind=GeomidError):
        existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
        with tempfile.TemporaryFile(dir=existing):
            pass


def _sync_folder(folder: Path) -> None:
    """Flush the folder's directory entries to the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some network file systems do not support it
            raise
    finally:
        os.close(descriptor)


def read_bytes(path: Path, what: str, most_bytes: int = MOST_BYTES) -> bytes:
    """Content of a regular file of at most ``most_bytes``; ``what`` names it in messages. Raises InputError naming it.

    A pipe or a device is not opened, as reading it may never end.
    """
    with refusing(f"{path}: the {what} cannot be read", OSError):
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a regular file; expected a {what}")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise InputError(f"{path}: larger than {most_bytes / 1e6:g} MB, not a {what}")
    return data


def read_text(path: Path, what: str, most_bytes: int = MOST_BYTES) -> str:
    """Text of a UTF-8 file with its line ends; otherwise like :func:`read_bytes`. Raises InputError naming it."""
    with refusing(f"{path}: the {what} cannot be read", UnicodeDecodeError, advice="save it as UTF-8"):
        return read_bytes(path, what, most_bytes).decode()
