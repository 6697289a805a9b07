"""Who watches over the worker's threads: one that hangs is given up, and another takes its place."""

from __future__ import annotations

from collections.abc import Callable

from geomid_ros.live.worker import Worker

MOST_RESTARTS = 3
HANGING = 120.0  # [s] nothing takes so long on a busy machine, not even the first solve of a humanoid


class Supervision:
    """Restarts hanging threads, but not for ever."""

    def __init__(self) -> None:
        self._restarts = 0
        self._problem = ""

    @property
    def problem(self) -> str:
        """What was restarted, or is not any more."""
        return self._problem

    def forget(self) -> None:
        """Somebody has seen to it."""
        self._restarts, self._problem = 0, ""

    def look_after(self, worker: Worker, begin_anew: Callable[[], None]) -> None:
        """Restart the solver if it hangs; if the intake does, let ``begin_anew`` replace the worker, whose rows are
        lost."""
        solver, intake = worker.solver.duty.current[1] > HANGING, worker.duty.current[1] > HANGING
        if not solver and not intake:
            return
        what = "the intake of messages" if intake else "the solver"
        if self._restarts == MOST_RESTARTS:
            self._problem = f"{what} hangs again after {MOST_RESTARTS} restarts and is left alone"
            return
        self._restarts += 1
        self._problem = f"{what} hung and was restarted, {self._restarts} of at most {MOST_RESTARTS} times"
        if intake:
            begin_anew()
        else:
            worker.solver.restart()
