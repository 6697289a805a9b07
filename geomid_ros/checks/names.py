"""Which joints of a robot may have each other's names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations, pairwise

_MOST = 8  # joints of which all pairs are tried; of more, neighbours
_SIDES = {"left": "right", "right": "left", "l": "r", "r": "l"}
_SIDE = re.compile(r"(?<![a-z])(left|right|l|r)(?![a-z])", re.IGNORECASE)


def exchanges_of_names(names: Sequence[str]) -> list[list[tuple[int, int]]]:
    """The exchanges that may well happen: of two joints, and of all of the left side with those of the right.

    Args:
        names: of joints, in the robot's order.

    Returns:
        Of each exchange the pairs of places ``(first, second)`` that change their names.
    """
    places = {name: place for place, name in enumerate(names)}
    mirrored = [(place, places.get(_mirrored(name), place)) for name, place in places.items()]
    sides = [(first, second) for first, second in mirrored if first < second]
    count = len(names)
    pairs = [*combinations(range(count), 2)] if count <= _MOST else [*pairwise(range(count)), *sides]
    return [*([pair] for pair in dict.fromkeys(pairs)), *([sides] if len(sides) > 1 else [])]


def _mirrored(name: str) -> str:
    return _SIDE.sub(lambda found: _SIDES[found.group().lower()], name)
