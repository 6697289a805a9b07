"""Options declared once: the fields of a frozen dataclass are a function's keywords and a command's options, and its
docstring is the help of both."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ParamSpec, TypeAlias, TypeVar

from geomid_ros.errors import InputError, unknown_name

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")

Progress: TypeAlias = Callable[[str, float], None]
"""Callback for progress: called with the current stage and its completed fraction, 0 to 1."""
_ATTRIBUTE = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


def silent(stage: str, share: float) -> None:
    """Show no progress."""


def option(default: Any = None, **declared: Any) -> Any:
    """Declare a field with more than a type and a ``default``.

    Args:
        default: default value.
        declared: ``choices`` of a text; ``min`` and ``max`` of a number, with ``min_open`` or ``max_open`` if that end
            is excluded; ``sets``: the node's parameter that it sets; ``file``: file for which a folder that contains
            it stands; ``or_none``, if a list of names may be empty. For the command line: ``flag``, if it has another
            name there; ``earlier``: its flag in the last release; ``metavar``.
    """
    return field(default=default, metadata=declared)


@dataclass(frozen=True)
class Options:
    """Options that are checked on construction; None is the default. Raises InputError, with the option's name, for a
    number out of its range, a text that is not one of its choices, or an option that is missing."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if value is None:
                value = entry.default
            if value is MISSING and "None" not in str(entry.type):
                raise InputError(f"{entry.name} is missing: None is given")
            value = None if value is MISSING else _as_meant(value, entry)
            object.__setattr__(self, entry.name, value)
            if value is not None and "choices" in entry.metadata and value not in entry.metadata["choices"]:
                raise unknown_name(entry.name, str(value), entry.metadata["choices"])
            if value is not None and "min" in entry.metadata:
                _check_range(entry.name, value, entry.metadata)


def _as_meant(value: Any, entry: Field[Any]) -> Any:
    """Return the names in a text, or the path of the file in a folder, for options that have these; else the value."""
    if isinstance(value, str) and entry.type == "Texts | None":
        return names_in(value, or_none="or_none" in entry.metadata)
    file = Path(value) / entry.metadata["file"] if "file" in entry.metadata and isinstance(value, str | Path) else None
    return file if file is not None and file.is_file() else value


def names_in(text: str, *, or_none: bool = False) -> list[str]:
    """Return names that are separated by commas; with ``or_none`` the word 'none' stands for no name."""
    names = [name.strip() for name in text.split(",")]
    return [] if or_none and names == ["none"] else names


def numbers_in(text: str, separator: str = ",") -> list[float]:
    """Return the finite numbers in a text, between which this ``separator`` stands; none for any other text."""
    try:
        numbers = [float(part) for part in text.split(separator)]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def _check_range(name: str, value: Any, declared: Mapping[str, Any]) -> None:
    """Refuse what is no number, or out of its range (InputError)."""
    low, high = declared["min"], declared.get("max", math.inf)
    if not isinstance(value, Integral if isinstance(low, int) else Real):
        raise InputError(f"{name} is {value!r}, expected a {'whole ' if isinstance(low, int) else ''}number")
    at_an_end = (value == low and declared.get("min_open")) or (value == high and declared.get("max_open"))
    if not low <= value <= high or at_an_end or math.isinf(value):
        lower = f"{low:g} {'<' if declared.get('min_open') else '<='} {name}"
        upper = f" {'<' if declared.get('max_open') else '<='} {high:g}" if high < math.inf else ""
        raise InputError(f"{name} is {value:g}, expected {lower}{upper}")


def named_once(option: str, pairs: Iterable[tuple[str, T]], advice: str) -> dict[str, T]:
    """Return the pairs of an option by name; an empty name stands for all joints. Raises InputError, with the advice,
    if a name is repeated: of its values only one could be used."""
    result: dict[str, T] = {}
    for name, value in pairs:
        if name in result:
            raise InputError(f"{option}: {repr(name) if name else 'all joints'} given more than once; {advice}")
        result[name] = value
    return result


def shared(options: Options, kind: type[Options]) -> dict[str, Any]:
    """Return the options that ``kind`` has too, as keywords."""
    return {entry.name: getattr(options, entry.name) for entry in fields(kind)}


def explained(kind: type) -> dict[str, str]:
    """Return the help of a class's attributes, from its docstring and those of its bases."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        attributes = (inspect.getdoc(base) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
        texts |= {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(attributes)}
    return texts


def takes(kind: Callable[P, T]) -> Callable[[Callable[[T], R]], Callable[P, R]]:
    """Decorate a function of one ``kind`` object: it takes the constructor's arguments, and its help explains them."""

    signature = inspect.signature(kind)

    def decorated(function: Callable[[T], R]) -> Callable[P, R]:
        @wraps(function)
        def called(*arguments: P.args, **keywords: P.kwargs) -> R:
            if unknown := [name for name in keywords if name not in signature.parameters]:
                raise unknown_name("argument", unknown[0], signature.parameters)
            try:
                signature.bind(*arguments, **keywords)
            except TypeError as error:
                raise InputError(f"{function.__name__}: {error}") from None
            return function(kind(*arguments, **keywords))

        arguments = explained(kind).items()  # type: ignore[arg-type]  # it is a class
        lines = (f"    {name}: {text}" for name, text in arguments)
        called.__doc__ = "\n".join([inspect.getdoc(function) or "", "", "Args:", *lines])
        returned = inspect.signature(function).return_annotation
        called.__dict__["__signature__"] = signature.replace(return_annotation=returned)
        return called

    return decorated
