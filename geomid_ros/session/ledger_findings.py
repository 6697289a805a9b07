"""What the ledger of messages says of a recording, in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.signals.effort_habits import COARSE
from geomid_ros.signals.gates import CLOCK_SET, KEPT
from geomid_ros.signals.joint_messages import DRIVER_ERROR, FROZEN, UNWRAPPED
from geomid_ros.signals.ledger import Account
from geomid_ros.signals.sampler import SCALED
from geomid_ros.signals.timeline import NOT_LATER

_OFTEN = "; does the driver publish more often than it measures? What repeats is left out, the rest serves"
_ASKED = {FROZEN: _OFTEN, NOT_LATER: _OFTEN}
_TOLD = (CLOCK_SET, KEPT, UNWRAPPED, SCALED, COARSE)


def faulty_streams(accounts: Mapping[str, Account], before: Mapping[str, Account]) -> list[Finding]:
    """The faults of drivers that make all of their messages doubtful.

    Args:
        accounts: by topic.
        before: the same at an earlier time; what was counted by then does not matter.
    """
    found = []
    for topic, account in accounts.items():
        noted = account.noted - before.get(topic, Account()).noted
        sentences = [remark.removeprefix(DRIVER_ERROR) for remark in noted if remark.startswith(DRIVER_ERROR)]
        found += [
            Finding(cause=Cause(kind="stream", sentence=f"{topic}: {sentence}", places=(topic,)))
            for sentence in sentences
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
            found.append(f"{topic}: {refused}, {which} of them: {reason}{_ASKED.get(reason, '')}")
        found += [f"{topic}: {remark}" for remark in account.noted if remark.endswith(_TOLD)]
    return found
