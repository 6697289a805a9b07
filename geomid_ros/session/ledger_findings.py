"""What the ledger of messages says of a recording, in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.signals.ledger import Account, Reason, meaning_of

_OFTEN = "; does the driver publish more often than it measures? What repeats is left out, the rest serves"


def faulty_streams(accounts: Mapping[str, Account], before: Mapping[str, Account]) -> list[Finding]:
    """The faults of drivers that make all of their messages doubtful.

    Args:
        accounts: by topic.
        before: the same at an earlier time; what was counted by then does not matter.
    """
    found = []
    for topic, account in accounts.items():
        noted = account.noted - before.get(topic, Account()).noted
        found += [
            Finding(cause=Cause(kind="stream", sentence=f"{topic}: {remark.sentence}", places=(topic,)))
            for remark in noted
            if isinstance(remark, Reason) and remark.meaning == "driver error"
        ]
    return found


def peculiarities(accounts: Mapping[str, Account]) -> list[str]:
    """What to know of messages although the others can be used."""
    found = []
    for topic, account in accounts.items():
        if +account.rejected:
            ((reason, most),) = account.rejected.most_common(1)
            refused = f"{account.rejected.total()} of {account.received} messages are refused"
            which = "all" if most == account.rejected.total() else f"{most}"
            found.append(
                f"{topic}: {refused}, {which} of them: {reason}{_OFTEN if meaning_of(reason) == 'repeated' else ''}"
            )
        found += [f"{topic}: {remark}" for remark in account.noted if meaning_of(remark) == "told"]
    return found
