"""One physical effect, and tables of functions by effects' names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

Parameters: TypeAlias = Mapping[str, float]
_Function = TypeVar("_Function", bound=Callable[..., Any])


def by_name(*functions: _Function) -> dict[str, _Function]:
    """Functions by the effects that they are named after."""
    return {function.__name__.removeprefix("_"): function for function in functions}


@dataclass(frozen=True)
class TrueEffect:
    """The effect called ``name`` at ``joint``, with the values of its ``parameters``.

    ``joint`` is empty for the whole robot, and the topic for a wrench sensor. ``link`` carries a payload; ``other`` is
    the second joint of an effect that depends on two. ``sizes.py`` describes the parameters and their units.
    """

    name: str
    joint: str
    parameters: Parameters
    link: str = ""
    other: str = ""
