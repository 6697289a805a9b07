"""Files in the safetensors format: arrays by name and texts, nothing that could run. The last array is a checksum.

The length of a JSON header (8 bytes, little-endian), the header, the arrays' numbers one after the other. The header
has ``dtype``, ``shape`` and ``data_offsets`` by name, and texts under ``__metadata__``. Arrays here are vectors of
float64, and ``sha256``, which is that of all bytes before it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.types import FloatArray

MOST_HEADER = 4_000_000
"""Bytes of the longest header."""
_TEXTS = "__metadata__"
_CHECKSUM = "sha256"
_LENGTH = 8  # bytes of the header's length
_DIGEST = 32  # bytes of the checksum


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
    if len(encoded) > MOST_HEADER:
        raise InputError(f"a header of {len(encoded)} bytes, at most {MOST_HEADER} are allowed")
    numbers = [np.asarray(vector, dtype="<f8").tobytes() for vector in vectors.values()]
    content = b"".join([len(encoded).to_bytes(_LENGTH, "little"), encoded, *numbers])
    return content + hashlib.sha256(content).digest()


def unpack(content: bytes) -> tuple[dict[str, str], dict[str, FloatArray]]:
    """The texts and vectors of a file. Raises InputError for what :func:`pack` cannot have made."""
    body, checksum = content[:-_DIGEST], content[-_DIGEST:]
    if hashlib.sha256(body).digest() != checksum:
        raise InputError("the checksum is wrong: damaged or truncated")
    length = int.from_bytes(body[:_LENGTH], "little")
    if length > min(MOST_HEADER, len(body) - _LENGTH):
        raise InputError("the header is longer than the file, or than is allowed")
    header = parsed(body[_LENGTH : _LENGTH + length].decode("utf-8", errors="replace"))
    numbers = body[_LENGTH + length :]
    texts, _ = header.pop(_TEXTS, None), header.pop(_CHECKSUM, None)
    if not isinstance(texts, dict) or not all(isinstance(text, str) for text in texts.values()):
        raise InputError("the header has no text")
    vectors, end = {}, 0
    for name, entry in header.items():
        begin, end = end, _end(name, entry, end, len(numbers))
        vectors[name] = np.frombuffer(numbers[begin:end], dtype="<f8").astype(np.float64)
    if end != len(numbers):
        raise InputError(f"{len(numbers)} bytes of numbers, {end} are described")
    return texts, vectors


def _end(name: str, entry: Any, begin: int, limit: int) -> int:
    """Where a vector ends that begins where the one before ended."""
    offsets = entry.get("data_offsets") if isinstance(entry, dict) else None
    end = offsets[1] if isinstance(offsets, list) and len(offsets) == 2 else None
    if type(end) is not int or not begin <= end <= limit:
        raise InputError(f"the header does not say where {name!r} lies")
    expected = {"dtype": "F64", "shape": [(end - begin) // 8], "data_offsets": [begin, end]}
    if entry != expected or (end - begin) % 8:
        raise InputError(f"the header does not describe {name!r} as a vector of float64")
    return end


def parsed(text: str) -> dict[str, Any]:
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
