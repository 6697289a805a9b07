"""Options declared once: the fields of a frozen dataclass are a function's keywords and a command's options, and its
docstring is the help of both."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import wraps
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
            is excluded; ``sets``: the node's parameter that it sets. For the command line: ``flag``, if it has another
            name there; ``earlier``: its flag in the last release; ``metavar``; ``or_none``, if a list may be empty.
    """
    return field(default=default, metadata=declared)


@dataclass(frozen=True)
class Options:
    """Options that are checked on construction. Raises InputError, with the option's name, for a number out of its
    range or a text that is not one of its choices."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if value is not None and "choices" in entry.metadata and value not in entry.metadata["choices"]:
                raise unknown_name(entry.name, value, entry.metadata["choices"])
            if value is not None and "min" in entry.metadata:
                _check_range(entry.name, value, entry.metadata)


def _check_range(name: str, value: float, declared: Mapping[str, Any]) -> None:
    """Refuse a number out of its range (InputError)."""
    low, high = declared["min"], declared.get("max", math.inf)
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

    def decorated(function: Callable[[T], R]) -> Callable[P, R]:
        @wraps(function)
        def called(*arguments: P.args, **keywords: P.kwargs) -> R:
            return function(kind(*arguments, **keywords))

        arguments = explained(kind).items()  # type: ignore[arg-type]  # it is a class
        lines = (f"    {name}: {text}" for name, text in arguments)
        called.__doc__ = "\n".join([inspect.getdoc(function) or "", "", "Args:", *lines])
        returned = inspect.signature(function).return_annotation
        called.__dict__["__signature__"] = inspect.signature(kind).replace(return_annotation=returned)
        return called

    return decorated
