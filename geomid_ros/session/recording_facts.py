"""What is known of recordings beside their samples, and what the ledger of their messages says, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.signals.joint_gate import LEAP
from geomid_ros.signals.ledger import Account, Ledger, Reason, meaning_of


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """What is known of recordings beside their samples.

    Attributes:
        accounts: what became of the messages, by topic.
        findings: what seems to be wrong.
        remarks: what to know although nothing is wrong, in sentences.
        unmeasured: joints whose efforts are missing.
        incomplete: what of the recordings is missing, in sentences.
        unchecked: names of recordings without checksums.
        settled: what was settled for the user, in sentences.
    """

    accounts: Mapping[str, Account] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    remarks: tuple[str, ...] = ()
    unmeasured: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()
    settled: tuple[str, ...] = ()

    @staticmethod
    def together(several: Sequence[Recorded]) -> Recorded:
        """What is known of several: each sentence once, and the joints that are unmeasured in all of them."""
        ledger = Ledger()
        for each in several:
            ledger.add(each.accounts)
        findings = {finding.sentence: finding for each in several for finding in each.findings}
        common = set.intersection(*(set(each.unmeasured) for each in several)) if several else set()
        once = {
            name: tuple(dict.fromkeys(chain.from_iterable(getattr(each, name) for each in several)))
            for name in ("remarks", "unmeasured", "incomplete", "unchecked", "settled")
        }
        once["unmeasured"] = tuple(joint for joint in once["unmeasured"] if joint in common)
        return Recorded(accounts=ledger.topics, findings=tuple(findings.values()), **once)


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


def is_whole(accounts: Mapping[str, Account]) -> bool:
    """Whether no positions leap, by the accounts of all topics."""
    return not any(LEAP in account.noted for account in accounts.values())


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
