"""Robots simulated in MuJoCo that record rosbags: planted truth for demonstrations and tests.

The bag holds only what a real robot would publish; the truth goes into a separate file. Nothing here shares code with
the estimator. MuJoCo is imported when a simulation starts, and the recording code when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from geomid_ros.simulation.effects.effect_sizes import SIZES
from geomid_ros.simulation.options import LINK_MASS, MOTIONS, NOTHING, Hidden, SimulationOptions, parse_hidden
from geomid_ros.simulation.robots import WRIST_FRAME, robot_names

if TYPE_CHECKING:
    from geomid_ros.simulation.recording import SimulationResult, simulate

EFFECTS = tuple(SIZES)
"""Names of the effects that can be hidden."""

__all__ = [
    "EFFECTS",
    "LINK_MASS",
    "MOTIONS",
    "NOTHING",
    "WRIST_FRAME",
    "Hidden",
    "SimulationOptions",
    "SimulationResult",
    "parse_hidden",
    "robot_names",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Load ``simulate`` and ``SimulationResult`` on first use."""
    if name not in ("SimulationResult", "simulate"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("geomid_ros.simulation.recording"), name)
