"""What a live session tells the diagnostics."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.monitoring.change_detection import ChannelGap
from geomid_ros.signals.ledger import Account


@dataclass(frozen=True, kw_only=True)
class Status:
    """A snapshot for diagnostics; ``topics`` are those that data are expected on, none without a robot description.

    ``problems`` are errors that last, ``warnings`` are less; ``failures`` counts exceptions. ``rows_made``, by their
    samples, are those taken (``rows``) and those rejected. ``queue``: messages that wait for their fate.
    ``receipt_to_row`` [s]: for the last instants whose rows were added, the time since the message that completed them
    came to its callback. The fixed lag of the filter is not in it. ``unmeasured``: joints without efforts. ``gaps``: of
    the channels that are watched. ``changed_sensors``: topics of the wrench sensors that are no longer what they were,
    and whose rows are left out.
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
