"""Checkpoints of a running node: all that an identification has learned, so that it can go on after a crash.

Their folder has two generations, each whole, and the newest of those that could not be used.
"""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.estimation.identifier import Memory
from geomid_ros.files.archive import MOST_HEADER, decoded, encoded
from geomid_ros.files.disk import FOR_OWNER, make_folder, read_bytes, write_bytes
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import REGIMES
from geomid_ros.signals.ledger import Account

_NAMES = ("checkpoint-a.safetensors", "checkpoint-b.safetensors")
_LOCK = ".lock"
_ASIDE = "unused-"  # how the names of files begin that could not be used
_MOST_ASIDE = 10


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What an identification needs to go on after a crash.

    Attributes:
        meaning: What the rows mean (:attr:`Session.meaning`).
        memory: State of the identifier.
        accounts: The ledger's, by topic.
        warm: The last estimate.
        solving: Checksum of what the estimate depends on beside the rows.
        number: Greater than that of the checkpoint before.
    """

    meaning: Mapping[str, Any]
    memory: Memory
    accounts: Mapping[str, Account] = field(default_factory=dict)
    warm: WarmStart | None = None
    solving: str = ""
    number: int = 0


def largest_size(channels: Sequence[Channel], folds: int) -> int:
    """Bytes that no checkpoint of these channels exceeds."""
    numbers = sum((len(channel.columns) + 1) ** 2 + 1 for channel in channels)
    return 2 * MOST_HEADER + 8 * folds * REGIMES * numbers


@dataclass(frozen=True)
class Restored:
    """What was restored: the checkpoint, None if there is none, and a sentence on the problem with each of the
    others."""

    checkpoint: Checkpoint | None = None
    problems: tuple[str, ...] = ()


class CheckpointFolder:
    """A folder that belongs to one node at a time, from now until :meth:`close`."""

    def __init__(self, path: Path, meaning: Mapping[str, Any], channels: Sequence[Channel], folds: int) -> None:
        """For rows of this ``meaning``, of ``channels`` in so many ``folds``. Makes the folder, for its owner alone,
        unless it exists.

        Raises GeomidError naming the folder, when it is open to others, in use, or cannot be made.
        """
        self.path = path
        self._meaning = meaning
        self._limit = largest_size(channels, folds)
        self._number = 0
        self._next = _NAMES[0]
        self._in_the_way = ""
        try:
            make_folder(path)
            mode = stat.S_IMODE(path.stat().st_mode)
            if mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise GeomidError(f"{path}: no checkpoints in a folder that others may use (mode {mode:o}): chmod 700")
            self._lock = os.open(
                path / _LOCK, os.O_RDONLY | os.O_NONBLOCK | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, FOR_OWNER
            )
        except OSError as error:
            raise GeomidError(f"{path}: no folder for checkpoints ({error.strerror or error})") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._lock)
            raise GeomidError(f"{path}: another node keeps its checkpoints here; each needs its own folder") from error

    def close(self) -> None:
        """Let another node use the folder."""
        os.close(self._lock)

    def restore(self, use: Callable[[Checkpoint], None]) -> Restored:
        """Let ``use`` go on from the newest checkpoint that is whole and of this robot and configuration.

        ``use`` raises InputError for one that it cannot use. Such are renamed, so that nothing replaces them; of all
        that were ever renamed the newest are kept.
        """
        self._clear()
        found, problems = self._candidates()
        used = None
        for name in sorted(found, key=lambda name: -found[name].number):
            try:
                use(found[name])
            except InputError as error:
                problems[name] = str(error)
                continue
            used, self._number = found[name], found[name].number
            self._next = _other(name)
            break
        sentences = tuple(self._set_aside(name, problem) for name, problem in problems.items())
        self._clear_aside()
        return Restored(used, sentences)

    def _clear(self) -> None:
        """Remove what was being written when a process was killed."""
        for name in _NAMES:
            for left in self.path.glob(f".{name}.*"):
                with suppress(OSError):
                    left.unlink()

    def _clear_aside(self) -> None:
        """Remove the oldest of what was set aside: the names are in the order of time."""
        for old in sorted(path for name in _NAMES for path in self.path.glob(f"{_ASIDE}*-{name}"))[:-_MOST_ASIDE]:
            with suppress(OSError):
                old.unlink()

    def _candidates(self) -> tuple[dict[str, Checkpoint], dict[str, str]]:
        """The checkpoints that can be read, and what is wrong with the others, by name."""
        found, problems = {}, {}
        for name in _NAMES:
            path = self.path / name
            try:
                if path.is_symlink():
                    raise InputError("a link, which may lead out of the folder")  # noqa: TRY301
                if path.exists():
                    found[name] = decoded(Checkpoint, read_bytes(path, "checkpoint", self._limit), self._meaning)
            except InputError as error:
                problems[name] = str(error)
        return found, problems

    def _set_aside(self, name: str, problem: str) -> str:
        """Rename a file that cannot be used; a sentence about it."""
        path = self.path / name
        try:
            aside = _renamed(path)
        except OSError as error:
            self._in_the_way = f"{path}: cannot be set aside ({error.strerror or error})"
            return f"checkpoint {path} is not used: {problem}"
        return f"checkpoint {path} is not used: {problem}; it is kept as {aside}"

    def write(self, checkpoint: Checkpoint) -> None:
        """Write in place of the older generation. Raises GeomidError naming the file."""
        if self._in_the_way:
            raise GeomidError(self._in_the_way)
        path = self.path / self._next
        try:
            content = encoded(vars(replace(checkpoint, number=self._number + 1)), checkpoint.accounts)
        except InputError as error:
            raise GeomidError(f"{path}: cannot be written ({error})") from error
        write_bytes(path, content)
        self._number += 1
        self._next = _other(self._next)


def _other(name: str) -> str:
    """The name of the other generation."""
    return _NAMES[1 - _NAMES.index(name)]


def _renamed(path: Path) -> str:
    """Give a file a name that no other has; the new name. Raises OSError."""
    now = datetime.now(UTC)
    names = (f"{_ASIDE}{now:%Y%m%dT%H%M%S.%fZ}-{number}-{path.name}" for number in count())
    aside = next(path.with_name(name) for name in names if not path.with_name(name).exists())
    path.rename(aside)
    return aside.name
