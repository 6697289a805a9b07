"""The threads of the node: the intake turns messages into rows, the solver turns rows into estimates."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from geomid_ros.checks.verdict import implausible_mass
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.live.solver import SOLVING, Done, Solver
from geomid_ros.live.status import Failures, Listener, Status
from geomid_ros.live.threads import PATIENCE, Activity, Inbox, Received, start_daemon
from geomid_ros.model.measurement_model import Rows
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.payload_watch import with_payload
from geomid_ros.session.recordings import Training
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, AcceptedMessages, Block, Decoder, message_type
from geomid_ros.signals.settings import MOST_WAITING
from geomid_ros.types import FloatArray, IntArray

_TRANSITION = 2_000_000_000  # [ns] from the start of a gap until all rows show it
LONG = 1.0  # [s] longest normal duration of a thread's task; a solve may take ``solve_period`` if that is longer


class Worker:
    """Runs a live session: owns its inbox, its intake thread and its solver."""

    def __init__(self, session: Session, solve_period: float, listener: Listener, failures: Failures) -> None:
        """
        Args:
            session: new, or restored from a checkpoint.
            solve_period: [s] between estimates.
            listener: receives samples in the intake's thread, once there is an estimate, and all else in the solver's.
            failures: counts exceptions in both threads.
        """
        self.session, self.failures = session, failures
        self.ledger = session.pipeline.ledger
        self.solver = Solver(session, solve_period, listener, failures)
        self.activity = Activity()  # of the intake
        self._decoder = Decoder()
        self._listener = listener
        self._rows_lost: Counter[str] = Counter()  # replaced, never modified
        self._lock = threading.Lock()  # held briefly, for the next field
        self._receipt_to_row: deque[float] = deque(maxlen=MOST_WAITING)  # of the latest samples
        self._wrenches = self._new_training()
        self._inbox = Inbox()
        self._intake = start_daemon("intake", self._take_messages)

    def _new_training(self) -> Training:
        return Training(self.session, watched=self.solver.detector.payload is not None)

    def close(self, patience: float | None = None) -> None:
        """Stop both threads. Waiting messages and a running solve are finished first, but for no longer than
        ``patience`` [s]; messages that are left then are dropped."""
        end = time.monotonic() + (PATIENCE if patience is None else patience)
        self._inbox.end()
        self._intake.join(max(0.0, end - time.monotonic()))
        self.solver.close(max(0.0, end - time.monotonic()))
        with suppress(GeomidError):  # errors in messages that will yield no more rows
            self.session.pipeline.release()
        for message in self._inbox.clear():
            self.ledger.drop(message.topic, "node shut down or restarted")

    def enqueue(self, messages: Sequence[Received]) -> None:
        """Queue messages for the intake; drop those for which the queue has no room."""
        for message in self._inbox.put_messages(messages):
            self.ledger.drop(message.topic, "queue full")

    def reset(self) -> None:
        """Discard all rows and the estimate, after the waiting messages are processed."""
        self._inbox.request(self._forget)

    def request_estimate(self, done: Done) -> None:
        """Solve from scratch for all messages so far. ``done(result)`` is called in the solver's thread."""
        self._inbox.request(lambda: self.solver.request(done))

    def recent_messages(self, after: int = 0) -> list[AcceptedMessages]:
        """Return the remembered messages after the first ``after`` entries (:attr:`Recent.count`); while a gap is open
        or a payload is carried, only those since all rows have shown the last such change.

        Before and after a change the robot differs, and no single effect explains both.
        """
        begin = max((opened + _TRANSITION for opened in self._changes), default=0)
        return [later for block in self.session.recent.entries(after) if len(later := block.since(begin))]

    @property
    def _changes(self) -> list[int]:
        """Stamps [ns], on the clock of the remembered messages, since which gaps are open or a payload is carried. A
        change on an earlier clock is older than all of them."""
        first = self.session.recent.first_sample
        return [opened if sample >= first else -_TRANSITION for opened, sample in self.solver.detector.changes]

    def messages_before_gap(self) -> list[AcceptedMessages]:
        """Return the remembered messages from before the first open gap (or payload); all of them if there is none."""
        opened, entries = self._changes, self.session.recent.entries()
        return [earlier for block in entries if len(earlier := block.before(min(opened)))] if opened else entries

    @property
    def estimate_before_gap(self) -> Estimate | None:
        """Last estimate from before the first open gap (or payload); None if there is none, or if it is too long
        ago."""
        changes = self.solver.detector.changes
        return self.solver.estimate_before(min(sample for _, sample in changes)) if changes else None

    @property
    def estimate(self) -> Estimate | None:
        """Latest estimate; None before the first."""
        return self.solver.estimate

    def status(self, active: bool) -> Status:
        """Return the present state. ``active``: True if the node takes data."""
        pipeline, rows, lost = self.session.pipeline, self.session.identifier.counts, self._rows_lost
        with self._lock:
            receipt_to_row = tuple(self._receipt_to_row)
        return Status(
            active=active,
            problems=tuple(self._problems()),
            warnings=tuple(self._warnings()),
            failures=self.failures.counts,
            topics=self.session.topics,
            rows=rows.taken,
            rows_made=rows.made + lost.total(),
            rows_rejected=rows.rejected + lost,
            lag=pipeline.lag,
            queue=self._inbox.unfinished + pipeline.waiting_count,
            receipt_to_row=receipt_to_row,
            solves=self.solver.solves,
            accounts=self.ledger.topics,
            joints=len(self.session.robot.joint_names),
            unmeasured=pipeline.unmeasured if self.session.model.layout.efforts else (),
            gaps=self.solver.detector.gaps,
            payload=self.solver.payload,
            estimate=self.solver.estimate,
            changed_sensors=self.solver.changed_sensors,
        )

    def _problems(self) -> Iterator[str]:
        for sentence in self._wrenches.sentences.values():
            yield f"{sentence}, including earlier ones, until ~/reset"
        yield from self._causes(sure=True)
        task, seconds = self.activity.current
        if seconds > LONG:
            yield f"a message on {task} has been processed for {seconds:.0f} s"

    def _warnings(self) -> Iterator[str]:
        estimate = self.solver.estimate
        yield from self.session.review.warnings(estimate)
        yield from self._causes(sure=False)
        yield from () if estimate is None else implausible_mass(estimate, self.session.model)
        yield from self.session.review.remarks
        if problem := self.solver.problem:
            yield problem
        task, seconds = self.solver.activity.current
        limit = max(LONG, self.solver.period) if task == SOLVING else LONG
        if seconds > limit:
            yield f"{task} takes {seconds:.0f} s so far, more than {limit:g} s"
        if silent := self.session.pipeline.silent:
            joints = ", ".join(f"'{joint}'" for joint in silent)
            yield f"{JOINT_STATES}: no data of {joints}; rows need all joints"

    def _causes(self, *, sure: bool) -> list[str]:
        """Sentences of the causes that the checks of the whole recording found."""
        findings, left_out = self.session.review.findings, self._wrenches.sentences.keys()
        return [f.sentence for f in findings if f.sure == sure and left_out.isdisjoint(f.cause.places)]

    def _take_messages(self) -> None:
        for task in self._inbox.tasks():
            with self.failures.counted("message processing failed"):
                if isinstance(task, list):
                    with self.activity.doing(task[0].topic):
                        self._take(task)
                else:
                    task()

    def _take(self, messages: list[Received]) -> None:
        """Push messages into the pipeline, and the rows that they complete into the identifier."""

        def refuse(place: int, _: str) -> None:
            topic = messages[place].topic
            self.ledger.reject(topic, f"not a valid {message_type(topic)}")

        blocks = self._decoder.blocks(messages, refuse)
        topics = " or ".join({block.topic for block in blocks})
        with self.failures.counted(f"a message on {topics} could not be processed"):  # the pipeline counts the messages
            self.session.pipeline.push(blocks)
        samples = self.session.pipeline.collect()
        if samples is not None:
            lag = round(1e9 * self.session.pipeline.lag)
            self._add(samples, _completion_times([message.time for message in messages], blocks, samples.stamps + lag))

    def _add(self, samples: Samples, received: FloatArray) -> None:
        """Add the rows of samples to the identifier. The messages that completed them were ``received (N,)`` [s]."""
        estimate, payload, identifier = self.solver.estimate, self.solver.payload, self.session.identifier
        before = identifier.counts.made
        try:
            moved, rows, uncertain = identifier.add(samples)
        except Exception as error:  # noqa: BLE001 the thread must survive
            lost = before + len(samples) * len(self.session.model.channels) - identifier.counts.made
            self._rows_lost = self._rows_lost + Counter({type(error).__name__: lost})
            self.failures.add("rows could not be computed", error)
            return
        with self._lock:
            self._receipt_to_row.extend((time.perf_counter() - received).tolist())
        if self._wrenches.check(rows):
            self.solver.begin_anew()
        settled = Rows(rows.coefficients, np.where(uncertain, np.nan, rows.targets))
        trusted = self._wrenches.without_doubtful(settled)
        first = identifier.sample_count - len(rows.targets)
        self.solver.check_later(samples, first + np.cumsum(moved))
        if self.solver.detector.add(first, samples.stamps[moved], trusted):
            self.solver.request_change_search()
        if estimate is not None:
            with self.failures.counted("a prediction could not be published"):
                self._listener.on_samples(self.session, samples, with_payload(estimate, payload))

    def _forget(self) -> None:
        self.session.recent.clear()
        self.solver.reset()
        self.session.review.forget()
        self._rows_lost = Counter()
        self._wrenches = self._new_training()


def _completion_times(times: Sequence[float], blocks: Sequence[Block], stamps: IntArray) -> FloatArray:
    """Receipt time [s] of the message that completed each sample ``(N,)``. A sample is complete once every topic has a
    message that is later by at least the filter's lag.

    Args:
        times: [s] at which messages were received.
        blocks: these messages, decoded. If none is as late, an earlier one completed the sample: the first time counts.
        stamps: of the samples plus the lag, increasing [ns].
    """
    completed, received = np.full(len(stamps), times[0]), np.array(times)
    for block in blocks:
        places = np.searchsorted(np.maximum.accumulate(block.stamps), stamps)
        reached = places < len(block.stamps)
        completed[reached] = np.maximum(completed[reached], received[block.order[places[reached]]])
    return completed
