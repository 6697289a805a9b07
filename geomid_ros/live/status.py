"""What a live session tells: its state to the diagnostics, and what it finds to a listener."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import ChannelGap
from geomid_ros.monitoring.payload_watch import Carried
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import Account


class Listener:
    """Is told what a live session finds, in the thread that finds it. This one ignores it."""

    def prediction(self, session: Session, samples: Samples, estimate: Estimate) -> None:
        """New samples, and the estimate to predict them by, with what is carried."""

    def estimate(self, session: Session, estimate: Estimate) -> None:
        """A new estimate."""

    def carried(self, carried: Carried | None) -> None:
        """What is carried from now on; None for nothing."""


@dataclass(frozen=True, kw_only=True)
class Status:
    """A snapshot for diagnostics.

    - ``topics``: where data are expected, empty without a robot description; ``accounts``: of their messages.
    - ``problems``: errors that last; ``warnings``: less than that; ``failures``: exceptions, by what they said.
    - ``rows``: taken; ``rows_rejected``: by reason; ``rows_made``: both together.
    - ``queue``: messages that wait to be judged or used; ``lag`` [s]: of the filter.
    - ``receipt_to_row`` [s]: for each of the last instants, the time from the callback of the message that completed it
      until its rows were added. The lag of the filter is not part of it.
    - ``joints``: their number; ``unmeasured``: those without efforts.
    - ``carried``: a payload that was picked up.
    - ``gaps``: of the monitored channels; ``changed_sensors``: topics of wrench sensors whose rows are left out, as
      they are no longer what they were.
    - ``configured``: false while a managed node is not.
    """

    active: bool
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    failures: Counter[str] = field(default_factory=Counter)
    topics: tuple[str, ...] = ()
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
    carried: Carried | None = None
    configured: bool = True

    def account(self, topic: str) -> Account:
        """What became of a topic's messages."""
        return self.accounts.get(topic, Account())

    def since(self, before: Status) -> Status:
        """The same, but with what was counted after ``before``: messages, rows and failures."""
        return replace(
            self,
            accounts={topic: account.since(before.account(topic)) for topic, account in self.accounts.items()},
            rows=self.rows - before.rows,
            rows_rejected=self.rows_rejected - before.rows_rejected,
            failures=self.failures - before.failures,
        )
