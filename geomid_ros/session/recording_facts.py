"""What is known of recordings beside their samples: it can be kept, and added up over recordings read elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

from geomid_ros.checks.causes import Finding
from geomid_ros.signals.ledger import Account, Ledger


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
