"""What a target is."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Protocol


class Target(Protocol):
    """Tries inputs; made with a folder of its own."""

    def __init__(self, folder: Path) -> None:
        """Prepare what all inputs need."""

    def attempt(self, random: Random) -> None:
        """Make one input from random numbers and try it.

        Raises GeomidError for one that is refused, and anything else only for a fault of the program.
        """


class FoundError(Exception):
    """A fault of the program that raised nothing."""


def require(condition: object, what: str) -> None:
    """What must hold of an input. Raises FoundError otherwise."""
    if not condition:
        raise FoundError(what)


def numbers(target: str, index: int) -> Random:
    """The random numbers of input ``index`` of a target."""
    return Random(f"{target} {index}")  # noqa: S311 no secrets
