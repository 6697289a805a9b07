"""Geometric identification of link inertias, online and from rosbags.

What a notebook or a script needs is here; everything else may change::

    import geomid_ros

    found = geomid_ros.identify("my_bag", "robot.urdf")
    found.links, found.effects, found.rms
    found.save("geomid_out")

    gap = geomid_ros.find_gap("my_bag", "robot.urdf")
    gap.verdict, gap.findings
    gap.report("report.html")

A name is loaded when it is first used, with all that it needs: the import itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geomid_ros.api.gap import Gap, find_gap
    from geomid_ros.api.identify import Identification, identify
    from geomid_ros.errors import GeomidError, InputError
    from geomid_ros.estimation.rows import RowsSolution, solve_rows
    from geomid_ros.model.effects.effect import Effect, JointMotion
    from geomid_ros.model.effects.parameters import ParameterForm

__version__ = "0.1.0"

__all__ = [
    "Effect",
    "Gap",
    "GeomidError",
    "Identification",
    "InputError",
    "JointMotion",
    "ParameterForm",
    "RowsSolution",
    "find_gap",
    "identify",
    "solve_rows",
]

_HOMES = {
    "Effect": "geomid_ros.model.effects.effect",
    "Gap": "geomid_ros.api.gap",
    "GeomidError": "geomid_ros.errors",
    "Identification": "geomid_ros.api.identify",
    "InputError": "geomid_ros.errors",
    "JointMotion": "geomid_ros.model.effects.effect",
    "ParameterForm": "geomid_ros.model.effects.parameters",
    "RowsSolution": "geomid_ros.estimation.rows",
    "find_gap": "geomid_ros.api.gap",
    "identify": "geomid_ros.api.identify",
    "solve_rows": "geomid_ros.estimation.rows",
}


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
