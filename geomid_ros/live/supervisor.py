"""Supervises the worker: builds it from the robot description, keeps checkpoints, and restarts threads that hang."""

from __future__ import annotations

import time
from concurrent.futures import Future, wait
from contextlib import suppress
from pathlib import Path
from typing import Protocol, TypeAlias

from geomid_ros.checks.recording_check import CheckTask
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.identifier import EstimationTask
from geomid_ros.files.checkpoints import last_meaning
from geomid_ros.files.models.readers import URDF
from geomid_ros.live.saving import HANDOVER, SLOW, Checkpoints, SaveOutcome, Saving
from geomid_ros.live.solving_process import SolvingProcess
from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.threads import PATIENCE
from geomid_ros.live.worker import Worker
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import locked_note, with_locked
from geomid_ros.session.session import Session
from geomid_ros.signals.kernels import check_cutoff
from geomid_ros.signals.ledger import Ledger

MOST_RESTARTS = 3  # of the intake, as a replaced thread cannot be ended
HANGING = 120.0  # [s] longer than any task on a busy machine, the first solve of a humanoid included
PUBLISHERS_START = 3.0
"""Time [s] within which messages of all published joints arrive."""

_Saved: TypeAlias = dict[Estimate, Future[SaveOutcome]]  # outcome of each estimate that was saved at the end


class Log(Protocol):
    """Logger of ROS, or one like it."""

    def info(self, message: str, /) -> object: ...
    def warning(self, message: str, /) -> object: ...
    def error(self, message: str, /) -> object: ...


class Supervisor:
    """Runs one worker at a time, none before the first description. Restarts what hangs in it a few times."""

    def __init__(
        self, configuration: Configuration, ledger: Ledger, log: Log, listener: Listener, solving: SolvingProcess | None
    ) -> None:
        """
        Args:
            configuration: configuration of every session.
            ledger: counts the messages of all workers.
            log: receives a line when a session begins.
            listener: receives the results of all workers.
            solving: the process that solves; None to solve in this one.
        """
        self._configuration, self._ledger, self._log = configuration, ledger, log
        self._listener = listener
        self.solving = solving
        """The process that solves; None to solve in this one."""
        self.saving = Saving(configuration["output_folder"])
        """Writes the workers' estimates."""
        self.failures = Failures()
        """Counts exceptions of the node and of all workers."""
        self._restarts = 0  # of the intake
        self._hanging: tuple[str, ...] = ()  # sentences on threads that hang and cannot be ended
        self._hung = ""  # sentence on a thread that hung, until the next estimate
        self._solves = 0  # of the worker, when it hung
        self._absent: tuple[str, ...] = ()  # joints that are locked, as nobody publishes them
        self._agreed = 0.0  # time [s] at which ``_absent`` last matched the messages
        self._period = 0.0  # of the time grid of earlier workers [s]; 0 while it is unknown
        self.checkpoints: Checkpoints | None = None  # of the present worker, if any are kept
        self.worker: Worker | None = None  # present worker

    @property
    def problems(self) -> tuple[str, ...]:
        """Sentences on what hangs, on what hung without an estimate since, and on what is wrong with saving."""
        return (*self._hanging, self._hung, *self.saving.problems)

    def build(self, urdf: str, source: str, absent: tuple[str, ...] | None = None) -> None:
        """Begin to identify the robot of a description.

        Args:
            urdf: the robot description.
            source: its origin, for messages.
            absent: joints to lock, as nobody publishes them; None for those of the checkpoint.

        Raises:
            InputError: the description does not fit the parameters.
        """
        absent = self._absent_before(urdf, source) if absent is None else absent
        session = self.new_session(urdf, source, absent)
        if self.solving:
            session.identifier.solve_with(self.solving.remote(EstimationTask.solve))
            session.review.judge_with(self.solving.remote(CheckTask.judge))
        if self.worker is not None:
            self.worker.close()
            self._period = self._latest_period
            self._listener.on_payload(None)
        self._restore(session)
        self.worker = Worker(session, self._configuration["solve_period"], self._listener, self.failures)
        self._solves = 0
        self._log.info(f"identifying {len(session.model.body_names)} links from {len(session.model.channels)} channels")
        session.review.settled += [locked_note(absent)] if absent else []
        for warning in (*session.review.warnings(), *session.review.settled):
            self._log.warning(warning)
        self._absent, self._agreed = absent, time.monotonic()

    def new_session(self, urdf: str, source: str, absent: tuple[str, ...] = ()) -> Session:
        """Return a session without rows. Arguments and errors as of :meth:`build`."""
        return Session(urdf, with_locked(self._configuration, absent), source, self._ledger, (URDF,))

    def _absent_before(self, urdf: str, source: str) -> tuple[str, ...]:
        """Joints that were locked when the last checkpoint was written, as nobody published them."""
        folder, locked = self._configuration["checkpoint.folder"], self._configuration["locked_joints"]
        meaning = last_meaning(Path(folder).resolve()) if folder else {}
        with suppress(InputError, TypeError):  # it may be of another robot or configuration, or crafted
            absent = tuple(joint for joint in meaning.get("locked_joints", ()) if joint not in locked)
            if absent and self.new_session(urdf, source, absent).meaning == meaning:
                return absent
        return ()

    def reconfigure(self, configuration: Configuration, *, rebuild: bool) -> None:
        """Solve with another configuration from now on; with ``rebuild`` only from the next :meth:`build` on.

        Raises:
            InputError: the configuration does not fit.
        """
        if rebuild and self._latest_period and not configuration["filter.period"]:
            check_cutoff(configuration["filter.cutoff"], self._latest_period)
        self._configuration = configuration
        if self.worker is not None and not rebuild:
            self.worker.solver.reconfigure(with_locked(self._configuration, self._absent))

    @property
    def _latest_period(self) -> float:
        return (self.worker.session.pipeline.period if self.worker is not None else 0.0) or self._period

    def _restore(self, session: Session) -> None:
        """If a checkpoint folder is configured, resume the session from its checkpoint and write new ones."""
        if self.checkpoints is not None:
            self.checkpoints.close(HANDOVER)
        if not self._configuration["checkpoint.folder"]:
            return
        folder = Path(self._configuration["checkpoint.folder"]).resolve()
        self.checkpoints = kept = Checkpoints(session, folder, self._configuration["checkpoint.period"])
        if kept.restored is not None and self.worker is None:
            self._ledger.restore(kept.restored.accounts)
        if problem := kept.status.problem:
            self._log.error(problem)
        elif kept.beginning:
            self._log.info(kept.beginning)

    def reset(self) -> None:
        """Discard all rows, and forget that threads hung."""
        self._restarts, self._hung = 0, ""
        if self.worker is not None:
            self.worker.reset()

    def lock_absent_joints(self) -> None:
        """Rebuild with the joints locked that nobody publishes, if they may be locked; release those that are published
        after all."""
        if self.worker is None:
            return
        session, now = self.worker.session, time.monotonic()
        absent = (*(joint for joint in self._absent if joint not in session.received_joints), *session.lockable)
        if absent == self._absent:
            self._agreed = now
        elif now - self._agreed > PUBLISHERS_START:
            self._agreed = now
            try:
                self.build(session.urdf, "robot_description", absent)
            except InputError as error:
                self._log.error(str(error))

    def restart_hung_threads(self) -> None:
        """End the solving process if a solve hangs; if the intake hangs, replace the worker: its rows are lost, or
        restored from the last checkpoint."""
        worker = self.worker
        if worker is None:
            return
        intake, solver = (part.activity.current[1] > HANGING for part in (worker, worker.solver))
        if intake and self._restarts < MOST_RESTARTS:
            self._restarts += 1
            self._hung = f"message processing hung and was restarted, {self._restarts} of at most {MOST_RESTARTS} times"
            self.build(worker.session.urdf, "robot_description", self._absent)
            return
        if solver and self.solving and self.solving.give_up():
            worker.solver.activity.restart_timer()
            self._hung, self._solves, solver = "the solver hung and was restarted", worker.solver.solves, False
        elif worker.solver.solves > self._solves:
            self._hung = ""
        self._hanging = (
            *([f"message processing hangs again after {MOST_RESTARTS} restarts; no restart until ~/reset"] * intake),
            *(["the solver thread hangs outside a solve; restart the node"] * solver),
        )

    def close(self) -> None:
        """End the threads, and save the last estimate if an output folder is set. It is saved at once, as a running
        solve may take too long, and again if the solver makes a newer one in time."""
        if self.worker is None:
            return
        begin = time.monotonic()
        saved = self._save_last(self.worker, {}, begin)
        self.worker.close(max(0.0, begin + PATIENCE - time.monotonic()))
        saved = self._save_last(self.worker, saved, begin)
        if self.checkpoints is not None:
            self.checkpoints.close()
        for outcome in saved.values():  # late, as saving goes on meanwhile
            self._report_saved(outcome, begin)
        self._period = self._latest_period
        self.worker = self.checkpoints = None
        self._restarts, self._hung, self._hanging = 0, "", ()

    def _save_last(self, worker: Worker, saved: _Saved, begin: float) -> _Saved:
        """Save the last estimate, unless that began already; wait until :data:`PATIENCE` after ``begin`` [s]. No newer
        one is begun after that: the process would end in the middle of it."""
        estimate, left = worker.estimate, begin + PATIENCE - time.monotonic()
        may_save = self._configuration["output_folder"] and (left > 0.0 or not saved)
        if may_save and estimate is not None and estimate not in saved:
            saved = {**saved, estimate: self.saving.save_last(worker.session, estimate)}
            wait(saved.values(), max(0.0, left))
        return saved

    def _report_saved(self, outcome: Future[SaveOutcome], begin: float) -> None:
        """Log what became of an estimate."""
        if not outcome.done():
            self._log.error(f"the last estimate may not be saved: {SLOW} after {time.monotonic() - begin:.1f} s")
            return
        is_saved, sentence = outcome.result()
        if is_saved:
            self._log.info(sentence)
        else:
            self._log.error(f"the last estimate is not saved: {sentence}")
