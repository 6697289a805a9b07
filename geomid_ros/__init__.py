"""Geometric identification of link inertias, online and from rosbags.

The public names are here; everything else may change::

    import geomid_ros

    found = geomid_ros.identify("my_bag", "robot.urdf")
    found.links, found.effects, found.rms
    found.save("geomid_out")  # see report.html

    gap = geomid_ros.find_gap("my_bag", "robot.urdf")
    gap.verdict, gap.findings
    gap.report("report.html")

A name is loaded on first use, so the import is fast.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geomid_ros.api.compare import Comparison, compare
    from geomid_ros.api.excite import MotionDesign, excite
    from geomid_ros.api.export import Exported, SampledRobots, export, sample
    from geomid_ros.api.feedforward import Feedforward, feedforward
    from geomid_ros.api.fleet import FleetIdentification, identify_fleet
    from geomid_ros.api.gap import Gap, find_gap
    from geomid_ros.api.identify import Identification, identify
    from geomid_ros.api.payload import weigh_payload
    from geomid_ros.api.rebuild import rebuild_report
    from geomid_ros.api.verify import Verification, verify
    from geomid_ros.errors import GeomidError, InputError
    from geomid_ros.estimation.paper_estimator import RowsSolution, solve_rows
    from geomid_ros.exports.payload import Payload
    from geomid_ros.model.effects import Effect, JointEffect, JointMotion, ParameterForm, register
    from geomid_ros.session.options import RecordingOptions, RobotOptions

# Matrices are small, so threads of the linear algebra library would only wait for each other and block the cores of a
# busy machine. numpy reads this once, on import.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"

__all__ = [
    "Comparison",
    "Effect",
    "Exported",
    "Feedforward",
    "FleetIdentification",
    "Gap",
    "GeomidError",
    "Identification",
    "InputError",
    "JointEffect",
    "JointMotion",
    "MotionDesign",
    "ParameterForm",
    "Payload",
    "RecordingOptions",
    "RobotOptions",
    "RowsSolution",
    "SampledRobots",
    "Verification",
    "compare",
    "excite",
    "export",
    "feedforward",
    "find_gap",
    "identify",
    "identify_fleet",
    "rebuild_report",
    "register",
    "sample",
    "solve_rows",
    "verify",
    "weigh_payload",
]

_NAMES = {
    "geomid_ros.api.compare": ("Comparison", "compare"),
    "geomid_ros.api.excite": ("MotionDesign", "excite"),
    "geomid_ros.api.export": ("Exported", "SampledRobots", "export", "sample"),
    "geomid_ros.api.feedforward": ("Feedforward", "feedforward"),
    "geomid_ros.api.fleet": ("FleetIdentification", "identify_fleet"),
    "geomid_ros.api.gap": ("Gap", "find_gap"),
    "geomid_ros.api.identify": ("Identification", "identify"),
    "geomid_ros.api.payload": ("weigh_payload",),
    "geomid_ros.api.rebuild": ("rebuild_report",),
    "geomid_ros.api.verify": ("Verification", "verify"),
    "geomid_ros.errors": ("GeomidError", "InputError"),
    "geomid_ros.estimation.paper_estimator": ("RowsSolution", "solve_rows"),
    "geomid_ros.model.effects": ("Effect", "JointEffect", "JointMotion", "ParameterForm", "register"),
    "geomid_ros.exports.payload": ("Payload",),
    "geomid_ros.session.options": ("RecordingOptions", "RobotOptions"),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
