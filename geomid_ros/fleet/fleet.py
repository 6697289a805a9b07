"""A fleet: every bag is summarised, every robot is solved, and all results are stored, so that nothing is done twice.

Dask runs many small tasks on this machine's cores or on a cluster; they survive lost workers and schedulers.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing import current_process, resource_tracker
from typing import Any, Self, TypeVar

import numpy as np

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.files.schema import from_document
from geomid_ros.fleet.recordings import FleetBag
from geomid_ros.fleet.work import SUFFIX, BagOutcome, FleetPlan, RobotResults, Store, solve_robot, summarise_bag
from geomid_ros.options import Progress, silent
from geomid_ros.session.session import installed_version

_PATIENCE = 120.0  # [s] time for a scheduler and its workers to restart
_CONNECT = 10.0  # [s]
_AHEAD = 8  # submitted tasks per thread: no thread waits, and the client stays small
Job = TypeVar("Job")


class Cluster:
    """A connection to Dask, for a ``with`` statement: to the scheduler at an address, or to workers of this machine.

    Raises:
        InputError: Dask is not installed, the scheduler cannot be reached, or workers have another version of this
            package.
    """

    def __init__(self, address: str | None, patience: float = _PATIENCE) -> None:
        try:
            import distributed  # noqa: PLC0415 an extra
        except ImportError as error:
            raise InputError("geomid fleet needs the extra 'fleet': pip install geomid_ros[fleet]") from error
        # Its log has tracebacks of what is reported here in a sentence.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._dask: Any = distributed
        self._patience = patience
        with ExitStack() as stack:
            self._address = self._start_workers(stack) if address is None else address
            self._client: Any = None
            stack.callback(self._disconnect)
            self._connect(_CONNECT)
            self._stack = stack.pop_all()

    def _start_workers(self, stack: ExitStack) -> str:
        """Start workers on this machine, which the stack stops, and return the address of their scheduler.

        Raises InputError if they do not start.
        """
        if getattr(current_process(), "_inheriting", False):  # as multiprocessing tests it
            sys.exit(0)  # this process is such a worker, which runs its parent's script first; the parent says so
        cores = len(os.sched_getaffinity(0))
        # Ctrl-C waits until they have started, and is never theirs: the stack stops them. They inherit this mask,
        # unless multiprocessing starts its tracker, which unblocks the signal, with the first of them.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            local = self._dask.LocalCluster(
                n_workers=cores, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
            )
            stack.callback(local.close)
            return str(local.scheduler_address)
        except RuntimeError as error:
            raise InputError(
                f"the workers of this machine do not start ({str(error).removesuffix('.')}). In a script, put the call "
                "under \"if __name__ == '__main__':\", as each worker imports the script"
            ) from None
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection; workers of this machine are stopped."""
        self._stack.close()

    def _disconnect(self) -> None:
        if self._client is not None:
            with suppress(Exception):  # the scheduler may be gone
                self._client.close(timeout=2)
            self._client = None

    def _connect(self, patience: float) -> None:
        """Connect, and check the version of the workers."""
        deadline, version = time.monotonic() + patience, installed_version()
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
            reason = "" if versions == {version} else f"they have {', '.join(sorted(versions))}"
        except TimeoutError as error:
            raise InputError(f"the Dask scheduler at {self._address} has no workers; start some") from error
        except (ImportError, AttributeError) as error:
            reason = str(error) or type(error).__name__
        if reason:
            raise InputError(
                f"{self._address}: its workers lack geomid_ros {version} with the extra 'fleet' ({reason}); install "
                "the same everywhere"
            )

    def run(
        self, function: Callable[..., Any], jobs: Sequence[tuple[Job, tuple[Any, ...]]]
    ) -> Iterator[tuple[Job, Any]]:
        """Call ``function(*arguments)`` for every job, a few at a time; tasks of lost workers are repeated.

        Args:
            function: a function of this package.
            jobs: pairs of a key and the arguments.

        Yields:
            The key of a job, and its return value or exception, in the order in which jobs end.

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
    """Sentence on a task that ended with an exception."""
    if isinstance(error, GeomidError):
        return str(error)
    if type(error).__name__ == "KilledWorker":
        return "the workers that read it died, perhaps from lack of memory"
    return f"{type(error).__name__}: {error}"


@dataclass(frozen=True, eq=False, kw_only=True)
class FleetRobot:
    """A robot of the fleet.

    Attributes:
        name: name of the robot.
        bags: all of its bags with their outcomes.
        used: addresses of the bags that its results are from.
        error: reason why there are no results, in a sentence.
        kept: name under which its results are stored; empty if there are none.
    """

    name: str
    bags: Sequence[tuple[FleetBag, BagOutcome]]
    used: tuple[str, ...]
    error: str
    kept: str


class Fleet:
    """The robots and bags of a fleet, and their stored results."""

    def __init__(self, plan: FleetPlan, bags: Sequence[FleetBag], store: Store) -> None:
        """Look up the stored results.

        Raises:
            InputError: the configuration is not suited to a fleet, or the store cannot be read.
        """
        if np.isfinite(plan.configuration.buffer.forgetting_time):
            raise InputError("forgetting_time is given; of a fleet's bags, which are summed, nothing is forgotten")
        self._plan, self._bags, self._store = plan, bags, store
        self._kept = store.names()
        store.put(plan.name, json.dumps(plan.document).encode())

    def work(self, connect: Callable[[], Cluster], progress: Progress = silent) -> list[FleetRobot]:
        """Do all work that is not done yet.

        Args:
            connect: connects to the workers, if there is work for them.
            progress: called with the current stage, and the fraction of it that is done.

        Raises:
            InputError: the workers cannot be reached, or are gone; finished work is kept.
        """
        with ExitStack() as stack:
            workers = cache(lambda: stack.enter_context(connect()))
            outcomes = self._summarise(workers, progress)
            return list(self._solve(workers, outcomes, progress))

    def _summarise(self, workers: Callable[[], Cluster], progress: Progress) -> dict[FleetBag, BagOutcome]:
        """Outcome of every bag."""
        outcomes: dict[FleetBag, BagOutcome] = {}
        for bag in self._bags:
            name = f"{self._plan.summary_name(bag)}.json"
            with suppress(InputError, ValueError, RecursionError):  # it is summarised again
                if name in self._kept:
                    outcomes[bag] = from_document(BagOutcome, json.loads(self._store.get(name)), name)
        progress(f"{len(outcomes)} of {len(self._bags)} bags", 0.0)
        jobs = [(bag, (self._store, self._plan.name, bag)) for bag in self._bags if bag not in outcomes]
        for bag, outcome in _run(workers, summarise_bag, jobs):
            failed = not isinstance(outcome, BagOutcome)
            outcomes[bag] = BagOutcome(error=f"{bag.url}: {failure(outcome)}") if failed else outcome
            progress(f"{len(outcomes)} of {len(self._bags)} bags", len(outcomes) / len(self._bags))
        return outcomes

    def _solve(
        self, workers: Callable[[], Cluster], outcomes: Mapping[FleetBag, BagOutcome], progress: Progress
    ) -> Iterator[FleetRobot]:
        """Yield the robots, after solving for them."""
        chosen = {name: self._chosen(name, outcomes) for name in dict.fromkeys(bag.robot for bag in self._bags)}
        names, jobs, errors = dict[str, str](), list[tuple[str, tuple[Any, ...]]](), dict[str, str]()
        for robot, (used, locked) in chosen.items():
            summaries = [self._plan.summary_name(bag) for bag in used]
            names[robot] = self._plan.results_name(robot, summaries)
            if not used:
                errors[robot] = "none of its bags can be used"
            elif f"{names[robot]}{SUFFIX}" not in self._kept:
                jobs.append((robot, (self._store, self._plan.name, names[robot], summaries, locked)))
        for done, (robot, outcome) in enumerate(_run(workers, solve_robot, jobs), 1):
            errors[robot] = outcome if isinstance(outcome, str) else failure(outcome)
            progress(f"{done} of {len(jobs)} robots", done / len(jobs))
        for robot, (used, _) in chosen.items():
            bags = [(bag, outcomes[bag]) for bag in self._bags if bag.robot == robot]
            error, urls = errors.get(robot, ""), tuple(bag.url for bag in used)
            yield FleetRobot(name=robot, bags=bags, used=urls, error=error, kept="" if error else names[robot])

    def _chosen(self, robot: str, outcomes: Mapping[FleetBag, BagOutcome]) -> tuple[list[FleetBag], tuple[str, ...]]:
        """Bags that a robot is identified from, and the joints that all of them lack.

        Suspect bags are left out if there are others.
        """
        readable = [bag for bag in self._bags if bag.robot == robot and not outcomes[bag].error]
        used = [bag for bag in readable if not outcomes[bag].doubts] or readable
        if not used:
            return [], ()
        ((locked, _),) = Counter(outcomes[bag].locked for bag in used).most_common(1)
        return [bag for bag in used if outcomes[bag].locked == locked], locked

    def results(self, robot: FleetRobot) -> RobotResults:
        """Load the results of a robot that has some. Raises InputError if they cannot be read."""
        name = f"{robot.kept}{SUFFIX}"
        content = self._store.get(name, f"the results of robot '{robot.name}' are missing; run the same again")
        try:
            return RobotResults.decoded(content)
        except InputError as error:
            problem = f"the stored result of a robot cannot be read ({error}); delete it, and run the same again"
            raise InputError(f"{self._store.url}/{name}: {problem}") from error


def _run(
    workers: Callable[[], Cluster], function: Callable[..., Any], jobs: Sequence[tuple[Any, tuple[Any, ...]]]
) -> Iterator[tuple[Any, Any]]:
    """Yield the key of each job, and its return value or exception. Raises InputError if no worker can do any job."""
    for key, result in workers().run(function, jobs) if jobs else ():
        if isinstance(result, InputError):
            raise result
        yield key, result
