"""Where results are kept while a fleet is worked on: a folder that all workers see, or a place in an object store."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.files.disk import write_bytes

_LOCAL = "file"


def file_system(url: str) -> tuple[Any, str]:
    """The file system of a path or URL (fsspec), and the path there.

    Raises:
        InputError: fsspec, or what it needs for this kind of URL, is not installed, or knows no such kind.
    """
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415 an extra
    except ImportError as error:
        raise InputError("geomid fleet needs the extra 'fleet': pip install geomid_ros[fleet]") from error
    try:
        found: tuple[Any, str] = url_to_fs(url)
    except (ImportError, ValueError, OSError) as error:
        raise InputError(f"{url}: cannot be reached ({error})") from error
    return found


def is_local(system: Any) -> bool:
    """Whether a file system is this machine's."""
    return _LOCAL in (system.protocol if isinstance(system.protocol, tuple) else (system.protocol,))


@dataclass(frozen=True)
class Store:
    """Files by name under a path or URL; each is whole or not there."""

    url: str

    def get(self, name: str) -> bytes | None:
        """The content of a file; None if there is none. Raises InputError if it cannot be read."""
        system, folder = file_system(self.url)
        try:
            content: bytes = system.cat_file(f"{folder}/{name}")
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{self.url}: cannot be read ({error})") from error
        return content

    def put(self, name: str, content: bytes) -> None:
        """Write a file. Raises GeomidError if it cannot be written."""
        system, folder = file_system(self.url)
        if is_local(system):
            write_bytes(Path(folder) / name, content)
            return
        try:
            system.pipe_file(f"{folder}/{name}", content)
        except OSError as error:
            raise GeomidError(f"{self.url}: cannot be written ({error})") from error

    def names(self) -> set[str]:
        """The names of all files."""
        system, folder = file_system(self.url)
        try:
            return {path.rpartition("/")[2] for path in system.ls(folder, detail=False)}
        except FileNotFoundError:
            return set()
        except OSError as error:
            raise InputError(f"{self.url}: cannot be read ({error})") from error
