"""The node with faults planted in its parts: which one is said by a file, and may change while it runs.

``python -m ros.faulty``. The file is named by the environment; it has the fault's name, or nothing.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from geomid_ros.estimation.identifier import EstimationTask, Identifier
from geomid_ros.live import saving, supervisor, threads
from geomid_ros.live.worker import Worker
from geomid_ros.ros import main

VARIABLE = "GEOMID_TEST_FAULT"
AT_ONCE, SLOW_MACHINE = 100, 0.003  # messages that are taken together, and [s] for each on a slow machine
COMPUTES = "solver computes for ever"
HANGING = (COMPUTES, "intake hangs", "everything hangs")


def fault() -> str:
    """The present fault."""
    path = Path(os.environ[VARIABLE])
    return path.read_text() if path.exists() else ""


def plant(owner: Any, name: str, acts: dict[str, Callable[..., Any]]) -> None:
    """While the fault is one of ``acts``, call that with the method and its arguments instead of the method."""
    healthy = getattr(owner, name)

    @wraps(healthy)  # under its name it is found in another process
    def act(*arguments: Any, **named: Any) -> Any:
        found = acts.get(fault())
        return found(healthy, *arguments, **named) if found else healthy(*arguments, **named)

    setattr(owner, name, act)


def fail(*_: Any, **__: Any) -> None:
    raise ZeroDivisionError("planted")


def hang(*_: Any, **__: Any) -> None:
    threading.Event().wait()


class Watch:
    """Looks for what hangs with less patience from a fault that hangs on, until there is another or it ends by itself:
    else a solve may take long on a busy machine."""

    def __init__(self) -> None:
        self._look = supervisor.Supervisor.restart_hung_threads
        self._fault = ""

    def __call__(self, of: supervisor.Supervisor) -> None:
        if (found := fault()) or self._fault == COMPUTES:
            self._fault = found
        with patch.object(supervisor, "HANGING", 4.0 if self._fault in HANGING else supervisor.HANGING):
            self._look(of)


def compute(*_: Any, **__: Any) -> None:
    """For ever, as far as the node can tell; it leaves the processor to others."""
    while fault():
        time.sleep(0.01)
    raise TimeoutError("planted")


def full(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def read_only(*_: Any, **__: Any) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def unconverged(healthy: Any, *arguments: Any) -> Any:
    return replace(healthy(*arguments), converged=False, reason="planted: no step helps")


def not_a_number(healthy: Any, *arguments: Any) -> Any:
    estimate = healthy(*arguments)
    return replace(estimate, parameters=np.full_like(estimate.parameters, np.nan))


def slowly(healthy: Any, *arguments: Any) -> Any:
    time.sleep(2.5)
    return healthy(*arguments)


def waiting(healthy: Any, *arguments: Any) -> Any:
    """As long as the fault lasts."""
    while fault():
        time.sleep(0.01)
    return healthy(*arguments)


def as_a_slow_machine(healthy: Any, owner: Any, messages: list[Any]) -> Any:
    time.sleep(SLOW_MACHINE * len(messages))
    return healthy(owner, messages)


def shut_down(*_: Any) -> None:
    import rclpy  # noqa: PLC0415

    rclpy.shutdown()


def _healthily(healthy: Any, *arguments: Any) -> Any:
    return healthy(*arguments)


def of_wrenches(act: Callable[..., Any]) -> Callable[..., Any]:
    """The fault for wrenches; other messages are taken."""

    def choose(healthy: Any, owner: Any, topic: Any, *arguments: Any) -> Any:
        return (act if "/wrench" in topic else _healthily)(healthy, owner, topic, *arguments)

    return choose


def with_wrenches(act: Callable[..., Any]) -> Callable[..., Any]:
    """The fault for messages with wrenches among them; others are taken."""

    def choose(healthy: Any, owner: Any, messages: list[Any]) -> Any:
        chosen = act if any("/wrench" in message.topic for message in messages) else _healthily
        return chosen(healthy, owner, messages)

    return choose


def plant_in_solving_process() -> None:
    """In this one, and in those that take its place."""
    plant(EstimationTask, "solve", {
        COMPUTES: compute,
        "everything hangs": hang,
    })  # fmt: skip


def run() -> None:
    """Plant, and run the node."""
    plant_in_solving_process()
    plant(Identifier, "solve", {"solver waits": waiting})
    plant(Identifier, "add", {"intake hangs": hang})
    plant(Worker, "_take", {"machine slow": as_a_slow_machine})
    plant(Worker, "enqueue", {"callback fails": with_wrenches(fail), "callback shuts down": with_wrenches(shut_down)})
    plant(Worker, "recent_messages", {"service fails": fail})
    plant(os, "fsync", {"disk full": full, "disk read-only": read_only, "disk slow": slowly, "everything hangs": hang})
    plant(saving, "save", {"saving fails": fail})
    threads.MOST_AT_ONCE, supervisor.MOST_RESTARTS = AT_ONCE, 1
    watch = Watch()
    supervisor.Supervisor.restart_hung_threads = lambda self: watch(self)  # noqa: PLW0108 an object is no method
    main.main()


if __name__ == "__main__":
    run()
elif __name__ == "__mp_main__":
    plant_in_solving_process()
