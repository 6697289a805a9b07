"""The robot that is identified: its worker, built from a description, its checkpoints, and who looks after both."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from rclpy.impl.rcutils_logger import RcutilsLogger

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.live.checkpointing import Checkpoints, CheckpointStatus
from geomid_ros.live.solving_process import SolvingProcess
from geomid_ros.live.watchdog import Supervision
from geomid_ros.live.worker import Worker
from geomid_ros.ros.outputs import Outputs
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import Ledger

_PATIENCE = 0.9  # [s] for the threads to end; with the last checkpoint, and with all that takes, less than two


class Identification:
    """A worker on one robot, or on another one after it; none before the first description."""

    def __init__(
        self,
        configuration: Configuration,
        ledger: Ledger,
        outputs: Outputs,
        logger: RcutilsLogger,
        solving: SolvingProcess | None,
    ) -> None:
        self._configuration = configuration
        self._ledger = ledger
        self._outputs = outputs
        self._logger = logger
        self._solving = solving
        self._supervision = Supervision()
        self._checkpoints: Checkpoints | None = None
        self._worker: Worker | None = None

    @property
    def worker(self) -> Worker | None:
        """Who identifies now."""
        return self._worker

    @property
    def problem(self) -> str:
        """Of threads that hang, or a process that has ended."""
        return self._supervision.problem or (self._solving.problem if self._solving else "")

    @property
    def checkpoints(self) -> CheckpointStatus | None:
        """What is to be said of checkpoints, if there are to be any."""
        return self._checkpoints.status if self._checkpoints is not None else None

    def build(self, urdf: str, source: str) -> None:
        """Begin to identify the robot of this description. Raises InputError when it does not fit the parameters."""
        session = Session(urdf, self._configuration, source, self._ledger)
        if self._solving:
            session.identifier.solve_with(self._solving.solve)
        if self._worker is not None:
            self._worker.close()
        self._restore(session)
        self._worker = Worker(
            session, self._configuration["solve_period"], self._outputs.prediction, self._outputs.estimate
        )
        self._logger.info(
            f"identifying {len(session.model.body_names)} links from {len(session.model.channels)} channels"
        )
        if session.loaded.not_predicted:
            self._logger.warning(session.loaded.not_predicted)

    def _restore(self, session: Session) -> None:
        """With a folder for checkpoints, let a session go on from the one there, and write those to come."""
        if self._checkpoints is not None:
            self._checkpoints.close()
        if not self._configuration["checkpoint.folder"]:
            return
        folder = Path(self._configuration["checkpoint.folder"]).resolve()
        self._checkpoints = Checkpoints(session, folder, self._configuration["checkpoint.period"])
        if self._checkpoints.restored is not None and self._worker is None:
            self._ledger.restore(self._checkpoints.restored.accounts)
        status = self._checkpoints.status
        if status.error or status.warning:
            self._logger.error(status.error or status.warning)
        elif self._checkpoints.beginning:
            self._logger.info(self._checkpoints.beginning)

    def reset(self) -> None:
        """Forget all rows, and what went wrong with threads."""
        self._supervision.forget()
        if self._worker is not None:
            self._worker.reset()

    def look_after(self) -> None:
        """Restart what hangs."""
        if self._worker is not None:
            urdf = self._worker.session.urdf
            self._supervision.look_after(self._worker, lambda: self.build(urdf, "robot_description"))

    def close(self, save: Callable[[Session, Estimate, float], None]) -> None:
        """End the threads. ``save(session, estimate, patience)`` is told of the last estimate, and how long [s] it may
        take: at once, as whoever ends the node may not wait for a solver at work; and again if that has found another.
        """
        if self._worker is None:
            return
        end = time.monotonic() + _PATIENCE
        saved = self._save_last(self._worker, save, None, end)
        self._worker.close(max(0.0, end - time.monotonic()))
        self._save_last(self._worker, save, saved, end)
        if self._checkpoints is not None:
            self._checkpoints.close()

    @staticmethod
    def _save_last(
        worker: Worker, save: Callable[[Session, Estimate, float], None], saved: Estimate | None, end: float
    ) -> Estimate | None:
        estimate = worker.estimate
        if estimate is not None and estimate is not saved:
            save(worker.session, estimate, max(0.0, end - time.monotonic()))
        return estimate
