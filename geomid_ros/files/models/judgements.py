"""What ``estimate.json`` says of the recording: the verdict with its causes, and what became of the messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geomid_ros.plausibility.hypotheses import Cause, Finding
from geomid_ros.plausibility.verdict import Verdict
from geomid_ros.signals.ledger import Account


def verdict_entry(verdict: Verdict, findings: Sequence[Finding]) -> dict[str, Any]:
    """Whether the result can be used, why not, and what the recording seems to be."""
    return {
        "result": verdict.word,
        "reasons": list(verdict.reasons),
        "causes": causes_entry(findings),
    }


def causes_entry(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """What a recording seems to be, with the parameters that mend it."""
    return [
        _cause_entry(finding.cause) | {"sure": finding.sure, "rivals": [_cause_entry(c) for c in finding.rivals]}
        for finding in findings
    ]


def _cause_entry(cause: Cause) -> dict[str, Any]:
    return {
        "kind": cause.kind,
        "places": list(cause.places),
        "sentence": cause.sentence,
        "settings": dict(cause.settings),
    }


def account_entry(account: Account) -> dict[str, Any]:
    """What became of a topic's messages."""
    return {
        "received": account.received,
        "accepted": account.accepted,
        "rejected": dict(sorted((+account.rejected).items())),
        "dropped": dict(sorted((+account.dropped).items())),
        "noted": dict(sorted((+account.noted).items())),
        "lost": account.lost,
    }
