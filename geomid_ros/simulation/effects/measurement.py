"""Effects of measurement: what the sensors make of the true efforts and wrench, before noise.

The table is in the order in which they apply: a late signal is offset, then scaled.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from geomid_ros.simulation.effects.physics import Parameters, TrueEffect, by_name
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.types import FloatArray


def _effort_delay(trace: RunTrace, _: int, parameters: Parameters) -> RunTrace:
    seen = trace.time - parameters["delay"]
    columns = [np.interp(seen, trace.fine_time, column) for column in trace.fine_effort.T]
    return replace(trace, effort=np.stack(columns, axis=1))


def _effort_gain(trace: RunTrace, joint: int, parameters: Parameters) -> RunTrace:
    return _with_effort(trace, joint, parameters["gain"] * trace.effort[:, joint])


def _effort_offset(trace: RunTrace, joint: int, parameters: Parameters) -> RunTrace:
    return _with_effort(trace, joint, trace.effort[:, joint] + parameters["offset"])


def _drift(trace: RunTrace, joint: int, parameters: Parameters) -> RunTrace:
    return _with_effort(trace, joint, trace.effort[:, joint] + parameters["rate"] * trace.time)


def _wrench_offset(trace: RunTrace, _: int, parameters: Parameters) -> RunTrace:
    return replace(trace, wrench=trace.wrench + [parameters[name] for name in ("fx", "fy", "fz", "tx", "ty", "tz")])


def _with_effort(trace: RunTrace, joint: int, column: FloatArray) -> RunTrace:
    effort = trace.effort.copy()
    effort[:, joint] = column
    return replace(trace, effort=effort)


MEASURED = by_name(_effort_delay, _effort_offset, _effort_gain, _drift, _wrench_offset)


def sensed(trace: RunTrace, joints: Sequence[str], effects: Iterable[TrueEffect]) -> RunTrace:
    """What sensors without noise show of a true ``trace`` of ``joints``."""
    order = list(MEASURED)
    for effect in sorted((e for e in effects if e.name in MEASURED), key=lambda effect: order.index(effect.name)):
        joint = joints.index(effect.joint) if effect.joint in joints else -1
        trace = MEASURED[effect.name](trace, joint, effect.parameters)
    return trace
