"""Files that are either whole or not there, and nobody's but their owner's."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

from geomid_ros.errors import GeomidError

_MODE, _FOLDER_MODE = 0o600, 0o700


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path``. Raises GeomidError naming the file."""
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        raise GeomidError(f"{path}: cannot be written ({error})") from error
    write_bytes(path, content)


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` by way of a temporary file beside it. It is on the disk when this returns.

    Only the owner may read it. Folders that are missing are made. Raises GeomidError naming the file.
    """
    try:
        make_folder(path.parent)
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.chmod(_MODE)
            temporary.replace(path)
        except BaseException:
            temporary.unlink()
            raise
        _sync_folder(path.parent)
    except OSError as error:
        raise GeomidError(f"{path}: cannot be written ({error.strerror or error})") from error


def make_folder(path: Path) -> None:
    """Make a folder, and those that it is in, for their owner alone; one that exists stays as it is. Raises OSError."""
    for folder in reversed(path.parents):
        if not folder.exists():
            folder.mkdir(_FOLDER_MODE, exist_ok=True)
    path.mkdir(_FOLDER_MODE, exist_ok=True)


def _sync_folder(folder: Path) -> None:
    """Let names in a folder be on the disk, too."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some network file systems have no such thing
            raise
    finally:
        os.close(descriptor)
