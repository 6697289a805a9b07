"""Saves a live session in threads, as a disk may be slow or full: checkpoints, and estimates on request.

The last checkpoint is restored at the start.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.checkpoints import Checkpoint, CheckpointFolder
from geomid_ros.files.disk import check_writable
from geomid_ros.files.models.posterior import POSTERIOR, write_posterior
from geomid_ros.gap.features import KnownRemainder
from geomid_ros.live.threads import PATIENCE, Activity, start_daemon, start_later
from geomid_ros.live.worker import LONG, Worker
from geomid_ros.session.session import Session, save

HANDOVER = 5.0  # [s] for the last checkpoint of a session if another one is to use its folder
_LATEST = 4.8  # [s] latest time of an answer
_LATE = _LATEST / 2.0  # [s] to wait for an estimate from all data; then the last one is saved

FOLLOWS = "and follows"
"""Part of an answer: the saved estimate is not of all data yet."""
NOT_YET = "no estimate yet"
SLOW = "saving has not ended"
"""Parts of answers: nothing is saved so far."""

SaveOutcome: TypeAlias = tuple[bool, str]
"""True if an estimate was saved, and a sentence."""


@dataclass(frozen=True)
class CheckpointStatus:
    """State of the checkpoints: a sentence on a ``problem``, whether it ``is_error`` or a warning, and ``values`` for
    diagnostics."""

    problem: str = ""
    is_error: bool = False
    values: dict[str, object] = field(default_factory=dict)


class Checkpoints:
    """Writes checkpoints of a session into a folder.

    Problems with the folder or the disk are not raised: :attr:`status` reports them, and the session goes on.
    """

    def __init__(self, session: Session, folder: Path, period: float) -> None:
        """Restore the checkpoint in the folder, if there is one, and begin to write new ones.

        The caller, who has the ledger, restores the accounts of that checkpoint.

        Args:
            session: not in use yet.
            folder: used by this session alone.
            period: [s] between checkpoints; none is written while no rows come.
        """
        self._session, self._period = session, period
        self._problem = ""
        self.restored: Checkpoint | None = None
        """Checkpoint that the session was resumed from; None if there was none."""
        self.beginning = ""
        """Sentence on how the session began; empty if the folder was empty."""
        self._unusable: tuple[str, ...] = ()  # sentences on files that could not be restored
        self._rows = 0  # in the last checkpoint
        self._written = 0
        self._seconds = 0.0  # duration of the last checkpoint
        self._activity = Activity()  # of the thread
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        try:
            disk = CheckpointFolder(folder, session.meaning, session.model.channels, session.configuration.buffer.folds)
        except GeomidError as error:
            self._problem = str(error)
            return
        self.restored, self._unusable = disk.restore(session.restore)
        began = "started without rows" if self._unusable else ""
        if self.restored is not None:
            began = f"resumed from checkpoint {self.restored.number} with {self.restored.memory.summary.rows} rows"
        self.beginning = "; ".join(filter(None, (began, *self._unusable)))
        self._rows = session.identifier.rows
        self._thread = start_daemon("checkpoints", self._write_repeatedly, disk)

    def close(self, patience: float = PATIENCE) -> None:
        """Write a last checkpoint, and end; wait for it no longer than ``patience`` [s]."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(patience)

    @property
    def status(self) -> CheckpointStatus:
        """Present state. A problem at the start is an error or a warning until a checkpoint is written."""
        values: dict[str, object] = {
            "beginning": self.beginning,
            "written": self._written,
            "rows": self._rows,
            "seconds": self._seconds,
        }
        error, seconds = self._problem, max(self._seconds, self._activity.current[1])
        if not error and seconds > self._period:
            error = f"the disk is slow: a checkpoint takes {seconds:.1f} s, more than checkpoint.period"
        doubt = self.beginning if self._unusable and not self._written else ""
        return CheckpointStatus(error or doubt, bool(error) or self.restored is None, values)

    def _write_repeatedly(self, folder: CheckpointFolder) -> None:
        with closing(folder):
            while not self._ending.wait(self._period):
                if self._session.identifier.rows != self._rows:
                    self._write(folder)
            if self._session.identifier.rows != self._rows or (self._rows and self._session.pipeline.ledger.topics):
                self._write(folder)

    def _write(self, folder: CheckpointFolder) -> None:
        begin = time.monotonic()
        try:
            with self._activity.doing("writing"):
                checkpoint = self._session.checkpoint()
                folder.write(checkpoint)
        except Exception as error:  # noqa: BLE001 the thread must survive a broken disk; the status reports it
            self._problem = str(error)
        else:
            self._problem = ""
            self._written += 1
            self._rows = checkpoint.memory.summary.rows
        self._seconds = time.monotonic() - begin


class Saving:
    """Saves estimates into a folder."""

    def __init__(self, folder: str) -> None:
        """An empty ``folder`` is the working directory."""
        self._folder = Path(folder or ".").resolve()
        self._activity = Activity()
        self._problem = ""
        if folder:
            try:
                check_writable(self._folder)
            except GeomidError as error:
                self._problem = f"output_folder {error}"
        self._saved: Estimate | None = None
        self._remainder: KnownRemainder | None = None  # of the saved estimate, once it is computed
        self._one_at_a_time = threading.Lock()

    @property
    def problems(self) -> tuple[str, ...]:
        """Sentences on why the last attempt failed, and on a slow one."""
        _, seconds = self._activity.current
        slow = f"saving into {self._folder} takes {seconds:.0f} s so far" if seconds > LONG else ""
        return tuple(filter(None, (self._problem, slow)))

    def begin(self, worker: Worker, result: Estimate | GeomidError, done: Callable[[SaveOutcome], None]) -> None:
        """Save in a thread. The estimate's remainder, which takes longer to compute, is saved after the answer.

        Args:
            worker: the source of the estimate.
            result: the estimate, or why there is none.
            done: called in the thread with True if that succeeded, and a sentence.
        """
        start_daemon("saving", self._save_whole, worker, result, done)

    def _save_whole(self, worker: Worker, result: Estimate | GeomidError, done: Callable[[SaveOutcome], None]) -> None:
        answer = self._save(worker.session, result)
        done(answer)
        if isinstance(result, Estimate) and answer[0] and self._remainder is None:
            self._save_remainder(worker, result)

    def _save_remainder(self, worker: Worker, estimate: Estimate) -> None:
        """Add the estimate's remainder in the remembered data to the files, unless another was saved meanwhile."""
        from geomid_ros.session.gap import identified_session, remainder_in_messages  # noqa: PLC0415 a third of the start

        try:
            messages = worker.session.recent.entries()  # all, as the estimate is of all, even if a gap is open
            remainder = remainder_in_messages(identified_session(worker.session, estimate), messages)
            with self._one_at_a_time:
                if remainder is not None and self._saved is estimate:
                    self._remainder = remainder
                    write_posterior(self._folder / POSTERIOR, estimate.posterior, remainder)
        except Exception as error:  # noqa: BLE001 as below
            self._problem = f"the remainder could not be saved: {error}"

    def begin_when_solved(self, worker: Worker, done: Callable[[SaveOutcome], None]) -> None:
        """Save an estimate from all data so far, in threads; the last estimate if that takes long to solve.

        Args:
            worker: the source of the estimate.
            done: called once, within five seconds, with True if that succeeded, and a sentence.
        """
        answered = threading.Lock()  # never released

        def answer(outcome: SaveOutcome) -> None:
            if answered.acquire(blocking=False):
                done(outcome)

        worker.request_estimate(lambda result: self.begin(worker, result, answer))

        def save_last() -> None:
            last = worker.estimate
            if answered.locked() or last is None:
                return
            late = (
                f"; it uses {last.rows_accepted} rows; an estimate from all rows takes more than {_LATE:g} s, {FOLLOWS}"
            )
            self.begin(worker, last, lambda saved: answer((saved[0], saved[1] + late)))

        def give_up() -> None:
            first = f"{NOT_YET}: the first one takes more than {_LATEST:g} s; ask again later"
            answer((False, first if worker.estimate is None else f"{SLOW} after {_LATEST:g} s"))

        start_later(_LATE, save_last)
        start_later(_LATEST, give_up)

    def save_last(self, session: Session, estimate: Estimate) -> Future[SaveOutcome]:
        """Save in a thread, without the remainder."""
        outcome: Future[SaveOutcome] = Future()
        start_daemon("saving", lambda: outcome.set_result(self._save(session, estimate)))
        return outcome

    def _save(self, session: Session, result: Estimate | GeomidError) -> SaveOutcome:
        if isinstance(result, GeomidError):
            return False, str(result)
        with self._one_at_a_time, self._activity.doing("saving"):
            try:
                verdict = session.review.verdict(result)
                files = save(session, self._folder, result, verdict=verdict)
                if self._saved is not result:
                    self._saved, self._remainder = result, None
                if self._remainder is not None:
                    write_posterior(self._folder / POSTERIOR, result.posterior, self._remainder)
            except Exception as error:  # noqa: BLE001 the caller must have an answer
                self._problem = f"the estimate could not be saved: {error}"
                return False, str(error)
        self._problem = ""
        return True, "; ".join([*verdict.remarks, f"written: {', '.join(map(str, files))}"])
