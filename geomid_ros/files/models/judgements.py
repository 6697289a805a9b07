"""What ``estimate.json`` says of the recording: the verdict with its causes, and what became of the messages.

The verdict is read again wherever the estimate is used.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from typing import Any

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.verdict import NOT_CONVERGED, STATUS, USABLE, Verdict
from geomid_ros.errors import InputError, unknown_name
from geomid_ros.signals.ledger import Account


def verdict_entry(verdict: Verdict, findings: Sequence[Finding]) -> dict[str, Any]:
    """Whether the result can be used, why not, and what the recording seems to be."""
    return {
        "result": verdict.word,
        "reasons": list(verdict.reasons),
        "causes": causes_entry(findings),
    }


def read_verdict(document: Mapping[str, Any], source: str) -> Verdict:
    """The verdict of a document; one without any is usable if its solver converged.

    Raises:
        InputError: the verdict is none; the message names the file ``source``.
    """
    stopped = {"result": NOT_CONVERGED, "reasons": [str(document.get("reason", ""))]}
    entry = document.get("verdict", stopped if document.get("converged") is False else {"result": USABLE})
    if not isinstance(entry, dict) or not isinstance(reasons := entry.get("reasons", []), list):
        raise InputError(f"{source}: the verdict is {reprlib.repr(entry)}, expected a result with a list of reasons")
    word = str(entry.get("result"))
    if word not in STATUS:
        raise InputError(f"{source}: {unknown_name('verdict', word, STATUS)}")
    return Verdict(word=word, reasons=tuple(map(str, reasons)))


def doubt(document: Mapping[str, Any], source: str) -> str:
    """Why the estimate of a document should not be used, in a sentence; empty if nothing speaks against it.

    Raises:
        InputError: as :func:`read_verdict`.
    """
    verdict = read_verdict(document, source)
    if verdict.word == USABLE:
        return ""
    return f"{source}: this model's verdict is '{verdict.word}': {'; '.join(verdict.reasons) or 'no reason is given'}"


def causes_entry(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """What a recording seems to be, with the parameters that mend it."""
    return [
        _cause_entry(finding.cause) | {"sure": finding.sure, "rivals": [_cause_entry(c) for c in finding.rivals]}
        for finding in findings
    ]


def doubts_of(document: Mapping[str, Any]) -> list[str]:
    """The sentences on what a recording seems to be. Raises KeyError or TypeError for a document without them."""
    return [
        Finding(cause=_cause(entry), sure=entry["sure"], rivals=tuple(map(_cause, entry["rivals"]))).sentence
        for entry in document["causes"]
    ]


def _cause(entry: Mapping[str, Any]) -> Cause:
    return Cause(kind=entry["kind"], sentence=entry["sentence"])


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
