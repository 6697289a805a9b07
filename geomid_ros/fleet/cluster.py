"""Dask: this machine's cores or a cluster, and many small tasks on it, whatever becomes of workers and scheduler."""

from __future__ import annotations

import logging
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any, Self, TypeVar

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.session.results import installed_version

_PATIENCE = 120.0  # [s] for a scheduler that was restarted, with its workers
_CONNECT = 10.0  # [s]
_AHEAD = 8  # tasks per thread that are handed over: none waits, and the client stays small
Job = TypeVar("Job")


class Cluster:
    """A connection to Dask, for a ``with`` statement: to the scheduler of that address, or to workers of this machine.

    Raises:
        InputError: Dask is not installed, or the scheduler cannot be reached, or workers have another version of this
            package.
    """

    def __init__(self, address: str | None, patience: float = _PATIENCE) -> None:
        try:
            import distributed  # noqa: PLC0415 an extra
        except ImportError as error:
            raise InputError("geomid fleet needs the extra 'fleet': pip install geomid_ros[fleet]") from error
        # What it logs, with tracebacks, is what is told here in a sentence.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._dask: Any = distributed
        self._patience = patience
        self._version = installed_version()
        self._local: Any = None
        if address is None:
            cores = len(os.sched_getaffinity(0))
            self._local = self._dask.LocalCluster(
                n_workers=cores, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
            )
            address = self._local.scheduler_address
        self._address = address
        self._client: Any = None
        try:
            self._connect(_CONNECT)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of it; workers of this machine are stopped."""
        self._disconnect()
        if self._local is not None:
            self._local.close()

    def _disconnect(self) -> None:
        if self._client is not None:
            with suppress(Exception):  # of a scheduler that is gone
                self._client.close(timeout=2)
            self._client = None

    def _connect(self, patience: float) -> None:
        """Connect, and look at the workers' version."""
        deadline = time.monotonic() + patience
        while self._client is None:
            try:
                self._client = self._dask.Client(self._address, timeout=max(1.0, deadline - time.monotonic()))
            except (OSError, ValueError) as error:  # a timeout is an OSError
                if isinstance(error, ValueError) or time.monotonic() > deadline:
                    reason = str(error).partition("\n")[0]
                    raise InputError(f"no Dask scheduler answers at {self._address} ({reason})") from error
                time.sleep(0.5)
        try:
            self._client.wait_for_workers(1, timeout=patience)
            versions = set(self._client.run(installed_version).values())
        except TimeoutError as error:
            raise InputError(f"the Dask scheduler at {self._address} has no workers; start some") from error
        except (ImportError, AttributeError) as error:
            raise InputError(self._other_version(str(error))) from error
        if versions != {self._version}:
            raise InputError(self._other_version(f"they have {', '.join(sorted(versions))}"))

    def _other_version(self, found: str) -> str:
        return (
            f"{self._address}: its workers lack geomid_ros {self._version} with the extra 'fleet' ({found}); install "
            "the same everywhere"
        )

    def run(
        self, function: Callable[..., Any], jobs: Sequence[tuple[Job, tuple[Any, ...]]]
    ) -> Iterator[tuple[Job, Any]]:
        """Call ``function(*arguments)`` for every job, a few at a time; a task whose worker is lost is done again.

        Args:
            function: of this package.
            jobs: what each is for, and its arguments.

        Yields:
            What a job is for, and what it returned, or the exception that it raised, in the order in which they end.

        Raises:
            InputError: the scheduler is gone and does not come back.
        """
        waiting = deque(jobs)
        while waiting:
            running: dict[Any, tuple[Job, tuple[Any, ...]]] = {}
            ended = self._dask.as_completed(with_results=True, raise_errors=False)
            ahead = _AHEAD * max(_AHEAD, sum(self._client.nthreads().values()))
            lost = False
            while running or (waiting and not lost):
                while waiting and len(running) < ahead and not lost:
                    job = waiting.popleft()
                    future = self._client.submit(function, *job[1], pure=False)
                    running[future.key] = job
                    ended.add(future)
                for future, result in ended.next_batch():
                    job = running.pop(future.key)
                    if future.cancelled():
                        waiting.append(job)
                        lost = True
                    else:
                        yield job[0], future.exception() if future.status == "error" else result
            if lost:
                self._disconnect()
                try:
                    self._connect(self._patience)
                except InputError as error:
                    raise InputError(f"{error}; intermediate results are kept: run the same command again") from error


def failure(error: BaseException) -> str:
    """What to say of a task that ended in an exception."""
    if isinstance(error, GeomidError):
        return str(error)
    if type(error).__name__ == "KilledWorker":
        return "the workers that read it died, perhaps from lack of memory"
    return f"{type(error).__name__}: {error}"
