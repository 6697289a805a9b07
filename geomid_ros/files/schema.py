"""Documents (JSON, YAML) and the dataclasses that are their schema.

The type of a field says what its key must hold, and its default what counts where the key is absent. Keys that no
field names are left alone: a later version may have added them. Numbers that do not exist are NaN here and null there.

Neither msgspec nor cattrs does this: rosdep has a key for neither, and the node, which must run on packages of Ubuntu
alone, reads and writes these files; made strict (no text is a number), cattrs takes as many lines.
"""

from __future__ import annotations

import base64
import json
import math
import reprlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache, singledispatch
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.disk import read_text
from geomid_ros.model.urdf_tree import LARGEST_NUMBER
from geomid_ros.types import AnyArray, FloatArray, frozen

Vector: TypeAlias = Annotated[FloatArray, (3,)]
Matrix: TypeAlias = Annotated[FloatArray, (3, 3)]

FORMAT = 1
"""Of all documents that :func:`read_document` reads."""
MOST_ENTRIES = 40_000
"""Of a list, and of a YAML file."""

_EXPECTED = {float: "a finite number", int: "a count", str: "a text", bool: "true or false"}
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Stored:
    """An array of float64, or bytes, that a document of an archive holds; see :mod:`geomid_ros.files.archive`."""

    content: AnyArray | bytes


def read_document(path: Path, what: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """The JSON object in a file, with these ``keys``; ``what`` it is, for messages.

    Raises InputError naming the file.
    """
    try:
        document = json.loads(read_text(path, what))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: the {what} cannot be read ({error})") from error
    check_form(document, keys, f"{path}:", what)
    return dict(document)


def check_form(document: Any, keys: tuple[str, ...], where: str, what: str) -> None:
    """Refuse another format, and what lacks one of the ``keys``. Raises InputError beginning with ``where``."""
    missing = [key for key in keys if not isinstance(document, dict) or key not in document]
    if missing:
        raise InputError(f"{where} not a {what} as geomid writes it, it has no {' and '.join(map(repr, missing))}")
    if document.get("format") != FORMAT:
        raise InputError(f"{where} has format {document.get('format')!r:.80}, this version reads format {FORMAT}")


def structured(kind: type[T], value: Any, where: str) -> T:
    """The object of a dataclass in a document.

    Args:
        kind: the dataclass.
        value: what the document has.
        where: its file, with a colon, and its key, for messages.

    Raises:
        InputError: the value is none; it says where, and what is expected there.
    """
    found: T = _structured(kind, value, where)
    return found


def _structured(kind: Any, value: Any, where: str) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if kind is bytes or origin is np.ndarray:
        return _stored(kind, value, where)
    if origin is Annotated:
        return _array(value, inner[1], where)
    if origin is Literal:
        if not isinstance(value, str) or value not in inner:
            raise _wrong(value, where, " or ".join(map(repr, inner)))
        return value
    if origin in (Union, UnionType):
        return None if value is None else _structured(inner[0], value, where)
    if is_dataclass(kind):
        return _object(kind, value, where)
    if origin is tuple:
        if not isinstance(value, list) or len(value) > MOST_ENTRIES:
            raise _wrong(value, where, f"a list of at most {MOST_ENTRIES}")
        return tuple(_structured(inner[0], each, f"{where}[{index}]") for index, each in enumerate(value))
    if inner:
        _check_keys(value, where, "an object")
        kind = int if origin is Counter else inner[-1]
        entries = {name: _structured(kind, own, _at(where, name)) for name, own in value.items()}
        return entries if origin is Mapping else origin(entries)
    return _simple(kind, value, where)


def _stored(kind: Any, value: Any, where: str) -> AnyArray | bytes:
    found = value.content if isinstance(value, Stored) else None
    if kind is bytes and isinstance(found, bytes):
        return found
    if kind is not bytes and isinstance(found, np.ndarray) and np.all(np.isfinite(found)):
        return frozen(found)
    raise _wrong(value, where, "bytes" if kind is bytes else "an array of finite numbers")


def _simple(kind: Any, value: Any, where: str) -> Any:
    if kind is Any:
        return value
    if kind is float and value is None:
        return math.nan
    if kind is float and type(value) in (int, float) and abs(value) < LARGEST_NUMBER:
        return float(value)
    if kind is not float and type(value) is kind and (kind is not int or 0 <= value <= np.iinfo(np.int64).max):
        return value
    raise _wrong(value, where, _EXPECTED[kind])


@cache
def _keys(kind: Any) -> dict[str, tuple[Any, bool]]:
    """The type of each key, and whether it must be there."""
    hints = get_type_hints(kind, include_extras=True)
    needed = {own.name: own.default is MISSING and own.default_factory is MISSING for own in fields(kind)}
    return {name: (hints[name], is_needed) for name, is_needed in needed.items()}


def _object(kind: Any, value: Any, where: str) -> Any:
    keys = _keys(kind)
    _check_keys(value, where, f"an object with {', '.join(name for name, (_, needed) in keys.items() if needed)}")
    for name, (_, needed) in keys.items():
        if needed and name not in value:
            raise InputError(f"{_at(where, name)} is not given")
    given = {name: _structured(own, value[name], _at(where, name)) for name, (own, _) in keys.items() if name in value}
    found = kind(**given)
    check(found, where)
    return found


@singledispatch
def check(value: Any, where: str) -> None:
    """Refuse an object that its fields allow and that cannot be, which ``where`` names. Who knows a class registers
    what refuses its objects."""


def _check_keys(value: Any, where: str, expected: str) -> None:
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
        raise _wrong(value, where, expected)


def _array(value: Any, shape: tuple[int, ...], where: str) -> FloatArray:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.shape != shape or np.any(np.abs(array) >= LARGEST_NUMBER):
        raise _wrong(value, where, f"finite numbers, {' by '.join(map(str, shape))}")
    return array


def packed(numbers: FloatArray, form: str) -> str:
    """Numbers in base64, each of this ``form``: ``<f4`` or ``<f8``."""
    return base64.b64encode(numbers.astype(form).tobytes()).decode()


def unpacked(text: str, form: str, count: int) -> FloatArray:
    """So many numbers of such a text. Raises ValueError."""
    return np.frombuffer(base64.b64decode(text, validate=True), form).astype(np.float64).reshape(count)


def unpacked_triangle(text: str, form: str, size: int) -> FloatArray:
    """The upper triangular matrix ``(size, size)`` whose numbers are in such a text, row by row. Raises ValueError."""
    return upper_triangle(unpacked(text, form, size * (size + 1) // 2), (size, size))


def upper_triangle(numbers: AnyArray, shape: tuple[int, ...]) -> FloatArray:
    """The matrix with these numbers in its upper triangle, row by row, which no file claims without them."""
    matrix = np.zeros(shape)
    matrix[triangle_of(shape)] = numbers
    return matrix


def triangle_of(shape: tuple[int, ...]) -> tuple[AnyArray, ...]:
    """The places of the numbers in an upper triangle, row by row."""
    return np.triu_indices(shape[0], 0, shape[1])


def _at(where: str, name: str) -> str:
    return f"{where} {name}" if where.endswith(":") else f"{where}.{name}"


def _wrong(value: Any, where: str, expected: str) -> InputError:
    return InputError(f"{where} is {reprlib.repr(value)}, expected {expected}")


def plain(value: Any) -> Any:
    """What a document has of a value: of a dataclass its fields, of an array its numbers."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if is_dataclass(value):
        return entry(value, *(own.name for own in fields(value)))
    if isinstance(value, Mapping):
        return {name: plain(own) for name, own in value.items()}
    return [plain(own) for own in value] if isinstance(value, list | tuple) else value


def entry(value: Any, *names: str) -> dict[str, Any]:
    """What a document has of these attributes."""
    return {name: plain(getattr(value, name)) for name in names}
