"""Which effects to hide in a recording, as a user writes it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from geomid_ros.errors import InputError


@dataclass(frozen=True)
class Hidden:
    """A request: ``effect`` by name, at ``place``, with ``parameters``; the seed decides what is left out.

    ``place`` is a joint; for a payload also the link that carries it. ``value`` is that of the first parameter.
    """

    effect: str
    place: str = ""
    value: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


NOTHING = "nothing"
"""What hides no effect at all."""


def parse_hidden(text: str) -> Hidden:
    """``EFFECT[:PLACE][=VALUE]``, where VALUE is a number or ``name=number,name=number,...``."""
    where, _, value = text.partition("=")
    effect, _, place = where.partition(":")
    if not value:
        return Hidden(effect, place)
    if "=" not in value:
        return Hidden(effect, place, _number(value, text))
    pairs = [part.partition("=") for part in value.split(",")]
    return Hidden(effect, place, None, {name.strip(): _number(number, text) for name, _, number in pairs})


def _number(word: str, text: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"'{text}' has '{word}' where a number has to stand; write EFFECT:JOINT=1.5 or EFFECT:JOINT=name=1,name=2"
        )
    return value
