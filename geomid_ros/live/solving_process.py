"""Solves in a process of its own: Python runs one thread of a process at a time, and messages must not wait."""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
import threading
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.estimation.identifier import EstimationTask
from geomid_ros.estimation.summary import RowSummary

_NICE = 5  # the process that takes messages comes first
_PATIENCE = 60.0  # [s] for a solve whose caller has given up
_PR_SET_PDEATHSIG = 1  # of prctl(2)
_PROTOCOL = 5  # of pickle; it leaves read-only arrays read-only


class SolvingProcess:
    """Solves one task after the other.

    When the process has ended, or hangs in a solve whose caller has given up, the caller's own process solves.
    """

    def __init__(self) -> None:
        """Fork, so that nothing has to be imported again. No thread may have been started before."""
        context = get_context("fork")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._connection), daemon=True)
        self._process.start()
        theirs.close()
        self._task: EstimationTask | None = None  # that the process knows
        self._solving = threading.Lock()
        self._closed = False

    @property
    def problem(self) -> str:
        """That the process has ended; empty if it has not."""
        if self._process.is_alive():
            return ""
        return "the solving process has ended; until the node is started anew, messages wait for solves"

    def solve(self, task: EstimationTask, summary: RowSummary, warm: WarmStart | None) -> Estimate:
        """Like :meth:`EstimationTask.solve`.

        Raises:
            GeomidError: the solve failed, or :meth:`close` ended the process meanwhile.
        """
        if not self._solving.acquire(timeout=_PATIENCE):
            self.close()  # it hangs
            return task.solve(summary, warm)
        try:
            return self._solved(task, summary, warm)
        finally:
            self._solving.release()

    def _solved(self, task: EstimationTask, summary: RowSummary, warm: WarmStart | None) -> Estimate:
        if self._closed:
            return task.solve(summary, warm)
        try:
            answer = self._answer(task, summary, warm)
        except (EOFError, OSError) as error:  # the process has ended
            if self._closed:
                raise GeomidError("the solve was given up") from error
            return task.solve(summary, warm)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _answer(self, task: EstimationTask, summary: RowSummary, warm: WarmStart | None) -> Estimate | Exception:
        new = task if task is not self._task else None
        self._connection.send_bytes(pickle.dumps((new, summary, warm), _PROTOCOL))
        answer: Estimate | Exception = pickle.loads(self._connection.recv_bytes())  # noqa: S301 it is ours
        self._task = task
        return answer

    def close(self) -> None:
        """End the process, whatever it does."""
        self._closed = True
        self._process.kill()
        self._process.join()


def _serve(connection: Connection[Any, Any], parents: Connection[Any, Any]) -> None:
    """Solve what is asked for until the parent is gone."""
    parents.close()
    _end_with_parent()
    os.nice(_NICE)
    task: Any = None  # until the first request brings it
    while True:
        try:
            new, summary, warm = pickle.loads(connection.recv_bytes())  # noqa: S301 it is ours
        except EOFError:
            return
        task = new or task
        try:
            answer: Estimate | Exception = task.solve(summary, warm)
        except Exception as error:  # noqa: BLE001 the parent raises it
            answer = error
        connection.send_bytes(pickle.dumps(answer, _PROTOCOL))


def _end_with_parent() -> None:
    """End when the parent does, not before: signals to the whole group are the parent's to answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
