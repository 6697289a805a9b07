"""Options that are declared once: the fields of a frozen dataclass are the keywords of a function and the options of a
command, and its docstring is the help of both."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import wraps
from typing import Any, ParamSpec, TypeAlias, TypeVar

from geomid_ros.errors import InputError, unknown_name

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")

Progress: TypeAlias = Callable[[str, float], None]
"""Called with what is being done and the share of it, 0 to 1, that is done."""
_ATTRIBUTE = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


def silent(stage: str, share: float) -> None:
    """Show no progress."""


def option(default: Any = None, **declared: Any) -> Any:
    """A field that has more than a type and a ``default``.

    Args:
        default: value where nothing is given.
        declared: ``choices`` of a text; ``min`` and ``max`` of a number, with ``min_open`` or ``max_open`` if it is
            none of them; ``sets``, the parameter that it is; and on the command line ``flag``, if it has another name
            there, ``metavar``, and ``or_none``, if a list may be empty.
    """
    return field(default=default, metadata=declared)


@dataclass(frozen=True)
class Options:
    """Options that are checked when they are made. Raises InputError for a number that is out of its range, and for a
    text that is none of its choices; it names the option."""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if value is not None and "choices" in each.metadata and value not in each.metadata["choices"]:
                raise unknown_name(each.name, value, each.metadata["choices"])
            if value is not None and "min" in each.metadata:
                _check_range(each.name, value, each.metadata)


def _check_range(name: str, value: float, declared: Mapping[str, Any]) -> None:
    """Raises InputError for a number that is out of its range."""
    low, high = declared["min"], declared.get("max", math.inf)
    at_an_end = (value == low and declared.get("min_open")) or (value == high and declared.get("max_open"))
    if not low <= value <= high or at_an_end or math.isinf(value):
        lower = f"{low:g} {'<' if declared.get('min_open') else '<='} {name}"
        upper = f" {'<' if declared.get('max_open') else '<='} {high:g}" if high < math.inf else ""
        raise InputError(f"{name} is {value:g}, expected {lower}{upper}")


def shared(options: Options, kind: type[Options]) -> dict[str, Any]:
    """Those of the options that another class has, too, as keywords."""
    return {each.name: getattr(options, each.name) for each in fields(kind)}


def explained(kind: type) -> dict[str, str]:
    """The attributes of a class, as its docstring and those of its bases explain them."""
    texts: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        attributes = (inspect.getdoc(each) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
        texts |= {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(attributes)}
    return texts


def takes(kind: Callable[P, T]) -> Callable[[Callable[[T], R]], Callable[P, R]]:
    """Decorator of a function of one object: it is called with what makes the object, and its help explains that."""

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
