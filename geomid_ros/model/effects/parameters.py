"""Parameters of an effect: names, units and ranges, and values with standard deviations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

COM_ENTRIES = ("com_x", "com_y", "com_z")
EFFORT = ("N m", "N")

Found: TypeAlias = tuple[float, float]
"""A parameter's value and standard deviation."""
Values: TypeAlias = Mapping[str, float]
"""Values of an effect's parameters by name."""


@dataclass(frozen=True)
class Quantity:
    """A parameter's value with its standard deviation (NaN if unknown) and unit."""

    value: float
    std: float = math.nan
    unit: str = ""

    def scaled(self, factor: float) -> Quantity:
        """Return the quantity times an exact ``factor``."""
        return Quantity(factor * self.value, abs(factor) * self.std, self.unit)

    def plus(self, other: Quantity) -> Quantity:
        """Add an independent estimate. If the std of one is unknown, the sum has the std of the other."""
        stds = [quantity.std for quantity in (self, other) if math.isfinite(quantity.std)]
        return Quantity(self.value + other.value, math.hypot(*stds) if stds else math.nan, other.unit)


Quantities: TypeAlias = Mapping[str, Quantity]
"""An effect's parameters by name."""
ByEffect: TypeAlias = Mapping[str, Quantities]
"""The parameters of several effects at one place, by the effects' names."""


def quantities(forms: Iterable[ParameterForm], found: Iterable[Found], *, sliding: bool = False) -> dict[str, Quantity]:
    """Return the first parameters by name, from their values and standard deviations; ``sliding``: True at a prismatic
    joint."""
    return {
        form.name: Quantity(float(value), float(std), form.units[sliding])
        for form, (value, std) in zip(forms, found, strict=False)
    }


@dataclass(frozen=True)
class ParameterForm:
    """Declaration of a parameter: everything but its value.

    Attributes:
        name: its name in files and tables.
        units: its units at a revolute and at a prismatic joint.
        above, below: its range, ends excluded.
        optional: True if files may omit it; it is zero then.
        urdf, mjcf: where these files contain it, as ``ELEMENT/ATTRIBUTE``; empty if they cannot. A parameter at
            ``dynamics`` of a URDF's joint, or at the ``joint`` of an MJCF, is added to the attribute's value.
        drake, gazebo: where Drake and Gazebo read it in a URDF.
    """

    name: str
    units: tuple[str, str]
    above: float = -math.inf
    below: float = math.inf
    optional: bool = False
    urdf: str = ""
    mjcf: str = ""
    drake: str = ""
    gazebo: str = ""

    def slides_by(self, unit: str) -> bool:
        """True if a value in this ``unit`` is one at a prismatic joint."""
        return unit == self.units[1] != self.units[0]

    def said_by(self, files: Iterable[str]) -> bool:
        """True if one of ``files`` can contain it: ``urdf``, ``mjcf``, ..., or an element in one, ``mjcf/joint``."""
        return bool(self.place_in(files))

    def place_in(self, files: Iterable[str]) -> str:
        """Return where one of ``files`` contains it, as ``ELEMENT/ATTRIBUTE``; empty if none does."""
        locations = {name: getattr(self, name) for name in ("urdf", "mjcf", "drake", "gazebo") if getattr(self, name)}
        places = [at for file in files for name, at in locations.items() if f"{name}/{at}/".startswith(f"{file}/")]
        return places[0] if places else ""
