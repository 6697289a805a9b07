"""A checkpoint: all that an identification has learned, so that it can go on after a crash."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.estimation.identifier import Memory
from geomid_ros.files.archive import MOST_HEADER, archived, unarchived
from geomid_ros.files.schema import structured
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import REGIMES
from geomid_ros.signals.ledger import Account, Meaning, Reason, meaning_of

FORMAT = 4
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What an identification needs to go on after a crash.

    Attributes:
        meaning: What the rows mean (:attr:`Session.meaning`).
        memory: State of the identifier.
        accounts: The ledger's, by topic.
        warm: The last estimate.
        solving: Checksum of what the estimate depends on beside the rows.
        number: Greater than that of the checkpoint before.
    """

    meaning: Mapping[str, Any]
    memory: Memory
    accounts: Mapping[str, Account] = field(default_factory=dict)
    warm: WarmStart | None = None
    solving: str = ""
    number: int = 0


def largest_size(channels: Sequence[Channel], folds: int) -> int:
    """Bytes that no checkpoint of these channels exceeds."""
    numbers = sum((len(channel.columns) + 1) ** 2 + 1 for channel in channels)
    return 2 * MOST_HEADER + 8 * folds * REGIMES * numbers


def encoded(fields: Mapping[str, Any], accounts: Mapping[str, Account]) -> bytes:
    """The file of a checkpoint, or of other rows: its ``fields``, among them the ``meaning``; and what follows from the
    reasons in the ``accounts`` that are in these fields. Raises InputError when the ledger is too long."""
    reasons = (why for own in accounts.values() for kind in (own.rejected, own.dropped, own.noted) for why in kind)
    meanings = {why: meaning for why in reasons if (meaning := meaning_of(why))}
    return archived({"format": FORMAT, **fields, "meanings": meanings})


def decoded(kind: type[T], content: bytes, meaning: Mapping[str, Any]) -> T:
    """The dataclass that such a file holds, if its rows have this ``meaning``.

    Raises InputError for a file that is damaged or crafted, or of another robot or configuration.
    """
    document = unarchived(content)
    if document.get("format") != FORMAT:
        raise InputError(f"has format {document.get('format')!r:.80}, this version reads format {FORMAT}")
    _require_meaning(document.get("meaning"), meaning)
    meanings = structured(_Reasons, document, "its text:").meanings
    return structured(kind, _with_meanings(document, meanings), "its text:")


@dataclass(frozen=True)
class _Reasons:
    meanings: Mapping[str, Meaning]


def _with_meanings(value: Any, meanings: Mapping[str, Meaning]) -> Any:
    """What a document has, in which reasons say again what follows from them."""
    if isinstance(value, dict):
        return {
            Reason(key, meanings[key]) if key in meanings else key: _with_meanings(own, meanings)
            for key, own in value.items()
        }
    return value


def _require_meaning(found: Any, expected: Mapping[str, Any]) -> None:
    """Refuse rows that mean something else."""
    if not isinstance(found, dict):
        raise InputError("does not say what its rows mean")
    different = [name for name in {**expected, **found} if found.get(name) != expected.get(name)]
    if "robot_description" in different:
        raise InputError("of another robot: the robot description differs")
    if different:
        named = [f"{name} is {found.get(name)!r:.80}, here {expected.get(name)!r:.80}" for name in different]
        raise InputError(f"of another configuration: {'; '.join(named)}")
