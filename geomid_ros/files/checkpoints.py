"""Checkpoints of a running node: everything the identification has learned, so that it can resume after a crash.

The folder keeps two generations, each complete, and the newest of the files that could not be used.
"""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

from geomid_ros.checks.causes import RecordingFault
from geomid_ros.errors import GeomidError, InputError, refusing
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.estimation.identifier import Memory
from geomid_ros.files.archive import MOST_HEADER, decoded, encoded, unarchived
from geomid_ros.files.disk import FOR_OWNER, make_folder, read_bytes, write_bytes
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import REGIMES
from geomid_ros.monitoring.payload_watch import WatchMemory
from geomid_ros.signals.ledger import Account

_NAMES = ("checkpoint-a.safetensors", "checkpoint-b.safetensors")
_LOCK = ".lock"
_ASIDE = "unused-"  # name prefix of files that could not be used
_MOST_ASIDE = 10


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """State from which an identification resumes after a crash.

    Attributes:
        meaning: Meaning of the rows (:attr:`Session.meaning`).
        memory: State of the identifier.
        accounts: Accounts of the ledger, by topic.
        warm: The last estimate.
        solving: Checksum of everything but the rows that the estimate depends on.
        number: Increases from checkpoint to checkpoint; of a written one.
        findings: Suspected faults of the recording that the rows are from.
        watch: State of the payload watch, if there is one.
    """

    meaning: Mapping[str, Any]
    memory: Memory
    accounts: Mapping[str, Account] = field(default_factory=dict)
    warm: WarmStart | None = None
    solving: str = ""
    number: int | None = None
    findings: tuple[RecordingFault, ...] = ()
    watch: WatchMemory | None = None


def last_meaning(folder: Path) -> Mapping[str, Any]:
    """Return the meaning of the newest readable checkpoint in a folder; empty if there is none."""
    documents: list[dict[str, Any]] = [{}]
    for name in _NAMES:
        with suppress(InputError):
            documents.append(unarchived(read_bytes(folder / name, "checkpoint")))
    newest = max(documents, key=lambda document: number if isinstance(number := document.get("number"), int) else -1)
    return meaning if isinstance(meaning := newest.get("meaning"), dict) else {}


class CheckpointFolder:
    """Checkpoint folder that belongs to one node at a time, until :meth:`close`."""

    def __init__(self, path: Path, meaning: Mapping[str, Any], channels: Sequence[Channel], folds: int) -> None:
        """Open the folder for rows of this ``meaning``, of ``channels`` in so many ``folds``. Make it, for its owner
        alone, if it does not exist.

        Raises GeomidError naming the folder, if others have access to it, it is in use, or it cannot be made.
        """
        self.path = path
        self._meaning = meaning
        numbers = sum((len(channel.columns) + 1) ** 2 + 1 for channel in channels)
        self._limit = 2 * MOST_HEADER + 8 * folds * REGIMES * numbers  # maximum size of a checkpoint [bytes]
        self._number = 0
        self._next = 0  # of the names
        self._in_the_way = ""
        with refusing(f"{path}: no folder for checkpoints", OSError, kind=GeomidError):
            make_folder(path)
            mode = stat.S_IMODE(path.stat().st_mode)
            if mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise GeomidError(f"{path}: no checkpoints in a folder that others may use (mode {mode:o}): chmod 700")
            self._lock = os.open(
                path / _LOCK, os.O_RDONLY | os.O_NONBLOCK | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, FOR_OWNER
            )
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._lock)
            raise GeomidError(f"{path}: another node keeps its checkpoints here; each needs its own folder") from error

    def close(self) -> None:
        """Release the folder for another node."""
        os.close(self._lock)

    def restore(self, use: Callable[[Checkpoint], None]) -> tuple[Checkpoint | None, tuple[str, ...]]:
        """Restore the newest checkpoint that is intact and of this robot and configuration, by calling ``use``.

        ``use`` raises InputError for a checkpoint that it cannot use. Such files are renamed, so that nothing
        overwrites them. Only the newest renamed files are kept.

        Returns:
            The restored checkpoint, None if there is none, and a sentence for each file that could not be used.
        """
        # Temporary files of a process that was killed while writing.
        _remove(file for name in _NAMES for file in self.path.glob(f".{name}.*"))
        checkpoints, problems = self._candidates()
        used = None
        for name in sorted(checkpoints, key=lambda name: checkpoints[name].number or 0, reverse=True):
            try:
                use(checkpoints[name])
            except InputError as error:
                problems[name] = str(error)
                continue
            used, self._number = checkpoints[name], checkpoints[name].number or 0
            self._next = 1 - _NAMES.index(name)
            break
        sentences = tuple(self._set_aside(name, problem) for name, problem in problems.items())
        # Sorting the renamed files by name sorts them by time.
        _remove(sorted(file for name in _NAMES for file in self.path.glob(f"{_ASIDE}*-{name}"))[:-_MOST_ASIDE])
        return used, sentences

    def _candidates(self) -> tuple[dict[str, Checkpoint], dict[str, str]]:
        """Readable checkpoints, and the problems of the other files, by name."""
        checkpoints, problems = {}, {}
        for name in _NAMES:
            path = self.path / name
            try:
                if path.is_symlink():
                    raise InputError("a link, which may lead out of the folder")  # noqa: TRY301
                if path.exists():
                    checkpoints[name] = decoded(Checkpoint, read_bytes(path, "checkpoint", self._limit), self._meaning)
            except InputError as error:
                problems[name] = str(error)
        return checkpoints, problems

    def _set_aside(self, name: str, problem: str) -> str:
        """Rename a file that cannot be used, and return a sentence about it."""
        path = self.path / name
        sentence = f"checkpoint {path} is not used: {problem}"
        try:
            return f"{sentence}; it is kept as {_renamed(path)}"
        except OSError as error:
            self._in_the_way = f"{path}: cannot be set aside ({error.strerror or error})"
            return sentence

    def write(self, checkpoint: Checkpoint) -> None:
        """Write a checkpoint over the older generation. Raises GeomidError naming the file."""
        if self._in_the_way:
            raise GeomidError(self._in_the_way)
        path = self.path / _NAMES[self._next]
        with refusing(f"{path}: cannot be written", InputError, kind=GeomidError):
            content = encoded(vars(replace(checkpoint, number=self._number + 1)), checkpoint.accounts)
        write_bytes(path, content)
        self._number += 1
        self._next = 1 - self._next


def _remove(files: Iterable[Path]) -> None:
    """Remove these files as far as possible."""
    for file in files:
        with suppress(OSError):
            file.unlink()


def _renamed(path: Path) -> str:
    """Rename a file to a unique name, and return that name. Raises OSError."""
    now = datetime.now(UTC)
    names = (f"{_ASIDE}{now:%Y%m%dT%H%M%S.%fZ}-{number}-{path.name}" for number in count())
    aside = next(path.with_name(name) for name in names if not path.with_name(name).exists())
    path.rename(aside)
    return aside.name
