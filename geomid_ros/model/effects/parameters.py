"""The parameters of an effect: how they are called, their units and ranges, and what is known of one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

COM_ENTRIES = ("com_x", "com_y", "com_z")
EFFORT = ("N m", "N")

Found: TypeAlias = tuple[float, float]
"""A parameter's value and standard deviation."""
Values: TypeAlias = Mapping[str, float]
"""Values of an effect's parameters by name."""


@dataclass(frozen=True)
class Quantity:
    """A parameter's value with its standard deviation, NaN where it is not known, and unit."""

    value: float
    std: float = math.nan
    unit: str = ""

    def scaled(self, factor: float) -> Quantity:
        """The quantity times an exact ``factor``."""
        return Quantity(factor * self.value, abs(factor) * self.std, self.unit)

    def plus(self, other: Quantity) -> Quantity:
        """Sum of two independent estimates; where the uncertainty of one is not known, the other's."""
        known = [quantity.std for quantity in (self, other) if math.isfinite(quantity.std)]
        return Quantity(self.value + other.value, math.hypot(*known) if known else math.nan, other.unit)


Quantities: TypeAlias = Mapping[str, Quantity]
"""An effect's parameters by name."""
ByEffect: TypeAlias = Mapping[str, Quantities]
"""The parameters of several effects at one place, by the effects' names."""


def quantities(forms: Iterable[ParameterForm], found: Iterable[Found], *, sliding: bool = False) -> dict[str, Quantity]:
    """The first of some parameters by name, from their values and standard deviations; ``sliding``: at a prismatic
    joint."""
    return {
        form.name: Quantity(float(value), float(std), form.units[sliding])
        for form, (value, std) in zip(forms, found, strict=False)
    }


@dataclass(frozen=True)
class KnownEffect:
    """An effect with the values of its parameters: what was found, or what is read of it from a file.

    Attributes:
        effect: its name.
        joint: the joint it acts at, two as ``FIRST+SECOND``, the one that moves the link of a payload, or the topic of
            a wrench sensor; empty for the whole robot.
        link: the link that carries a payload, else empty.
        parameters: their values with standard deviations and units, by name.
    """

    effect: str
    joint: str = ""
    link: str = ""
    parameters: Quantities = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterForm:
    """What a parameter is, apart from its value.

    Attributes:
        name: its name in files and tables.
        units: at a revolute and at a prismatic joint.
        above, below: its range, ends excluded.
        optional: whether files may leave it out; it is zero then.
        urdf, mjcf: where these files say it, too, as ``ELEMENT/ATTRIBUTE``; empty where they cannot. What stands at
            ``dynamics`` of a URDF's joint, or at the ``joint`` of an MJCF, is added to the attribute's value.
        drake, gazebo: where these read it in a URDF.
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

    def said_by(self, files: Iterable[str]) -> bool:
        """Whether one of ``files`` says it: a name of these attributes, or an element there, ``mjcf/joint``."""
        return bool(self.place_in(files))

    def place_in(self, files: Iterable[str]) -> str:
        """Where one of these files says it, as ``ELEMENT/ATTRIBUTE``; empty where none does."""
        said = {name: getattr(self, name) for name in ("urdf", "mjcf", "drake", "gazebo") if getattr(self, name)}
        places = [at for own in files for name, at in said.items() if f"{name}/{at}/".startswith(f"{own}/")]
        return places[0] if places else ""
