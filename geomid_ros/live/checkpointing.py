"""Checkpoints of a live session: the last one is restored at the start, a thread writes new ones."""

from __future__ import annotations

import threading
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from geomid_ros.errors import GeomidError
from geomid_ros.files.checkpoints.checkpoint import Checkpoint
from geomid_ros.files.checkpoints.checkpoint_folder import CheckpointFolder, Restored
from geomid_ros.session.session import Session

_PATIENCE = 0.4  # [s] for the last checkpoint
_SHORTEST_PAUSE = 0.1  # share of the period, between checkpoints that take long


@dataclass(frozen=True)
class CheckpointStatus:
    """How the checkpoints are: an ``error`` or a ``warning`` if anything is wrong, and ``values`` for diagnostics."""

    error: str = ""
    warning: str = ""
    values: dict[str, object] = field(default_factory=dict)


class Checkpoints:
    """Writes what a session knows into a folder.

    Nothing that is wrong with the folder or the disk is raised: :attr:`status` tells it, and the session goes on.
    """

    def __init__(self, session: Session, folder: Path, period: float) -> None:
        """Restore the checkpoint in the folder, if there is one, and begin to write new ones.

        The accounts of that checkpoint (:attr:`restored`) are left to the caller, who has the ledger.

        Args:
            session: not in use yet.
            folder: of this session alone.
            period: [s] between checkpoints; none is written while no rows come.
        """
        self._session = session
        self._period = period
        self._problem = ""
        self._restored = Restored()
        self._rows = 0  # in the last checkpoint
        self._written = 0
        self._seconds = 0.0  # that the last checkpoint took
        self._begin: float | None = None  # of the checkpoint that is being written
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        try:
            kept = CheckpointFolder(folder, session.meaning, session.model.channels, session.configuration.buffer.folds)
        except GeomidError as error:
            self._problem = str(error)
            return
        self._restored = kept.restore(session.restore)
        self._rows = session.identifier.rows
        # A daemon: the process may end while a slow disk is waited for.
        self._thread = threading.Thread(
            target=self._write_repeatedly, args=(kept,), name="geomid-checkpoints", daemon=True
        )
        self._thread.start()

    @property
    def restored(self) -> Checkpoint | None:
        """The checkpoint from which the session goes on, None if there was none."""
        return self._restored.checkpoint

    def close(self) -> None:
        """Write a last checkpoint, unless it takes long, and end."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    @property
    def beginning(self) -> str:
        """How the session began, in a sentence; empty if the folder was empty."""
        found = self._restored
        if found.checkpoint is None:
            return "; ".join(["begins without rows", *found.problems]) if found.problems else ""
        goes_on = f"goes on from checkpoint {found.checkpoint.number} with {found.checkpoint.memory.summary.rows} rows"
        return "; ".join([goes_on, *found.problems])

    @property
    def status(self) -> CheckpointStatus:
        """The present state. A problem at the start is an error or a warning until a checkpoint is written."""
        values: dict[str, object] = {
            "beginning": self.beginning,
            "written": self._written,
            "rows": self._rows,
            "seconds": self._seconds,
        }
        error, warning = self._problem or self._slowness, ""
        if self._restored.problems and not self._written:
            if self._restored.checkpoint is None:
                error = error or self.beginning
            else:
                warning = self.beginning
        return CheckpointStatus(error, warning, values)

    @property
    def _slowness(self) -> str:
        begin = self._begin
        seconds = self._seconds if begin is None else max(self._seconds, time.monotonic() - begin)
        if seconds <= self._period:
            return ""
        return f"the disk is slow: a checkpoint takes {seconds:.1f} s, more than checkpoint.period"

    def _write_repeatedly(self, folder: CheckpointFolder) -> None:
        with closing(folder):
            while not self._ending.wait(max(self._period - self._seconds, _SHORTEST_PAUSE * self._period)):
                if self._has_new_rows:
                    self._write(folder)
            if self._has_new_rows or self._session.pipeline.ledger.topics:
                self._write(folder)

    @property
    def _has_new_rows(self) -> bool:
        return self._session.identifier.rows != self._rows

    def _write(self, folder: CheckpointFolder) -> None:
        self._begin = begin = time.monotonic()
        try:
            checkpoint = self._session.checkpoint()
            folder.write(checkpoint)
        except Exception as error:  # noqa: BLE001 the thread must outlive a broken disk; the status reports it
            self._problem = str(error)
        else:
            self._problem = ""
            self._written += 1
            self._rows = checkpoint.memory.summary.rows
        self._seconds, self._begin = time.monotonic() - begin, None
