"""A checkpoint: all that an identification has learned, so that it can go on after a crash.

A file in the safetensors format: arrays by name and texts, nothing that could run; all of it is checked on reading. The
length of a JSON header (8 bytes, little-endian), the header, the arrays' numbers one after the other. The header has
``dtype``, ``shape`` and ``data_offsets`` by name, and texts under ``__metadata__``. Arrays here are vectors of float64,
and ``sha256``, which is that of all bytes before it.

The library of that name is not used: rosdep has no key for it, and the node must run on packages of Ubuntu alone. It
also takes every type and shape, and writes arrays in an order of its own, in which the checksum would not be the last.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.estimation.identifier import Memory
from geomid_ros.estimation.summary import SummaryState
from geomid_ros.files.schema import plain, structured
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import REGIMES
from geomid_ros.signals.ledger import Account, Meaning, Reason, meaning_of
from geomid_ros.types import FloatArray, IntArray

FORMAT = 3
_DOCUMENT = "checkpoint"
_COUNTS, _POSE, _ESTIMATE = "counts", "last_pose", "estimate"
_MOST_HEADER = 4_000_000  # bytes
_TEXTS, _CHECKSUM = "__metadata__", "sha256"
_LENGTH, _DIGEST = 8, 32  # bytes of the header's length and of the checksum
_OLDER = "driver error: "  # how such reasons begin in a file that does not say what they mean


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
    return 2 * _MOST_HEADER + 8 * folds * (numbers + len(_groups(channels)))


@dataclass(frozen=True, kw_only=True)
class _Account:
    """What became of a topic's messages; ``meanings`` of those reasons and remarks from which something follows."""

    accepted: int
    rejected: Counter[str]
    dropped: Counter[str]
    noted: Counter[str]
    lost: int
    meanings: Mapping[str, Meaning] | None = None

    @property
    def account(self) -> Account:
        """The same as a ledger has it."""
        kinds = (self.rejected, self.dropped, self.noted)
        rejected, dropped, noted = (Counter({self._reason(text): n for text, n in kind.items()}) for kind in kinds)
        return Account(self.accepted, rejected, dropped, noted, self.lost)

    def _reason(self, text: str) -> str:
        older: Meaning = "driver error" if text.startswith(_OLDER) else ""
        meaning = older if self.meanings is None else self.meanings.get(text, "")
        return Reason(text, meaning) if meaning else text


@dataclass(frozen=True, kw_only=True)
class _Header:
    """What a checkpoint says beside its vectors."""

    number: int
    meaning: Mapping[str, Any]
    folds: int
    instants: int
    time: float
    rows: int
    weight: float
    rows_rejected: Counter[str]
    last_stamp: int | None
    chosen_at_rows: int | None
    solving: str
    ledger: Mapping[str, _Account]


def encoded(checkpoint: Checkpoint, channels: Sequence[Channel]) -> bytes:
    """The file of a checkpoint. Raises InputError when its ledger is too long."""
    memory, summary, warm = checkpoint.memory, checkpoint.memory.summary, checkpoint.warm
    header = _Header(
        number=checkpoint.number,
        meaning=checkpoint.meaning,
        folds=len(summary.factors),
        instants=summary.instants,
        time=summary.time,
        rows=summary.rows,
        weight=summary.weight,
        rows_rejected=memory.rows_rejected,
        last_stamp=memory.last_stamp,
        chosen_at_rows=warm.rows if warm is not None else None,
        solving=checkpoint.solving,
        ledger={},
    )
    document = {"format": FORMAT, **plain(header)}
    document["ledger"] = {topic: _account_entry(account) for topic, account in checkpoint.accounts.items()}
    vectors = {_COUNTS: summary.counts.ravel()}
    if memory.last_pose is not None:
        vectors[_POSE] = memory.last_pose
    if warm is not None:
        vectors[_ESTIMATE] = warm.parameters
    for fold, factors in enumerate(summary.factors):
        for index, (channel, factor) in enumerate(zip(_groups(channels), factors, strict=True)):
            vectors[_name(fold, index, channel)] = factor[_triangle(*factor.shape)]
    return pack({_DOCUMENT: json.dumps(document, allow_nan=False)}, vectors)


def _account_entry(account: Account) -> dict[str, Any]:
    reasons = [*account.rejected, *account.dropped, *account.noted]
    meanings = {why: meaning_of(why) for why in reasons if meaning_of(why)}
    return {**plain(vars(account)), **({"meanings": meanings} if meanings else {})}


def decoded(content: bytes, meaning: Mapping[str, Any], channels: Sequence[Channel]) -> Checkpoint:
    """The checkpoint in a file, if its rows have this ``meaning``, for a model with these channels.

    Raises InputError for a file that is damaged or crafted, or of another robot or configuration.
    """
    texts, vectors = unpack(content)
    document = _parsed(texts.get(_DOCUMENT, ""))
    if document.get("format") != FORMAT:
        raise InputError(f"has format {document.get('format')!r:.80}, this version reads format {FORMAT}")
    _require_meaning(document.get("meaning"), meaning)
    try:
        return _checkpoint(structured(_Header, document, "its text:"), vectors, channels)
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
        raise InputError(f"of another configuration: {'; '.join(named)}")


def _checkpoint(header: _Header, vectors: dict[str, FloatArray], channels: Sequence[Channel]) -> Checkpoint:
    groups, counts = _groups(channels), vectors[_COUNTS]
    if counts.size != header.folds * len(groups):
        raise InputError(f"{header.folds} folds with {counts.size} numbers of rows")
    factors = tuple(
        tuple(_factor(vectors[_name(fold, index, channel)], channel) for index, channel in enumerate(groups))
        for fold in range(header.folds)
    )
    counts = counts.reshape(header.folds, len(groups))
    summary = SummaryState(header.instants, header.time, header.rows, header.weight, counts, factors)
    pose, estimate, rows = vectors.get(_POSE), vectors.get(_ESTIMATE), header.chosen_at_rows
    for name, own in (("pose", pose), ("estimate", estimate)):
        if own is not None and not np.all(np.isfinite(own)):
            raise InputError(f"the last {name} is not finite")
    if estimate is not None and rows is None:
        raise InputError("its text: chosen_at_rows is None, expected a count beside an estimate")
    return Checkpoint(
        header.meaning,
        Memory(summary, header.rows_rejected, pose, header.last_stamp),
        {topic: own.account for topic, own in header.ledger.items()},
        None if estimate is None or rows is None else WarmStart(estimate, rows),
        header.solving,
        header.number,
    )


def _name(fold: int, index: int, channel: Channel) -> str:
    return f"fold {fold}/channel {index}/{channel.name}"


def _packed(rows: int, columns: int) -> int:
    """How many numbers are in the upper triangle of so many rows, at most as many as columns."""
    return rows * columns - rows * (rows - 1) // 2


def _triangle(rows: int, columns: int) -> tuple[IntArray, IntArray]:
    """The places of the numbers in the upper triangle, row by row."""
    return np.triu_indices(rows, 0, columns)


def _factor(numbers: FloatArray, channel: Channel) -> FloatArray:
    """The upper triangular factor with these numbers."""
    width = len(channel.columns) + 1
    rows = next((rows for rows in range(width + 1) if _packed(rows, width) == numbers.size), None)
    if rows is None:
        raise InputError(f"channel '{channel.name}' has {numbers.size} numbers, not a triangle of {width} columns")
    factor = np.zeros((rows, width))
    factor[_triangle(rows, width)] = numbers
    return factor


def _groups(channels: Sequence[Channel]) -> tuple[Channel, ...]:
    """The channel of each group of rows."""
    return (*channels,) * REGIMES


def pack(texts: Mapping[str, str], vectors: Mapping[str, FloatArray]) -> bytes:
    """The file with these texts and vectors. Raises InputError when their names and texts are too long."""
    header: dict[str, Any] = {_TEXTS: dict(texts)}
    end = 0
    for name, vector in vectors.items():
        begin, end = end, end + 8 * len(vector)
        header[name] = {"dtype": "F64", "shape": [len(vector)], "data_offsets": [begin, end]}
    header[_CHECKSUM] = {"dtype": "U8", "shape": [_DIGEST], "data_offsets": [end, end + _DIGEST]}
    encoded = json.dumps(header, allow_nan=False).encode()
    encoded += b" " * (-len(encoded) % 8)
    if len(encoded) > _MOST_HEADER:
        raise InputError(f"a header of {len(encoded)} bytes, at most {_MOST_HEADER} are allowed")
    numbers = [np.asarray(vector, dtype="<f8").tobytes() for vector in vectors.values()]
    content = b"".join([len(encoded).to_bytes(_LENGTH, "little"), encoded, *numbers])
    return content + hashlib.sha256(content).digest()


@dataclass(frozen=True)
class _Vector:
    dtype: str
    shape: tuple[int, ...]
    data_offsets: tuple[int, ...]


def unpack(content: bytes) -> tuple[dict[str, str], dict[str, FloatArray]]:
    """The texts and vectors of a file. Raises InputError for what :func:`pack` cannot have made."""
    body, checksum = content[:-_DIGEST], content[-_DIGEST:]
    if hashlib.sha256(body).digest() != checksum:
        raise InputError("the checksum is wrong: damaged or truncated")
    length = int.from_bytes(body[:_LENGTH], "little")
    if length > min(_MOST_HEADER, len(body) - _LENGTH):
        raise InputError("the header is longer than the file, or than is allowed")
    header = _parsed(body[_LENGTH : _LENGTH + length].decode("utf-8", errors="replace"))
    numbers = body[_LENGTH + length :]
    texts, _ = header.pop(_TEXTS, None), header.pop(_CHECKSUM, None)
    if not isinstance(texts, dict) or not all(isinstance(text, str) for text in texts.values()):
        raise InputError("the header has no text")
    vectors, end = {}, 0
    for name, entry in header.items():
        own = structured(_Vector, entry, f"the header: {name}")
        size = math.prod(own.shape)
        begin, end = end, end + 8 * size
        if own != _Vector("F64", (size,), (begin, end)) or end > len(numbers):
            raise InputError(f"the header does not describe {name!r} as a vector of float64 that is there")
        vectors[name] = np.frombuffer(numbers[begin:end], dtype="<f8").astype(np.float64)
    if end != len(numbers):
        raise InputError(f"{len(numbers)} bytes of numbers, {end} are described")
    return texts, vectors


def _parsed(text: str) -> dict[str, Any]:
    """A JSON object without NaN or infinity. Raises InputError."""
    try:
        document = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON ({error})") from error
    if not isinstance(document, dict):
        raise InputError("not a JSON object")
    return document


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not JSON")
