"""Reading files of bounded size."""

from __future__ import annotations

from pathlib import Path

from geomid_ros.errors import InputError


def read_bytes(path: Path, what: str, most_bytes: int) -> bytes:
    """The content of a regular file; ``what`` it is for messages. Raises InputError naming it.

    A pipe or a device, which may never end, is not opened.
    """
    try:
        if not path.is_file():
            raise InputError(f"{path}: no regular file, as a {what} is")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as error:
        raise InputError(f"{path}: the {what} cannot be read ({error})") from error
    if len(data) > most_bytes:
        raise InputError(f"{path}: larger than {most_bytes / 1e6:g} MB, not a {what}")
    return data


def read_text(path: Path, what: str, most_bytes: int) -> str:
    """The text of a UTF-8 file, with the line ends it has; ``what`` it is for messages. Raises InputError naming it."""
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
        if len(data) > most_bytes:
            raise InputError(f"{path}: larger than {most_bytes / 1e6:g} MB, not a {what}")
        return data.decode()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the {what} cannot be read ({error})") from error
