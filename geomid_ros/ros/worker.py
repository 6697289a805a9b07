"""Two threads behind the node: one turns messages into rows, one turns rows into estimates."""

from __future__ import annotations

import copy
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.gap.watch import ChannelGap, GapWatch
from geomid_ros.model.samples import Samples
from geomid_ros.session import Session
from geomid_ros.signals.messages import feed_joint_state, feed_odometry, feed_wrench
from geomid_ros.signals.pipeline import Accepted, Ledger
from geomid_ros.types import FloatArray

_MOST_WAITING = 20_000  # messages; more are dropped, and counted
_PATIENCE = 1.0  # [s] for each thread to finish what it does when it is told to end
_TRANSITION = 2_000_000_000  # [ns] a gap opens some time in so long, and is not at once what it will be
_LATENCIES = 10_000  # of so many last instants it is known how long their rows took

Done: TypeAlias = Callable[[Estimate | GeomidError], None]


@dataclass(frozen=True)
class Status:
    """A snapshot for diagnostics; ``topics`` are those that data are expected on, none without a robot description.

    ``receipt_to_row`` [s]: for the last instants whose rows were added, the time since the message that completed them
    came to its callback. The fixed lag of the filter is not in it. ``gaps``: of the channels that are watched.
    """

    active: bool
    problem: str = ""
    topics: tuple[str, ...] = ()
    rows: int = 0
    lag: float = 0.0
    queue: int = 0
    receipt_to_row: tuple[float, ...] = ()
    solves: int = 0
    ledgers: dict[str, Ledger] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)
    rows_rejected: Counter[str] = field(default_factory=Counter)
    gaps: tuple[ChannelGap, ...] = ()
    estimate: Estimate | None = None


class Worker:
    """Owns a session while it is live.

    ``on_samples(session, samples, parameters)`` is called, in the intake thread, for samples once there is an estimate;
    ``on_estimate(session, estimate)``, in the solver's thread, for each new one.
    """

    def __init__(
        self,
        session: Session,
        solve_period: float,
        on_samples: Callable[[Session, Samples, FloatArray], None],
        on_estimate: Callable[[Session, Estimate], None],
    ) -> None:
        self.session = session
        self._solve_period = solve_period
        self._on_samples = on_samples
        self._on_estimate = on_estimate
        self._lock = threading.Lock()  # held, never long, for the pipeline and for all that follows here
        self._dropped: Counter[str] = Counter()
        self._receipt_to_row: deque[float] = deque(maxlen=_LATENCIES)
        self._problem = ""
        self._estimate: Estimate | None = None
        self._resets = 0
        self._solves = 0
        self._solved_rows = 0
        self._gamma_rows = 0
        self._watch = self._new_watch()
        self._inbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._solve_requests: queue.SimpleQueue[Done | None] = queue.SimpleQueue()
        # Daemons: the process may end while they compute.
        self._intake = threading.Thread(target=self._take_messages, name="geomid-intake", daemon=True)
        self._solver = threading.Thread(target=self._solve_repeatedly, name="geomid-solver", daemon=True)
        self._intake.start()
        self._solver.start()

    def close(self) -> None:
        """Stop both threads. Messages that wait and what is being solved are finished first, unless it takes long."""
        self._inbox.put(None)
        self._intake.join(_PATIENCE)
        self._solve_requests.put(None)
        self._solver.join(_PATIENCE)
        with self._lock:
            self._resets += 1  # nobody wants a later estimate

    def joint_state(self, message: Any) -> None:
        """Take a joint message."""
        self._put(lambda: feed_joint_state(self.session.pipeline, message))

    def odometry(self, message: Any) -> None:
        """Take the base's pose."""
        self._put(lambda: feed_odometry(self.session.pipeline, message))

    def wrench(self, topic: str, message: Any) -> None:
        """Take a wrench of the sensor declared with ``topic``."""
        self._put(lambda: feed_wrench(self.session.pipeline, topic, message))

    def drop(self, reason: str) -> None:
        """Count a message that is not taken."""
        with self._lock:
            self._dropped[reason] += 1

    def reset(self) -> None:
        """Forget all rows and the estimate, after the messages that wait."""
        self._inbox.put(self._forget)

    def final_estimate(self, done: Done) -> None:
        """Solve from scratch for all messages received so far; ``done`` gets the result in the solver's thread."""
        self._inbox.put(lambda: self._solve_requests.put(done))

    def recent_messages(self) -> list[Accepted]:
        """What the session remembers of the last messages; where a gap has opened, since then.

        Before and after it were two robots, and no one effect explains both.
        """
        with self._lock:
            entries = self.session.recent.entries()
        begin = max((gap.since + _TRANSITION for gap in self._watch.gaps if gap.since is not None), default=0)
        return [entry for entry in entries if entry[1] >= begin]

    @property
    def estimate(self) -> Estimate | None:
        """The last estimate."""
        return self._estimate

    def status(self, active: bool) -> Status:
        """What to report now."""
        with self._lock:
            return Status(
                active,
                self._problem,
                self.session.topics,
                self.session.identifier.rows,
                self.session.pipeline.lag,
                self._inbox.qsize(),
                tuple(self._receipt_to_row),
                self._solves,
                copy.deepcopy(self.session.pipeline.ledgers),
                self._dropped.copy(),
                self.session.identifier.rows_rejected.copy(),
                self._watch.gaps,
                self._estimate,
            )

    def _put(self, feed: Callable[[], None]) -> None:
        if self._inbox.qsize() >= _MOST_WAITING:
            self.drop("queue full")
        else:
            received = time.perf_counter()
            self._inbox.put(lambda: self._take(feed, received))

    def _take_messages(self) -> None:
        while (task := self._inbox.get()) is not None:
            try:
                task()
            except Exception as error:  # noqa: BLE001 the thread must outlive any message; what happened is reported
                self.drop(f"{type(error).__name__} while taking a message")
                self._problem = f"a message could not be taken: {error}"

    def _take(self, feed: Callable[[], None], received: float) -> None:
        with self._lock:
            feed()
            samples = self.session.pipeline.collect()
        estimate = self._estimate
        if samples is None:
            return
        self._watch.add(*self.session.identifier.add(samples))
        with self._lock:
            self._receipt_to_row.append(time.perf_counter() - received)
        if estimate is not None:
            self._on_samples(self.session, samples, estimate.parameters)

    def _forget(self) -> None:
        with self._lock:
            self.session.identifier.reset()
            self.session.recent.clear()
            self._watch = self._new_watch()
            self._estimate = None
            self._problem = ""
            self._resets += 1
            self._solved_rows = self._gamma_rows = 0

    def _new_watch(self) -> GapWatch:
        return GapWatch(self.session.model.channels, self.session.configuration.buffer.forgetting_time)

    def _solve_repeatedly(self) -> None:
        next_solve = time.monotonic()
        while True:
            try:
                done = self._solve_requests.get(timeout=max(0.0, next_solve - time.monotonic()))
            except queue.Empty:
                next_solve = time.monotonic() + self._solve_period
                if self.session.identifier.rows > self._solved_rows:
                    self._watch.judge()
                    self._solve_once(self._warm_start())
                continue
            if done is None:
                return
            done(self._solve_once(None))

    def _warm_start(self) -> WarmStart | None:
        """Where to start from; None chooses the prior's weight anew, when it was chosen for other data."""
        with self._lock:
            if self._estimate is None or self.session.identifier.outgrown(self._gamma_rows):
                return None
            return WarmStart(self._estimate.parameters, self._estimate.gamma)

    def _solve_once(self, warm: WarmStart | None) -> Estimate | GeomidError:
        with self._lock:
            rows, resets = self.session.identifier.rows, self._resets
        try:
            estimate = self.session.identifier.solve(warm)
            with self._lock:
                if resets != self._resets:  # it is of rows that were to be forgotten
                    return estimate
                self._problem = ""
                self._solves += 1
                self._estimate, self._solved_rows = estimate, rows
                if warm is None:
                    self._gamma_rows = rows
            self._on_estimate(self.session, estimate)
        except Exception as error:  # noqa: BLE001 the last estimate stays; what happened is reported
            with self._lock:
                if resets == self._resets:
                    self._problem = f"no estimate: {error}"
            return error if isinstance(error, GeomidError) else GeomidError(str(error))
        return estimate
