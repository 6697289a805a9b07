"""State of a live session for the diagnostics, its failures, and the listener that receives its results."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import ChannelGap
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import Account, count_reason


class Failures:
    """Exceptions that threads outlive, counted by their text. Any thread may call any method."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()

    @property
    def counts(self) -> Counter[str]:
        """Copy of the counts."""
        with self._lock:
            return self._counts.copy()

    def add(self, failure: str, error: Exception) -> str:
        """Count an exception. Return its text, which begins with the ``failure``."""
        sentence = f"{failure}: {type(error).__name__}: {error}"
        with self._lock:
            count_reason(self._counts, sentence)
        return sentence

    @contextmanager
    def counted(self, failure: str) -> Iterator[None]:
        """Count an exception inside the context, and continue after it."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 the thread must survive; the diagnostics report it
            self.add(failure, error)


class Listener:
    """Receives the results of a live session, in the thread that produces them. This base class ignores them."""

    def on_samples(self, session: Session, samples: Samples, estimate: Estimate) -> None:
        """Receive new samples, and the estimate, payload included, to predict them with."""

    def on_estimate(self, session: Session, estimate: Estimate) -> None:
        """Receive a new estimate."""

    def on_gaps(self, gaps: Sequence[ChannelGap]) -> None:
        """Receive the channels in which a gap is open from now on."""

    def on_payload(self, carried: CarriedPayload | None) -> None:
        """Receive the payload that is carried from now on; None if there is none."""


@dataclass(frozen=True, kw_only=True)
class Status:
    """Snapshot for diagnostics.

    - ``topics``: where data are expected, empty without a robot description; ``accounts``: of their messages;
      ``names``: the resolved names of topics.
    - ``problems``: lasting errors; ``warnings``: less than errors; ``failures``: exceptions, counted by text.
    - ``rows``: taken; ``rows_rejected``: by reason; ``rows_made``: the sum of both.
    - ``queue``: messages that wait to be decided on or used; ``lag`` [s]: of the filter.
    - ``receipt_to_row`` [s]: for each of the latest samples, the time from the callback of the message that completed
      it until its rows were added. The lag of the filter is not part of it.
    - ``joints``: their number; ``unmeasured``: those without efforts.
    - ``payload``: a payload that was picked up.
    - ``gaps``: state of the monitored channels; ``changed_sensors``: topics of wrench sensors that have changed, whose
      rows are left out.
    - ``unconfigured``: why a managed node is not configured, as a sentence; empty if it is.
    """

    active: bool
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    failures: Counter[str] = field(default_factory=Counter)
    topics: tuple[str, ...] = ()
    names: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    rows_made: int = 0
    rows_rejected: Counter[str] = field(default_factory=Counter)
    lag: float = 0.0
    queue: int = 0
    receipt_to_row: tuple[float, ...] = ()
    solves: int = 0
    accounts: dict[str, Account] = field(default_factory=dict)
    joints: int = 0
    unmeasured: tuple[str, ...] = ()
    gaps: tuple[ChannelGap, ...] = ()
    estimate: Estimate | None = None
    changed_sensors: tuple[str, ...] = ()
    payload: CarriedPayload | None = None
    unconfigured: str = ""

    def account(self, topic: str) -> Account:
        """Return the account of a topic's messages."""
        return self.accounts.get(topic, Account())

    def name(self, topic: str) -> str:
        """Return the resolved name of a topic, as ROS shows it."""
        return self.names.get(topic, topic)

    def since(self, before: Status) -> Status:
        """Return this status with the counts since ``before``: messages, rows and failures."""
        return replace(
            self,
            accounts={topic: account.since(before.account(topic)) for topic, account in self.accounts.items()},
            rows=self.rows - before.rows,
            rows_made=self.rows_made - before.rows_made,
            rows_rejected=self.rows_rejected - before.rows_rejected,
            failures=self.failures - before.failures,
        )
