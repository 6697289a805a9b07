"""A bag on disk: which files it has, of which format, and how they are compressed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePath

from geomid_ros.errors import InputError
from geomid_ros.files.bags.unpacking import unpack_file
from geomid_ros.files.parameter_file import read_yaml

SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}
"""Of files, by rosbag2's name of the format."""


@dataclass(frozen=True)
class BagFiles:
    """The files of a recording in their order, their ``suffix``, and whether each message is compressed by itself."""

    paths: tuple[Path, ...]
    suffix: str
    packed: bool = False


def bag_files(path: Path, scratch: Callable[[], Path]) -> BagFiles:
    """The files of a folder or of a single file. What is compressed as a whole is unpacked into the folder that
    ``scratch`` makes.

    Raises InputError naming the file.
    """
    if not path.exists():
        raise InputError(f"{path}: no such bag")
    if path.is_dir():
        return _in_folder(path, scratch)
    if path.suffix not in SUFFIXES.values():
        expected = f"expected a bag's folder, or a file that ends in {' or '.join(SUFFIXES.values())}"
        raise InputError(f"{path}: cannot be read as a rosbag2 recording, it is of the wrong type; {expected}")
    return BagFiles((_checked(path),), path.suffix)


def _in_folder(path: Path, scratch: Callable[[], Path]) -> BagFiles:
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        inside = sorted(p.name for p in path.iterdir() if p.suffix in SUFFIXES.values())
        hint = f"name the file itself ({path / inside[0]}) or" if inside else "record it again, or"
        raise InputError(f"{path}: a folder without metadata.yaml is no rosbag; {hint} run 'ros2 bag reindex' on it")
    try:
        told = read_yaml(metadata, "bag's description")["rosbag2_bagfile_information"]
        paths = [_checked(path / PurePath(name).name) for name in told["relative_file_paths"]]
        suffix = SUFFIXES[told["storage_identifier"]]
        mode, method = (told.get("compression_mode") or "none").lower(), told.get("compression_format")
    except (KeyError, TypeError, AttributeError) as error:
        what = f"no valid {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{metadata}: cannot be read, {what}; 'ros2 bag reindex' writes it anew") from error
    if mode == "none":
        return BagFiles(tuple(paths), suffix)
    if mode not in ("file", "message") or method != "zstd":
        raise InputError(
            f"{metadata}: cannot be read, compression of a {mode} by {method}; expected file or message, zstd"
        )
    if mode == "message":
        return BagFiles(tuple(paths), suffix, packed=True)
    folder = scratch()
    return BagFiles(tuple(_unpacked(file, folder / f"{n}-{file.stem}") for n, file in enumerate(paths)), suffix)


def _checked(path: Path) -> Path:
    """A path, if it is that of a file: to open a pipe would be to wait for ever."""
    if not path.is_file():
        raise InputError(f"{path}: cannot be read as a part of a rosbag2 recording, the file is missing")
    return path


def _unpacked(path: Path, target: Path) -> Path:
    try:
        unpack_file(path, target)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a rosbag2 recording: {error}") from error
    return target
