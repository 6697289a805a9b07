"""A fleet: every bag is summarised, every robot solved for, all of it kept, and what is kept is not done again."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.schema import structured
from geomid_ros.fleet.cluster import Cluster, failure
from geomid_ros.fleet.kept import SUFFIX, RobotResults, Store
from geomid_ros.fleet.recordings import FleetBag
from geomid_ros.fleet.work import BagOutcome, FleetPlan, solve_robot, summarise_bag
from geomid_ros.options import Progress, silent


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
