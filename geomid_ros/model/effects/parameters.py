"""The contract of a parameter of an effect."""

from __future__ import annotations

import math
from dataclasses import dataclass

COM_ENTRIES = ("com_x", "com_y", "com_z")
INERTIA_ENTRIES = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
"""In pinocchio's order."""
EFFORT = ("N m", "N")


@dataclass(frozen=True)
class ParameterForm:
    """A parameter: its name, its units at a turning and a sliding joint, its range (ends excluded), whether it may be
    left out.

    ``urdf``, ``mjcf``: where these files say it, too, as ``ELEMENT/ATTRIBUTE``; empty where they cannot. What stands at
    ``dynamics`` of a URDF's joint, or at the ``joint`` of an MJCF, is added to the attribute's value.
    """

    name: str
    units: tuple[str, str]
    above: float = -math.inf
    below: float = math.inf
    optional: bool = False
    urdf: str = ""
    mjcf: str = ""
