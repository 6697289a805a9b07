"""Numbers and words in the form that all the software reads."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from geomid_ros.exports.inertial import Export
from geomid_ros.types import FloatArray

_DIGITS = 9
INERTIA_KEYS = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
"""Names of an inertia's entries in the order of :class:`~geomid_ros.exports.inertial.Inertial`."""


def number(value: float) -> str:
    """A number without an exponent: YAML 1.1 takes ``1e-05`` for text, and URScript does not document exponents."""
    return str(np.format_float_positional(value, precision=_DIGITS, fractional=False, trim="0"))


def numbers(values: Iterable[float], between: str = ", ") -> str:
    """Several numbers."""
    return between.join(number(value) for value in values)


def inertia_entries(export: Export) -> dict[str, float]:
    """The entries of an inertia by name."""
    return dict(zip(INERTIA_KEYS, map(float, export.inertial.quantities[4:]), strict=True))


def comments(export: Export) -> list[str]:
    """The title, each number with its standard deviation, and the notes, a line each."""
    quantities, std = export.inertial.quantities, export.inertial.std
    return [
        export.title,
        f"  mass [kg]              {_sure(quantities[:1], std[:1])}",
        f"  centre of mass [m]     {_sure(quantities[1:4], std[1:4])}",
        f"  Ixx Iyy Izz [kg m^2]   {_sure(quantities[[4, 6, 9]], std[[4, 6, 9]])}",
        f"  Ixy Ixz Iyz [kg m^2]   {_sure(quantities[[5, 7, 8]], std[[5, 7, 8]])}",
        *(["  how sure these numbers are is not known"] if not export.inertial.has_std else []),
        *(f"  {note}" for note in export.notes),
    ]


def _sure(values: FloatArray, std: FloatArray) -> str:
    pairs = zip(values, std, strict=True)
    return ", ".join(f"{value:.5g} ± {own:.2g}" if np.isfinite(own) else f"{value:.5g}" for value, own in pairs)


def commented(lines: Sequence[str], mark: str) -> str:
    """Lines as comments that begin with ``mark``."""
    return "".join(f"{mark} {_printable(line)}\n" for line in lines)


def xml_comment(lines: Sequence[str]) -> str:
    """Lines as one comment of XML, in which two hyphens cannot stand side by side."""
    return "<!-- " + "\n     ".join(re.sub("-(?=-)", "- ", _printable(line)) for line in lines) + " -->\n"


def _printable(line: str) -> str:
    """A line that stays one: a name from a file must not end the comment that it stands in."""
    return "".join(character if character.isprintable() else " " for character in line)
