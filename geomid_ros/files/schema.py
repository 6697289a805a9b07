"""Documents (JSON, YAML) and the dataclasses that are their schema.

The type of a field determines the value of its key; its default applies if the key is absent. Unknown keys are ignored:
a later version may have added them. NaN is written as null.

Neither msgspec nor cattrs is used: rosdep has a key for neither, and the node, which must run on Ubuntu packages alone,
reads and writes these files. With strict types (no text is a number), cattrs would need as many lines.
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

from geomid_ros.errors import InputError, refusing
from geomid_ros.files.disk import read_text
from geomid_ros.model.urdf_tree import LARGEST_NUMBER
from geomid_ros.types import AnyArray, FloatArray, frozen

Vector: TypeAlias = Annotated[FloatArray, (3,)]
Matrix: TypeAlias = Annotated[FloatArray, (3, 3)]

FORMAT = 1
"""Format version of all documents that :func:`read_document` reads."""
MOST_ENTRIES = 40_000
"""Maximum number of entries of a list, and of values in a YAML file."""

_EXPECTED = {float: "a finite number", int: "a count", str: "a text", bool: "true or false"}
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Stored:
    """Array of float64, or bytes, in the document of an archive; see :mod:`geomid_ros.files.archive`."""

    content: AnyArray | bytes


def read_document(path: Path, what: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """JSON object in a file; see :func:`parse_document`."""
    return parse_document(read_text(path, what), str(path), what, keys)


def parse_document(text: str, source: str, what: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """JSON object in a text, with these ``keys``; ``source`` and ``what`` name it in messages.

    Raises InputError naming the source.
    """
    with refusing(
        f"{source}: the {what} cannot be read, it must be JSON as geomid writes it", ValueError, RecursionError
    ):
        document = json.loads(text)
    check_form(document, keys, f"{source}:", what)
    return dict(document)


def check_form(document: Any, keys: tuple[str, ...], where: str, what: str) -> None:
    """Refuse another format, or a document without one of the ``keys``. Raises InputError beginning with ``where``."""
    missing = [key for key in keys if not isinstance(document, dict) or key not in document]
    if missing:
        raise InputError(f"{where} not a {what} as geomid writes it, it has no {' and '.join(map(repr, missing))}")
    if document.get("format") != FORMAT:
        raise InputError(f"{where} has format {document.get('format')!r:.80}, this version reads format {FORMAT}")


def from_document(kind: type[T], value: Any, where: str) -> T:
    """Convert a value of a document to a dataclass.

    Args:
        kind: the dataclass.
        value: the value in the document.
        where: its file, with a colon, and its key, for messages.

    Raises:
        InputError: the value does not fit; it names the place and the expected value.
    """
    result: T = _structured(kind, value, where)
    return result


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
        return tuple(_structured(inner[0], element, f"{where}[{index}]") for index, element in enumerate(value))
    if inner:
        _check_keys(value, where, "an object")
        kind = int if origin is Counter else inner[-1]
        entries = {name: _structured(kind, item, _at(where, name)) for name, item in value.items()}
        return entries if origin is Mapping else origin(entries)
    return _simple(kind, value, where)


def _stored(kind: Any, value: Any, where: str) -> AnyArray | bytes:
    content = value.content if isinstance(value, Stored) else None
    if kind is bytes and isinstance(content, bytes):
        return content
    if kind is not bytes and isinstance(content, np.ndarray) and np.all(np.isfinite(content)):
        return frozen(content)
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
    """Type of each key, and whether it is required."""
    hints = get_type_hints(kind, include_extras=True)
    required = {field.name: field.default is MISSING and field.default_factory is MISSING for field in fields(kind)}
    return {name: (hints[name], is_required) for name, is_required in required.items()}


def _object(kind: Any, value: Any, where: str) -> Any:
    keys = _keys(kind)
    _check_keys(value, where, f"an object with {', '.join(key for key, (_, required) in keys.items() if required)}")
    for key, (_, required) in keys.items():
        if required and key not in value:
            raise InputError(f"{_at(where, key)} is not given")
    given = {key: _structured(form, value[key], _at(where, key)) for key, (form, _) in keys.items() if key in value}
    result = kind(**given)
    check(result, where)
    return result


@singledispatch
def check(value: Any, where: str) -> None:
    """Refuse an object whose fields are valid alone but not together; ``where`` names it. Each class registers its
    check."""


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


def to_base64(numbers: FloatArray, form: str) -> str:
    """Encode numbers as base64, each in this ``form``: ``<f4`` or ``<f8``."""
    return base64.b64encode(numbers.astype(form).tobytes()).decode()


def from_base64(text: str, form: str, count: int) -> FloatArray:
    """Decode ``count`` numbers from such a text. Raises ValueError."""
    return np.frombuffer(base64.b64decode(text, validate=True), form).astype(np.float64).reshape(count)


def triangle_from_base64(text: str, form: str, size: int) -> FloatArray:
    """Decode an upper triangular matrix ``(size, size)``, stored row by row, from such a text. Raises ValueError."""
    return from_upper_triangle(from_base64(text, form, size * (size + 1) // 2), (size, size))


def from_upper_triangle(numbers: AnyArray, shape: tuple[int, ...]) -> FloatArray:
    """Matrix with these numbers in its upper triangle, row by row. No file can claim a large one without them."""
    matrix = np.zeros(shape)
    matrix[np.triu_indices(shape[0], 0, shape[1])] = numbers
    return matrix


def upper_triangle(matrix: AnyArray) -> AnyArray:
    """Numbers of an upper triangle, row by row."""
    numbers: AnyArray = matrix[np.triu_indices(len(matrix), 0, matrix.shape[1])]
    return numbers


def _at(where: str, name: str) -> str:
    return f"{where} {name}" if where.endswith(":") else f"{where}.{name}"


def _wrong(value: Any, where: str, expected: str) -> InputError:
    return InputError(f"{where} is {reprlib.repr(value)}, expected {expected}")


def to_document(value: Any) -> Any:
    """Convert a value for a document: a dataclass to its fields, an array to its numbers."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return to_document(value.tolist())
    if is_dataclass(value):
        return attributes_entry(value, *(item.name for item in fields(value)))
    if isinstance(value, Mapping):
        return {name: to_document(item) for name, item in value.items()}
    return [to_document(item) for item in value] if isinstance(value, list | tuple) else value


def attributes_entry(value: Any, *names: str) -> dict[str, Any]:
    """Convert these attributes of a value for a document."""
    return {name: to_document(getattr(value, name)) for name in names}
