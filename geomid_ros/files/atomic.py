"""Files that are either whole or not there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from geomid_ros.errors import GeomidError


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path``. Raises GeomidError naming the file."""
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        raise GeomidError(f"{path}: cannot be written ({error})") from error
    write_bytes(path, content)


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` by way of a temporary file beside it. Raises GeomidError naming the file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.chmod(0o644)
            temporary.replace(path)
        except BaseException:
            temporary.unlink()
            raise
    except OSError as error:
        raise GeomidError(f"{path}: cannot be written ({error.strerror or error})") from error
