"""Solves in a separate process: Python runs one thread of a process at a time, and messages must not wait."""

from __future__ import annotations

import math
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from operator import methodcaller
from typing import Any, Concatenate, ParamSpec, TypeVar

from geomid_ros.errors import GeomidError
from geomid_ros.live.threads import end_with_parent

_NICE = 5  # the process that takes messages has priority
_TRIES = 2  # of a solve whose process ends, as the solve may not be the cause
_LONGEST_PAUSE = 60.0  # [s] between processes that end without a result; an end is reported for as long
_SIGNALS = (signal.SIGINT, signal.SIGTERM)  # signals to the process group are handled by the parent

Task = TypeVar("Task")
Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")


class SolvingProcess:
    """Runs tasks one after the other in a process: solves, and checks of recordings.

    A process that ends, for example killed for its memory, is replaced by another, which gets the same task. If
    processes end one after the other without a result, the pauses between them grow.
    """

    def __init__(self) -> None:
        """Fork, so that nothing has to be imported again. No thread may have been started before."""
        self._solving = threading.Lock()
        self._closed = False
        self._given_up = False  # on the present task
        self._ends = self._fruitless = 0  # processes that ended; in a row without a result
        self._ended = -math.inf  # time [s] of the last end
        self._ended_process: Any = None  # the last process that ended
        self._begin("fork")

    def _begin(self, method: str) -> None:
        """Start a process. Use "spawn", which takes a second for imports, once there are threads: a fork would copy
        their locks in an arbitrary state."""
        context: Any = get_context(method)
        self._connection, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs,), daemon=True)
        masked = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)  # inherited by the process
        process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)
        self._process = process  # set once it can be killed
        theirs.close()
        self._tasks: dict[type, object] = {}  # tasks that the process has, one of each type

    @property
    def warning(self) -> str:
        """Warning that a process ended recently; empty if none did."""
        if self._closed:
            return ""
        if not self._process.is_alive():
            return "the solver process died, perhaps from lack of memory; it is being restarted"
        if time.monotonic() - self._ended > _LONGEST_PAUSE:
            return ""
        return f"the solver process died, perhaps from lack of memory, and was restarted, time {self._ends}"

    def remote(
        self, method: Callable[Concatenate[Task, Arguments], Answer]
    ) -> Callable[Concatenate[Task, Arguments], Answer]:
        """Return a method that runs ``method`` in the process.

        Its task, ``self``, which holds all constant data, is sent once. The method also raises GeomidError if the
        process ends more than once, or is ended by :meth:`give_up` or :meth:`close`.
        """

        def run(task: Task, /, *arguments: Arguments.args, **named: Arguments.kwargs) -> Answer:
            with self._solving:
                answer: Answer = self._answered(methodcaller(method.__name__, *arguments, **named), task)
            return answer

        return run

    def give_up(self) -> bool:
        """End the process during its task; the waiting caller gets an error. Return False if there is no task."""
        if not self._solving.locked():
            return False
        self._given_up = True
        self._process.kill()
        return True

    def _answered(self, call: Callable[[object], Any], task: object) -> Any:
        self._given_up = False
        for _ in range(_TRIES):
            if self._closed:
                return call(task)
            if not self._process.is_alive():
                self._note_end()
                self._replace()
            try:
                answer = self._answer(call, task)
            except (EOFError, OSError) as error:  # the process has ended
                self._note_end()
                if self._closed or self._given_up:
                    raise GeomidError("the solve was aborted") from error
                continue
            self._fruitless = 0
            if isinstance(answer, Exception):
                raise answer
            return answer
        raise GeomidError("the solver process died twice in this solve, perhaps from lack of memory")

    def _note_end(self) -> None:
        self._process.join()
        if self._ended_process is self._process:
            return
        self._ended_process = self._process
        self._ends += 1
        if not self._given_up:  # one that took too long needs no pause
            self._fruitless += 1
        self._ended = time.monotonic()

    def _replace(self) -> None:
        """Start another process. Raises GeomidError during the pause after processes that ended without a result."""
        pause = min(2.0**self._fruitless, _LONGEST_PAUSE) if self._fruitless >= _TRIES else 0.0
        remaining = self._ended + pause - time.monotonic()
        if remaining > 0.0:
            raise GeomidError(f"the solver process died; it is restarted in {remaining:.0f} s")
        self._begin("spawn")

    def _answer(self, call: Callable[[object], Any], task: object) -> Any:
        kind = type(task)
        sent_task = task if task is not self._tasks.get(kind) else None
        self._connection.send_bytes(pickle.dumps((call, kind, sent_task), pickle.HIGHEST_PROTOCOL))
        answer = pickle.loads(self._connection.recv_bytes())  # noqa: S301 it is ours
        self._tasks[kind] = task
        return answer

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._closed = True
        self._process.kill()
        self._process.join()


def _serve(connection: Connection[Any, Any]) -> None:
    """Run tasks until the parent is gone."""
    end_with_parent()
    os.nice(_NICE)
    tasks: dict[type, object] = {}
    while True:
        call, kind, sent_task = pickle.loads(connection.recv_bytes())  # noqa: S301 it is ours
        if sent_task is not None:
            tasks[kind] = sent_task
        try:
            answer = call(tasks[kind])
        except Exception as error:  # noqa: BLE001 the parent raises it
            answer = error
        connection.send_bytes(pickle.dumps(answer, pickle.HIGHEST_PROTOCOL))
