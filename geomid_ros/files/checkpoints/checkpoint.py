"""A checkpoint: all that an identification has learned, so that it can go on after a crash.

A file of :mod:`geomid_ros.files.checkpoints.tensor_file`. Nothing in it is pickled; all of it is checked on reading.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.estimation.identifier import Memory
from geomid_ros.estimation.summary import SummaryState
from geomid_ros.files.checkpoints.tensor_file import MOST_HEADER, pack, parsed, unpack
from geomid_ros.model.channels import Channel
from geomid_ros.signals.ledger import Account
from geomid_ros.types import FloatArray

FORMAT = 2
_DOCUMENT = "checkpoint"
_COUNTS, _POSE, _ESTIMATE = "counts", "last_pose", "estimate"
_LARGEST_COUNT = 2**63
_MOST_NAMED = 5  # differences in one message


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
    numbers = sum(_packed(len(channel.columns) + 1, len(channel.columns) + 1) for channel in _groups(channels))
    return 2 * MOST_HEADER + 8 * folds * (numbers + len(_groups(channels)))


def encoded(checkpoint: Checkpoint, channels: Sequence[Channel]) -> bytes:
    """The file of a checkpoint. Raises InputError when its ledger is too long."""
    memory, summary, warm = checkpoint.memory, checkpoint.memory.summary, checkpoint.warm
    document = {
        "format": FORMAT,
        "number": checkpoint.number,
        "meaning": checkpoint.meaning,
        "folds": len(summary.factors),
        "instants": summary.instants,
        "time": summary.time,
        "rows": summary.rows,
        "weight": summary.weight,
        "rows_rejected": memory.rows_rejected,
        "last_stamp": memory.last_stamp,
        "chosen_at_rows": warm.rows if warm is not None else None,
        "solving": checkpoint.solving,
        "ledger": {topic: vars(account) for topic, account in checkpoint.accounts.items()},
    }
    vectors = {_COUNTS: summary.counts.ravel()}
    if memory.last_pose is not None:
        vectors[_POSE] = memory.last_pose
    if warm is not None:
        vectors[_ESTIMATE] = warm.parameters
    for fold, factors in enumerate(summary.factors):
        for index, (channel, factor) in enumerate(zip(_groups(channels), factors, strict=True)):
            vectors[_name(fold, index, channel)] = _upper(factor)
    return pack({_DOCUMENT: json.dumps(document, allow_nan=False)}, vectors)


def decoded(content: bytes, meaning: Mapping[str, Any], channels: Sequence[Channel]) -> Checkpoint:
    """The checkpoint in a file, if its rows have this ``meaning``, for a model with these channels.

    Raises InputError for a file that is damaged or crafted, or of another robot or configuration.
    """
    texts, vectors = unpack(content)
    document = parsed(texts.get(_DOCUMENT, ""))
    if document.get("format") != FORMAT:
        raise InputError(f"has format {document.get('format')!r:.80}, this version reads format {FORMAT}")
    _require_meaning(document.get("meaning"), meaning)
    try:
        return _checkpoint(document, vectors, channels)
    except KeyError as error:
        raise InputError(f"lacks {error}") from error


def _require_meaning(found: Any, expected: Mapping[str, Any]) -> None:
    """Refuse rows that mean something else."""
    if not isinstance(found, dict):
        raise InputError("does not say what its rows mean")
    different = [name for name in {**expected, **found} if found.get(name) != expected.get(name)]
    if "robot_description" in different:
        raise InputError("of another robot: the robot description differs")
    if different:
        named = [f"{name} is {found.get(name)!r:.80}, here {expected.get(name)!r:.80}" for name in different]
        raise InputError(f"of another configuration: {'; '.join(named[:_MOST_NAMED])}")


def _checkpoint(document: dict[str, Any], vectors: dict[str, FloatArray], channels: Sequence[Channel]) -> Checkpoint:
    folds, groups = _count(document["folds"]), _groups(channels)
    if vectors[_COUNTS].size != folds * len(groups):
        raise InputError(f"{folds} folds with {vectors[_COUNTS].size} numbers of rows")
    summary = SummaryState(
        _count(document["instants"]),
        _number(document["time"]),
        _count(document["rows"]),
        _number(document["weight"]),
        vectors[_COUNTS].reshape(folds, len(groups)),
        tuple(
            tuple(_factor(vectors[_name(fold, index, channel)], channel) for index, channel in enumerate(groups))
            for fold in range(folds)
        ),
    )
    pose, stamp = vectors.get(_POSE), document["last_stamp"]
    if pose is not None and not np.all(np.isfinite(pose)):
        raise InputError("the last pose is not finite")
    return Checkpoint(
        document["meaning"],
        Memory(summary, _counter(document["rows_rejected"]), pose, None if stamp is None else _count(stamp)),
        {topic: _account(account) for topic, account in _object(document["ledger"]).items()},
        _warm(document, vectors[_ESTIMATE]) if _ESTIMATE in vectors else None,
        str(document["solving"]),
        _count(document["number"]),
    )


def _warm(document: dict[str, Any], parameters: FloatArray) -> WarmStart:
    if not np.all(np.isfinite(parameters)):
        raise InputError("the last estimate is not finite")
    return WarmStart(parameters, _count(document["chosen_at_rows"]))


def _name(fold: int, index: int, channel: Channel) -> str:
    return f"fold {fold}/channel {index}/{channel.name}"


def _packed(rows: int, columns: int) -> int:
    """How many numbers are in the upper triangle of so many rows, at most as many as columns."""
    return rows * columns - rows * (rows - 1) // 2


def _upper(factor: FloatArray) -> FloatArray:
    """The numbers in the upper triangle, row by row."""
    return np.concatenate([np.zeros(0), *(row[index:] for index, row in enumerate(factor))])


def _factor(numbers: FloatArray, channel: Channel) -> FloatArray:
    """The upper triangular factor with these numbers."""
    width = len(channel.columns) + 1
    rows = next((rows for rows in range(width + 1) if _packed(rows, width) == numbers.size), None)
    if rows is None:
        raise InputError(f"channel '{channel.name}' has {numbers.size} numbers, not a triangle of {width} columns")
    factor = np.zeros((rows, width))
    for index, row in enumerate(factor):
        begin = _packed(index, width)
        row[index:] = numbers[begin : begin + width - index]
    return factor


def _count(value: Any) -> int:
    if type(value) is not int or not 0 <= value < _LARGEST_COUNT:
        raise InputError(f"{value!r:.80} is not a count")
    return value


def _number(value: Any) -> float:
    """A number as JSON has it, which may be infinite: 1e999. Those who use it check that."""
    if type(value) is not float:
        raise InputError(f"{value!r:.80} is not a number")
    return value


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{value!r:.80} has no names")
    return value


def _counter(value: Any) -> Counter[str]:
    return Counter({reason: _count(count) for reason, count in _object(value).items()})


def _account(value: Any) -> Account:
    entry = _object(value)
    reasons = {kind: _counter(entry[kind]) for kind in ("rejected", "dropped", "noted")}
    return Account(accepted=_count(entry["accepted"]), lost=_count(entry["lost"]), **reasons)


def _groups(channels: Sequence[Channel]) -> tuple[Channel, ...]:
    """The channel of each group of rows."""
    return (*channels, *channels)
