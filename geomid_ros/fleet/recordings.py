"""Bags of a fleet and their robots: in folders, by a pattern, or listed in a table."""

from __future__ import annotations

import csv
import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from geomid_ros.errors import GeomidError, InputError, unknown_name

_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.lz4", ".db3.lz4")
_METADATA = "metadata.yaml"
_PATTERN = frozenset("*?[")
_TABLE = ".csv"
_BAG = "bag"  # the table's column
# Keys of file systems for the time of the last change, or for a checksum of the content.
_CHANGED = ("mtime", "LastModified", "last_modified", "updated", "ETag", "etag", "modified", "created")


def file_system(url: str) -> tuple[Any, str]:
    """Find the file system of a path or URL (fsspec), and the path there.

    Raises:
        InputError: fsspec, or a package that it needs for this kind of URL, is not installed, or the kind is unknown.
    """
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415 an extra
    except ImportError as error:
        raise InputError("geomid fleet needs the extra 'fleet': pip install geomid_ros[fleet]") from error
    try:
        result: tuple[Any, str] = url_to_fs(url)
    except (ImportError, ValueError, OSError) as error:
        raise InputError(f"{url}: cannot be reached ({error})") from error
    return result


def is_local(system: Any) -> bool:
    """True if a file system is this machine's."""
    return "file" in (system.protocol if isinstance(system.protocol, tuple) else (system.protocol,))


@dataclass(frozen=True)
class FleetBag:
    """A bag of a ``robot``: its path or ``url``, and the ``fingerprint`` of its files' names, sizes and times."""

    robot: str
    url: str
    fingerprint: str


def find_bags(source: str, by: str = "robot") -> list[FleetBag]:
    """Find all bags of a fleet, sorted by robot and address.

    Args:
        source: a folder, a pattern, or a .csv file, on a disk or by a URL that fsspec knows. The robot of a bag is the
            folder that contains it. A table has the columns ``bag``, addresses that may be relative to its folder, and
            ``by``.
        by: the column that names the robot.

    Raises:
        InputError: there is none, or the source cannot be read.
    """
    system, path = file_system(source)
    try:
        if path.endswith(_TABLE):
            bags = list(_listed(source, system, path, by))
        else:
            places = sorted(system.glob(path)) if _PATTERN & set(path) else [path]
            bags = [_bag(system, bag, files) for place in places for bag, files in _bags_below(system, place)]
    except OSError as error:
        raise InputError(f"{source}: cannot be listed ({error})") from error
    if not bags:
        raise InputError(f"{source}: no rosbag found, expected ROBOT/BAG folders, a pattern or a .csv file")
    return sorted(set(bags), key=lambda bag: (bag.robot, bag.url))


def _listed(source: str, system: Any, path: str, by: str) -> Iterator[FleetBag]:
    """Yield the bags in a table."""
    with system.open(path, "r", encoding="utf-8", newline="") as file:
        table = csv.DictReader(file)
        for column in (_BAG, by):
            if column not in (table.fieldnames or ()):
                raise InputError(f"{source}: {unknown_name('column', column, table.fieldnames or ())}")
        entries = [(row[_BAG] or "", row[by] or "") for row in table]
    for line, (bag, robot) in enumerate(entries, 2):
        if not bag or not robot:
            raise InputError(f"{source}: line {line} has no {_BAG} or no {by}")
        url = bag if "://" in bag or PurePosixPath(bag).is_absolute() else f"{source.rpartition('/')[0] or '.'}/{bag}"
        bag_system, place = file_system(url)
        bags = list(_bags_below(bag_system, place))
        # A missing bag is no reason to refuse the others: it is reported when it is read.
        for address, files in bags or [(place, {})]:
            yield _bag(bag_system, address, files, robot)


def _bags_below(system: Any, path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield every bag at or below a path, with its files."""
    if path.endswith(_SUFFIXES) and system.isfile(path):
        yield path, {path: system.info(path)}
        return
    by_folder: dict[str, dict[str, Any]] = {}
    for name, info in _files_below(system, path):
        by_folder.setdefault(name.rpartition("/")[0], {})[name] = info
    for folder, files in sorted(by_folder.items()):
        if any(name.endswith((*_SUFFIXES, f"/{_METADATA}")) for name in files):
            yield folder, files


def _files_below(system: Any, path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield every file with its details; on disks also behind links to folders, each folder once."""
    if not is_local(system):
        yield from system.find(path, detail=True).items()
        return
    seen: set[str] = set()
    for folder, folders, names in os.walk(path, followlinks=True):
        folders.sort()
        real = os.path.realpath(folder)
        if real in seen:
            folders.clear()
            continue
        seen.add(real)
        for name in names:
            with suppress(FileNotFoundError):  # a link to nowhere
                file = f"{folder}/{name}"
                yield file, system.info(file)


def _bag(system: Any, path: str, files: Mapping[str, Any], robot: str = "") -> FleetBag:
    url = path if is_local(system) else system.unstrip_protocol(path)
    name = robot or PurePosixPath(path).parent.name
    if not name.isprintable() or "/" in name or name in ("", ".", ".."):
        raise InputError(f"{url}: the robot's name is {name!r}, which is not a valid folder name")
    # A listing of a web server knows names only.
    details = [info if info.get("size") is not None else system.info(file) for file, info in sorted(files.items())]
    return FleetBag(name, url, _fingerprint(details))


def _fingerprint(files: Iterable[Mapping[str, Any]]) -> str:
    """Checksum of names, sizes and times of files."""
    details = [
        (info["name"].rpartition("/")[2], info["size"], next((str(info[key]) for key in _CHANGED if key in info), ""))
        for info in files
    ]
    return hashlib.sha256(repr(details).encode()).hexdigest()


@contextmanager
def on_this_disk(url: str) -> Iterator[Path]:
    """Yield the path of a bag, or of a temporary copy if it is elsewhere, for a ``with`` statement.

    Raises:
        GeomidError: it cannot be copied now.
    """
    system, path = file_system(url)
    if is_local(system):
        yield Path(path)
        return
    with TemporaryDirectory(prefix="geomid_bag_") as folder:
        name = PurePosixPath(path.rstrip("/")).name
        try:
            files = [path] if path.endswith(_SUFFIXES) else sorted(system.find(path))
            targets = [str(Path(folder, name, file.rpartition("/")[2])) for file in files]
            system.get(files, targets)
        except OSError as error:
            raise GeomidError(f"{url}: cannot be copied ({error})") from error
        if not files:
            raise GeomidError(f"{url}: no such bag")
        yield Path(targets[0] if files == [path] else Path(folder, name))
