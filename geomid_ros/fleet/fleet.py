"""A fleet: every bag is summarised, every robot solved for, all of it kept, and what is kept is not done again.

Dask does it, on this machine's cores or on a cluster, in many small tasks, whatever becomes of workers and scheduler.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, Self, TypeVar

import numpy as np

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.files.schema import structured
from geomid_ros.fleet.kept import SUFFIX, RobotResults, Store
from geomid_ros.fleet.recordings import FleetBag
from geomid_ros.fleet.work import BagOutcome, FleetPlan, solve_robot, summarise_bag
from geomid_ros.options import Progress, silent
from geomid_ros.session.session import installed_version

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


@dataclass(frozen=True, eq=False, kw_only=True)
class FleetRobot:
    """A robot of the fleet.

    Attributes:
        name: the robot's.
        bags: all of its bags with what became of each.
        used: addresses of the bags that its results are from.
        error: why there are no results, in a sentence.
        kept: what its results are kept under; empty if there are none.
    """

    name: str
    bags: Sequence[tuple[FleetBag, BagOutcome]]
    used: tuple[str, ...]
    error: str
    kept: str


class Fleet:
    """The robots and bags of a fleet, and what is known of them."""

    def __init__(self, plan: FleetPlan, bags: Sequence[FleetBag], store: Store) -> None:
        """Look at what is kept already.

        Raises:
            InputError: the configuration is none for a fleet, or the store cannot be read.
        """
        if np.isfinite(plan.configuration.buffer.forgetting_time):
            raise InputError("forgetting_time is given; of a fleet's bags, which are summed, nothing is forgotten")
        self._plan, self._bags, self._store = plan, bags, store
        self._kept = store.names()
        store.put(plan.name, json.dumps(plan.document).encode())

    def work(self, connect: Callable[[], Cluster], progress: Progress = silent) -> list[FleetRobot]:
        """Do all that is not done yet.

        Args:
            connect: connects to the workers, if there is anything to do for them.
            progress: called with what is being done, and the share of it that is done.

        Raises:
            InputError: the workers cannot be reached, or are gone; what was done so far is kept.
        """
        with ExitStack() as stack:
            workers = cache(lambda: stack.enter_context(connect()))
            outcomes = self._summarise(workers, progress)
            return list(self._solve(workers, outcomes, progress))

    def _summarise(self, workers: Callable[[], Cluster], progress: Progress) -> dict[FleetBag, BagOutcome]:
        """What became of every bag."""
        names = {bag: f"{self._plan.of_bag(bag)}.json" for bag in self._bags}
        found = {bag: self._outcome(name) for bag, name in names.items() if name in self._kept}
        outcomes = {bag: outcome for bag, outcome in found.items() if outcome is not None}
        progress(f"{len(outcomes)} of {len(self._bags)} bags", 0.0)
        jobs = [(bag, (self._store, self._plan.name, bag)) for bag in self._bags if bag not in outcomes]
        for bag, outcome in _run(workers, summarise_bag, jobs):
            failed = not isinstance(outcome, BagOutcome)
            outcomes[bag] = BagOutcome(error=f"{bag.url}: {failure(outcome)}") if failed else outcome
            progress(f"{len(outcomes)} of {len(self._bags)} bags", len(outcomes) / len(self._bags))
        return outcomes

    def _outcome(self, name: str) -> BagOutcome | None:
        """What became of a bag that was read before; None if that cannot be told."""
        try:
            return structured(BagOutcome, json.loads(self._store.get(name) or b""), f"{self._store.url}/{name}:")
        except (InputError, ValueError, RecursionError):
            return None

    def _solve(
        self, workers: Callable[[], Cluster], outcomes: Mapping[FleetBag, BagOutcome], progress: Progress
    ) -> Iterator[FleetRobot]:
        """The robots, once they are solved for."""
        chosen = {name: self._chosen(name, outcomes) for name in dict.fromkeys(bag.robot for bag in self._bags)}
        kept = {robot: [self._plan.of_bag(bag) for bag in used] for robot, (used, _) in chosen.items()}
        names = {robot: self._plan.of_robot(robot, bags) for robot, bags in kept.items()}
        jobs = [
            (robot, (self._store, self._plan.name, names[robot], kept[robot], locked))
            for robot, (used, locked) in chosen.items()
            if used and f"{names[robot]}{SUFFIX}" not in self._kept
        ]
        errors: dict[str, str] = {}
        for done, (robot, found) in enumerate(_run(workers, solve_robot, jobs), 1):
            errors[robot] = found if isinstance(found, str) else failure(found)
            progress(f"{done} of {len(jobs)} robots", done / len(jobs))
        for robot, (used, _) in chosen.items():
            error = errors.get(robot, "") if used else "none of its bags can be used"
            bags = [(bag, outcomes[bag]) for bag in self._bags if bag.robot == robot]
            yield FleetRobot(
                name=robot,
                bags=bags,
                used=tuple(bag.url for bag in used),
                error=error,
                kept="" if error else names[robot],
            )

    def _chosen(self, robot: str, outcomes: Mapping[FleetBag, BagOutcome]) -> tuple[list[FleetBag], tuple[str, ...]]:
        """The bags that a robot is identified from, and the joints that they all lack.

        Bags that seem to be wrong are left out as long as there are others.
        """
        readable = [bag for bag in self._bags if bag.robot == robot and not outcomes[bag].error]
        used = [bag for bag in readable if not outcomes[bag].doubts] or readable
        if not used:
            return [], ()
        ((locked, _),) = Counter(outcomes[bag].locked for bag in used).most_common(1)
        return [bag for bag in used if outcomes[bag].locked == locked], locked

    def results(self, robot: FleetRobot) -> RobotResults:
        """The results of a robot that has some. Raises InputError if they cannot be read."""
        content = self._store.get(f"{robot.kept}{SUFFIX}")
        if content is None:
            raise InputError(f"{self._store.url}: the results of robot '{robot.name}' are missing; run the same again")
        try:
            return RobotResults.decoded(content)
        except InputError as error:
            raise InputError(
                f"{self._store.url}/{robot.kept}{SUFFIX}: {error}; delete it, and run the same again"
            ) from error


def _run(
    workers: Callable[[], Cluster], function: Callable[..., Any], jobs: Sequence[tuple[Any, tuple[Any, ...]]]
) -> Iterator[tuple[Any, Any]]:
    """What each job returned, or its exception. Raises InputError for what no worker can do any job with."""
    for what, found in workers().run(function, jobs) if jobs else ():
        if isinstance(found, InputError):
            raise found
        yield what, found
