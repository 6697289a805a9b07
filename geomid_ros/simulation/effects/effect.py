"""One physical effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class TrueEffect:
    """The effect called ``name`` at ``joint``, with the values of its ``parameters``.

    ``joint`` is empty for the whole robot, and the topic for a wrench sensor. ``link`` carries a payload; ``other`` is
    the second joint of an effect that depends on two. ``sizes.py`` describes the parameters and their units.
    """

    name: str
    joint: str
    parameters: Mapping[str, float]
    link: str = ""
    other: str = ""
