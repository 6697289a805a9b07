"""Dataclasses with arrays, above all regressor rows with their meaning, in one safetensors file with a checksum.
Loading it executes no code.

Layout: the length of the JSON header (8 bytes, little-endian), the header, then the numbers of all arrays. The header
gives ``dtype``, ``shape`` and ``data_offsets`` of each array. Its text under ``__metadata__`` contains the fields as
JSON. There, ``{"array": NAME, "shape": [...]}`` stands for an array of float64, with ``"triangle": true`` for an upper
triangle, row by row; ``{"bytes": NAME}`` for bytes. The last, ``sha256``, is the checksum of all bytes before it.

The safetensors library is not used: rosdep has no key for it, and the node must run on Ubuntu packages alone. It also
accepts every type and shape, and orders the arrays itself, so the checksum would not be last.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from geomid_ros.errors import InputError, refusing
from geomid_ros.files.schema import Stored, from_document, from_upper_triangle, upper_triangle
from geomid_ros.signals.ledger import Account, Meaning, Reason, meaning_of
from geomid_ros.types import AnyArray, FloatArray

FORMAT = 5
"""Format version of files of rows."""
MOST_HEADER = 4_000_000
"""Maximum header size [bytes]."""
T = TypeVar("T")
_TEXTS, _CHECKSUM = "__metadata__", "sha256"
_LENGTH, _DIGEST = struct.Struct("<Q"), hashlib.sha256().digest_size
_DTYPES: Mapping[str, np.dtype[Any]] = {"F64": np.dtype("<f8"), "U8": np.dtype(np.uint8)}


def encoded(fields: Mapping[str, Any], accounts: Mapping[str, Account]) -> bytes:
    """Encode a checkpoint or other rows as a file: the ``fields``, which include the rows' ``meaning``, and the
    meanings of the reasons in the ``accounts``. Raises InputError if the ledger is too long."""
    reasons = (why for a in accounts.values() for kind in (a.rejected, a.dropped, a.noted) for why in kind)
    meanings = {why: meaning for why in reasons if (meaning := meaning_of(why))}
    return archived({"format": FORMAT, **fields, "meanings": meanings})


def decoded(kind: type[T], content: bytes, meaning: Mapping[str, Any]) -> T:
    """Decode a file of :func:`encoded` into a dataclass, if its rows have this ``meaning``.

    Raises InputError for a file that is damaged or crafted, or of another robot or configuration.
    """
    document = unarchived(content)
    if document.get("format") != FORMAT:
        raise InputError(f"has format {document.get('format')!r:.80}, this version reads format {FORMAT}")
    _require_meaning(document.get("meaning"), meaning)
    meanings = from_document(dict[str, Meaning], document.get("meanings"), "its text: meanings")
    return from_document(kind, _with_meanings(document, meanings), "its text:")


def _with_meanings(value: Any, meanings: Mapping[str, Meaning]) -> Any:
    """Document in which the reasons have their meanings again."""
    if isinstance(value, dict):
        return {
            Reason(key, meanings[key]) if key in meanings else key: _with_meanings(item, meanings)
            for key, item in value.items()
        }
    return value


def _require_meaning(actual: Any, expected: Mapping[str, Any]) -> None:
    """Refuse rows with another meaning."""
    if not isinstance(actual, dict):
        raise InputError("does not say what its rows mean")
    if actual.get("robot_description") != expected.get("robot_description"):
        raise InputError("of another robot: the robot description differs")
    if differences := [*_differences(actual, expected)]:
        raise InputError(f"of another configuration: {'; '.join(differences)}")


def _differences(actual: Any, expected: Any, name: str = "") -> Iterator[str]:
    """Yield a text for each key whose values differ; of lists, it has the elements that only one has, if there are
    any."""
    if isinstance(actual, dict) and isinstance(expected, dict):
        for key in {**expected, **actual}:
            yield from _differences(actual.get(key), expected.get(key), f"{name}.{key}" if name else key)
    elif actual != expected:
        if isinstance(actual, list) and isinstance(expected, list):
            own = [
                [item for item in one if item not in other] for one, other in ((actual, expected), (expected, actual))
            ]
            actual, expected = own if any(own) else (actual, expected)
        yield f"{name} is {actual!r:.80}, here {expected!r:.80}"


def archived(document: Mapping[str, Any]) -> bytes:
    """Encode a document of dataclasses, arrays and bytes as a file. Raises InputError if its texts are too long."""
    vectors: dict[str, AnyArray] = {}

    def stored(value: Any) -> Any:
        name = str(len(vectors))
        if isinstance(value, bytes):
            vectors[name] = np.frombuffer(value, np.uint8)
            return {"bytes": name}
        if isinstance(value, np.ndarray):
            triangle = value.ndim == 2 and 0 < len(value) <= value.shape[1] and not np.any(np.tril(value, -1))
            vectors[name] = (upper_triangle(value) if triangle else value.ravel()).astype(_DTYPES["F64"])
            return {"array": name, "shape": value.shape} | ({"triangle": True} if triangle else {})
        return (
            value.item()
            if isinstance(value, np.generic)
            else {field.name: getattr(value, field.name) for field in fields(value)}
        )

    return pack(json.dumps(document, default=stored, allow_nan=False), vectors)


def unarchived(content: bytes) -> dict[str, Any]:
    """Decode a file of :func:`archived`; its arrays and bytes become :class:`Stored`. Raises InputError if invalid."""
    text, vectors = unpack(content)

    def restored(entry: dict[str, Any]) -> Any:
        if isinstance(name := entry.get("bytes"), str) and name in vectors:
            return Stored(vectors[name].tobytes())
        if isinstance(name := entry.get("array"), str) and name in vectors:
            shape = from_document(tuple[int, ...], entry.get("shape"), "its text: shape")
            return Stored(_shaped(vectors[name], shape, entry.get("triangle") is True))
        return entry

    return _parsed(text, restored)


def _shaped(vector: AnyArray, shape: tuple[int, ...], triangle: bool) -> FloatArray:
    """Array of these numbers, or with them in its upper triangle. Raises ValueError if their count differs."""
    if not triangle:
        return vector.reshape(shape)
    rows, columns = shape
    if not 0 < rows <= columns or rows * columns - rows * (rows - 1) // 2 != len(vector):
        raise ValueError(f"{len(vector)} numbers are no triangle of shape {shape}")
    return from_upper_triangle(vector, shape)


def pack(text: str, vectors: Mapping[str, AnyArray]) -> bytes:
    """Encode a text and vectors of numbers or bytes as a file. Raises InputError if names and text are too long."""
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
    content = b"".join([_LENGTH.pack(len(encoded)), encoded, *(array.tobytes() for array in vectors.values())])
    return content + hashlib.sha256(content).digest()


def unpack(content: bytes) -> tuple[str, dict[str, AnyArray]]:
    """Decode a file into its text and vectors. Raises InputError for content that :func:`pack` cannot have made."""
    body, checksum = content[:-_DIGEST], content[-_DIGEST:]
    if hashlib.sha256(body).digest() != checksum:
        raise InputError("the checksum is wrong: damaged or truncated")
    (length,) = _LENGTH.unpack_from(body.ljust(_LENGTH.size, b"\xff"))
    if length > min(MOST_HEADER, len(body) - _LENGTH.size):
        raise InputError("the header is longer than the file, or than is allowed")
    start, numbers = body[_LENGTH.size : _LENGTH.size + length], body[_LENGTH.size + length :]
    header = _parsed(start.decode("utf-8", errors="replace"))
    header.pop(_CHECKSUM, None)
    with refusing("the header does not describe its text and vectors", LookupError, TypeError, ValueError):
        text = str(header.pop(_TEXTS)["document"])
        vectors = {
            name: np.frombuffer(numbers[slice(*tensor["data_offsets"])], _DTYPES[tensor["dtype"]])
            for name, tensor in header.items()
        }
    if pack(text, vectors) != content:
        raise InputError("the header describes other vectors than those that are there")
    return text, vectors


def _parsed(text: str, restored: Callable[[dict[str, Any]], Any] | None = None) -> dict[str, Any]:
    """JSON object without NaN or infinity, in which ``restored`` replaces inner objects. Raises InputError."""
    with refusing("its text cannot be read", ValueError, RecursionError):
        document = json.loads(text, parse_constant=_refuse, object_hook=restored)
    if not isinstance(document, dict):
        raise InputError("its text is not a JSON object")
    return document


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not JSON")
