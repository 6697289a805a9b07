"""Dataclasses with arrays, above all rows with their meaning, in one file of the safetensors format with a checksum:
nothing in it could run.

The length of a JSON header (8 bytes, little-endian), the header, the arrays' numbers one after the other. The header
has ``dtype``, ``shape`` and ``data_offsets`` of each, and a text under ``__metadata__``: the fields as JSON, in which
``{"array": NAME, "shape": [...]}`` stands for an array of float64, with ``"triangle": true`` for an upper triangle, row
by row; ``{"bytes": NAME}`` for bytes. The last is ``sha256``, that of all bytes before it.

The library of that name is not used: rosdep has no key for it, and the node must run on packages of Ubuntu alone. It
also takes every type and shape, and writes arrays in an order of its own, in which the checksum would not be the last.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, TypeVar

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.schema import Stored, structured, triangle_of, upper_triangle
from geomid_ros.signals.ledger import Account, Meaning, Reason, meaning_of
from geomid_ros.types import AnyArray, FloatArray

FORMAT = 5
"""Of files of rows."""
MOST_HEADER = 4_000_000
"""Bytes of the header."""
T = TypeVar("T")
_TEXTS, _CHECKSUM = "__metadata__", "sha256"
_LENGTH, _DIGEST = struct.Struct("<Q"), hashlib.sha256().digest_size
_DTYPES: Mapping[str, np.dtype[Any]] = {"F64": np.dtype("<f8"), "U8": np.dtype(np.uint8)}


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


def archived(document: Mapping[str, Any]) -> bytes:
    """The file of a document, whose values may be dataclasses, arrays and bytes. Raises InputError for one whose texts
    are too long."""
    vectors: dict[str, AnyArray] = {}

    def stored(value: Any) -> Any:
        name = str(len(vectors))
        if isinstance(value, bytes):
            vectors[name] = np.frombuffer(value, np.uint8)
            return {"bytes": name}
        if isinstance(value, np.ndarray):
            triangle = value.ndim == 2 and 0 < len(value) <= value.shape[1] and not np.any(np.tril(value, -1))
            vectors[name] = (value[triangle_of(value.shape)] if triangle else value.ravel()).astype(_DTYPES["F64"])
            return {"array": name, "shape": value.shape} | ({"triangle": True} if triangle else {})
        return (
            value.item()
            if isinstance(value, np.generic)
            else {own.name: getattr(value, own.name) for own in fields(value)}
        )

    return pack(json.dumps(document, default=stored, allow_nan=False), vectors)


def unarchived(content: bytes) -> dict[str, Any]:
    """The document of such a file, its arrays and bytes as :class:`Stored`. Raises InputError for what is none."""
    text, vectors = unpack(content)

    def restored(entry: dict[str, Any]) -> Any:
        if isinstance(name := entry.get("bytes"), str) and name in vectors:
            return Stored(vectors[name].tobytes())
        if isinstance(name := entry.get("array"), str) and name in vectors:
            return Stored(_shaped(vectors[name], structured(_Reference, entry, "its text:")))
        return entry

    return _parsed(text, restored)


@dataclass(frozen=True)
class _Reference:
    array: str
    shape: tuple[int, ...]
    triangle: bool = False


def _shaped(vector: AnyArray, given: _Reference) -> FloatArray:
    """The array of these numbers. Raises ValueError where they are more or fewer."""
    if not given.triangle:
        return vector.reshape(given.shape)
    rows, columns = given.shape
    if not 0 < rows <= columns or rows * columns - rows * (rows - 1) // 2 != len(vector):
        raise ValueError(f"{len(vector)} numbers are no triangle of shape {given.shape}")
    return upper_triangle(vector, given.shape)


def pack(text: str, vectors: Mapping[str, AnyArray]) -> bytes:
    """The file with this text and these vectors, of numbers or of bytes. Raises InputError if names and text are too
    long."""
    header: dict[str, Any] = {_TEXTS: {"document": text}}
    end = 0
    for name, vector in vectors.items():
        begin, end = end, end + vector.nbytes
        dtype = "U8" if vector.dtype == np.uint8 else "F64"
        header[name] = {"dtype": dtype, "shape": [len(vector)], "data_offsets": [begin, end]}
    header[_CHECKSUM] = {"dtype": "U8", "shape": [_DIGEST], "data_offsets": [end, end + _DIGEST]}
    encoded = json.dumps(header, allow_nan=False).encode()
    encoded += b" " * (-len(encoded) % 8)
    if len(encoded) > MOST_HEADER:
        raise InputError(f"a header of {len(encoded)} bytes, at most {MOST_HEADER} are allowed")
    content = b"".join([_LENGTH.pack(len(encoded)), encoded, *(own.tobytes() for own in vectors.values())])
    return content + hashlib.sha256(content).digest()


@dataclass(frozen=True)
class _Tensor:
    dtype: Literal["F64", "U8"]
    shape: tuple[int, ...]
    data_offsets: tuple[int, ...]


def unpack(content: bytes) -> tuple[str, dict[str, AnyArray]]:
    """The text and the vectors of a file. Raises InputError for what :func:`pack` cannot have made."""
    body, checksum = content[:-_DIGEST], content[-_DIGEST:]
    if hashlib.sha256(body).digest() != checksum:
        raise InputError("the checksum is wrong: damaged or truncated")
    (length,) = _LENGTH.unpack_from(body.ljust(_LENGTH.size, b"\xff"))
    if length > min(MOST_HEADER, len(body) - _LENGTH.size):
        raise InputError("the header is longer than the file, or than is allowed")
    start, numbers = body[_LENGTH.size : _LENGTH.size + length], body[_LENGTH.size + length :]
    header = _parsed(start.decode("utf-8", errors="replace"))
    text = structured(_Texts, header.pop(_TEXTS, None), "the header:").document
    header.pop(_CHECKSUM, None)
    vectors, end = {}, 0
    for name, entry in header.items():
        own = structured(_Tensor, entry, f"the header: {name}")
        size = math.prod(own.shape)
        begin, end = end, end + _DTYPES[own.dtype].itemsize * size
        if own != _Tensor(own.dtype, (size,), (begin, end)) or end > len(numbers):
            raise InputError(f"the header does not describe {name!r} as a vector that is there")
        vectors[name] = np.frombuffer(numbers[begin:end], _DTYPES[own.dtype])
    if end != len(numbers):
        raise InputError(f"{len(numbers)} bytes of numbers, {end} are described")
    return text, vectors


@dataclass(frozen=True)
class _Texts:
    document: str


def _parsed(text: str, restored: Callable[[dict[str, Any]], Any] | None = None) -> dict[str, Any]:
    """A JSON object without NaN or infinity, in which ``restored`` replaces objects. Raises InputError."""
    try:
        document = json.loads(text, parse_constant=_refuse, object_hook=restored)
    except (ValueError, RecursionError) as error:
        raise InputError(f"its text cannot be read ({error})") from error
    if not isinstance(document, dict):
        raise InputError("its text is not a JSON object")
    return document


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not JSON")
