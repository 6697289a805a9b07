"""Two threads behind the node: one turns messages into rows, one turns rows into estimates."""

from __future__ import annotations

import copy
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.model.samples import Samples
from geomid_ros.session import Session
from geomid_ros.signals.messages import feed_joint_state, feed_odometry, feed_wrench
from geomid_ros.signals.pipeline import Ledger
from geomid_ros.types import FloatArray

_MOST_WAITING = 20_000  # messages; more are dropped, and counted
_GROWTH = 1.5  # the prior's weight is chosen anew when there are so many times the rows it was chosen with


@dataclass(frozen=True)
class Status:
    """A snapshot for diagnostics."""

    active: bool
    rows: int
    lag: float
    queue: int
    ledgers: dict[str, Ledger]
    dropped: Counter[str]
    rows_rejected: Counter[str]
    estimate: Estimate | None
    problem: str


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
        self.dropped: Counter[str] = Counter()
        self.problem = ""
        self._solve_period = solve_period
        self._on_samples = on_samples
        self._on_estimate = on_estimate
        self._estimate: Estimate | None = None
        self._solved_rows = 0
        self._gamma_rows = 0
        self._inbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._solve_requests: queue.SimpleQueue[Callable[[Estimate | GeomidError], None] | None] = queue.SimpleQueue()
        self._threads = [
            threading.Thread(target=self._take_messages, name="geomid-intake"),
            threading.Thread(target=self._solve_repeatedly, name="geomid-solver"),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop both threads; what is being solved is finished first."""
        self._inbox.put(None)
        self._solve_requests.put(None)
        for thread in self._threads:
            thread.join()

    def joint_state(self, message: Any) -> None:
        """Take a joint message."""
        self._put(lambda: feed_joint_state(self.session.pipeline, message))

    def odometry(self, message: Any) -> None:
        """Take the base's pose."""
        self._put(lambda: feed_odometry(self.session.pipeline, message))

    def wrench(self, topic: str, message: Any) -> None:
        """Take a wrench of the sensor declared with ``topic``."""
        self._put(lambda: feed_wrench(self.session.pipeline, topic, message))

    def _put(self, feed: Callable[[], None]) -> None:
        if self._inbox.qsize() >= _MOST_WAITING:
            self.dropped["queue full"] += 1
        else:
            self._inbox.put(feed)

    def reset(self) -> None:
        """Forget all rows and the estimate, after the messages that wait."""

        def forget() -> None:
            self.session.identifier.reset()
            self._estimate = None
            self._solved_rows = self._gamma_rows = 0

        self._inbox.put(forget)

    def final_estimate(self, done: Callable[[Estimate | GeomidError], None]) -> None:
        """Solve from scratch for all messages received so far; ``done`` gets the result in the solver's thread."""
        self._inbox.put(lambda: self._solve_requests.put(done))

    @property
    def estimate(self) -> Estimate | None:
        """The last estimate."""
        return self._estimate

    def status(self, active: bool) -> Status:
        """What to report now."""
        pipeline, identifier = self.session.pipeline, self.session.identifier
        return Status(
            active,
            identifier.rows,
            pipeline.lag,
            self._inbox.qsize(),
            copy.deepcopy(pipeline.ledgers),
            Counter(self.dropped),
            Counter({reason: count for reason, count in identifier.rows_rejected.items() if count}),
            self._estimate,
            self.problem,
        )

    def _take_messages(self) -> None:
        while (feed := self._inbox.get()) is not None:
            try:
                feed()
                samples = self.session.advance()
                estimate = self._estimate
                if samples is not None and estimate is not None:
                    self._on_samples(self.session, samples, estimate.parameters)
            except Exception as error:  # noqa: BLE001 the thread must outlive any message; what happened is reported
                self.dropped[f"{type(error).__name__} while taking a message"] += 1
                self.problem = f"a message could not be taken: {error}"

    def _solve_repeatedly(self) -> None:
        next_solve = time.monotonic()
        while True:
            try:
                done = self._solve_requests.get(timeout=max(0.0, next_solve - time.monotonic()))
                if done is None:
                    return
                self._solve_once(None, done)
            except queue.Empty:
                next_solve = time.monotonic() + self._solve_period
                if self.session.identifier.rows > self._solved_rows:
                    self._solve_once(self._warm_start(), lambda result: None)

    def _warm_start(self) -> WarmStart | None:
        """Where to start from; None chooses the prior's weight anew, when the rows have grown much since."""
        if self._estimate is None or self.session.identifier.rows > _GROWTH * self._gamma_rows:
            return None
        return WarmStart(self._estimate.parameters, self._estimate.gamma, self._estimate.sigmas)

    def _solve_once(self, warm: WarmStart | None, done: Callable[[Estimate | GeomidError], None]) -> None:
        rows = self.session.identifier.rows
        try:
            estimate = self.session.identifier.solve(warm)
        except Exception as error:  # noqa: BLE001 the last estimate stays; what happened is reported
            self.problem = f"no estimate: {error}"
            done(error if isinstance(error, GeomidError) else GeomidError(str(error)))
            return
        self.problem = ""
        self._estimate, self._solved_rows = estimate, rows
        if warm is None:
            self._gamma_rows = rows
        self._on_estimate(self.session, estimate)
        done(estimate)
