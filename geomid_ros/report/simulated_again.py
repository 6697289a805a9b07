"""Simulations of held-out data before and after, as the gap's page shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.resimulation.closed_loop import ClosedLoop
from geomid_ros.resimulation.resimulate import Resimulated
from geomid_ros.resimulation.windows import HORIZON
from geomid_ros.session.written_simulation import Simulations
from geomid_ros.types import FloatArray

SENTENCES = {
    "windows": f"Velocities simulated in MuJoCo with the written MJCF. The measured efforts are applied; every "
    f"{HORIZON:g} s the simulation restarts from the measured state.",
    "closed_loop": "Efforts simulated in MuJoCo with the written MJCF: the whole motion under the recorded commands, "
    "with the controller that explains the measured efforts best.",
}
"""How it was simulated, by kind."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedAgain:
    """The robot's simulation before and after, beside what was measured.

    Attributes:
        kind: how it was simulated; ``sentence`` says it in words.
        errors: {before, after}, each by channel in units of the floor.
        joints: names of the columns; their ``units``.
        times: ``(N,)`` [s].
        measured, before, after: ``(N, joints)``, NaN where a new simulation begins.
    """

    kind: Literal["windows", "closed_loop"]
    sentence: str
    errors: Mapping[str, Mapping[str, float]]
    joints: Sequence[str]
    units: Sequence[str]
    times: FloatArray
    measured: FloatArray
    before: FloatArray
    after: FloatArray


def simulated_again(model: MeasurementModel, simulations: Simulations) -> list[SimulatedAgain]:
    """The simulations that there are, in short windows first."""
    windows, loop = simulations.windows, simulations.closed_loop
    return [*([_of_windows(model, windows)] if windows else []), *([_of_loop(model, loop)] if loop else [])]


def _of_windows(model: MeasurementModel, found: Resimulated) -> SimulatedAgain:
    def lines(kind: str) -> FloatArray:
        return np.concatenate([_broken(getattr(trace, kind)) for trace in found.traces])

    return SimulatedAgain(
        kind="windows",
        sentence=SENTENCES["windows"],
        errors={"before": found.before, "after": found.after},
        joints=model.robot.joint_names,
        units=[f"{unit}/s" for unit in position_units(model)],
        times=_in_a_row([_ends_repeated(trace.times) for trace in found.traces]),
        measured=lines("measured"),
        before=lines("before"),
        after=lines("after"),
    )


def _of_loop(model: MeasurementModel, found: ClosedLoop) -> SimulatedAgain:
    def lines(kind: str) -> FloatArray:
        return np.concatenate([_broken(getattr(trace, kind)[None]) for trace in found.traces])

    return SimulatedAgain(
        kind="closed_loop",
        sentence=SENTENCES["closed_loop"],
        errors={"before": found.before, "after": found.after},
        joints=model.robot.joint_names,
        units=[joint.unit for joint in model.robot.joints],
        times=_in_a_row([_ends_repeated(trace.times[None]) for trace in found.traces]),
        measured=lines("effort"),
        before=lines("effort_before"),
        after=lines("effort_after"),
    )


def position_units(model: MeasurementModel) -> list[str]:
    """Units of the joints' positions."""
    return ["m" if joint.unit == "N" else "rad" for joint in model.robot.joints]


def _broken(windows: FloatArray) -> FloatArray:
    """Windows ``(W, K, J)`` one after the other, with a break behind each, ``(W (K + 1), J)``."""
    joined = np.concatenate([windows, np.full_like(windows[:, -1:], np.nan)], axis=1)
    return joined.reshape(-1, windows.shape[2])


def _ends_repeated(times: FloatArray) -> FloatArray:
    """Times ``(W, K)`` that go with :func:`_broken`: the breaks take none."""
    return np.concatenate([times, times[:, -1:]], axis=1).ravel()


def _in_a_row(times: Sequence[FloatArray]) -> FloatArray:
    """Times of recordings, each after the one before."""
    starts = np.cumsum([0.0, *(part[-1] - part[0] for part in times[:-1])])
    return np.concatenate([part - part[0] + start for part, start in zip(times, starts, strict=True)])
