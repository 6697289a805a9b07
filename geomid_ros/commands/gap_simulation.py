"""Simulations of held-out data from the model files before and after, for the gap's report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.util import find_spec

import numpy as np

from geomid_ros.files.models.gap_model import ModelFiles
from geomid_ros.gap.result import GapResult
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.report.gap_page import SimulatedAgain
from geomid_ros.resimulation.closed_loop import ClosedLoop, closed_loop
from geomid_ros.resimulation.noise import Noise
from geomid_ros.resimulation.resimulate import Resimulated, resimulate
from geomid_ros.resimulation.windows import HORIZON
from geomid_ros.types import FloatArray

NO_MUJOCO = "MuJoCo is not installed (pip install mujoco)"
_SECONDS_OF_WINDOWS = 2.0


def simulate_again(
    model: MeasurementModel,
    result: GapResult,
    before: ModelFiles,
    after: ModelFiles,
    recordings: Sequence[Samples],
    commands: Sequence[Samples],
    cutoff: float,
) -> tuple[list[SimulatedAgain], str]:
    """Held-out ``recordings`` simulated in short windows, and under their ``commands`` if there are any; and why not,
    if not. ``cutoff`` [Hz] is that of the result."""
    if find_spec("mujoco") is None:
        return [], NO_MUJOCO
    noise = Noise.of(result)
    windows = resimulate(model, before, after, recordings, noise)
    simulations, reasons = [], [windows.skipped]
    if not windows.skipped:
        simulations.append(_of_windows(model, windows))
    if commands:
        loop = closed_loop(model, before, after, recordings, commands, noise=noise, cutoff=cutoff)
        reasons.append(loop.skipped and f"in closed loop, {loop.skipped}")
        if not loop.skipped:
            simulations.append(_of_loop(model, loop))
    return simulations, "; ".join(filter(None, reasons))


def _of_windows(model: MeasurementModel, found: Resimulated) -> SimulatedAgain:
    def lines(kind: str) -> FloatArray:
        return np.concatenate([_broken(getattr(trace, kind)) for trace in found.traces])

    return SimulatedAgain(
        kind="windows",
        sentence=f"Velocities in MuJoCo, from the written MJCF: every {HORIZON:g} s from the measured state anew, "
        "under the measured efforts.",
        errors={"before": found.before, "after": found.after},
        joints=model.robot.joint_names,
        units=[f"{unit}/s" for unit in position_units(model)],
        times=_in_a_row([_ends_repeated(trace.times) for trace in found.traces]),
        measured=lines("measured"),
        before=lines("before"),
        after=lines("after"),
        seconds=_SECONDS_OF_WINDOWS,
    )


def _of_loop(model: MeasurementModel, found: ClosedLoop) -> SimulatedAgain:
    def lines(kind: str) -> FloatArray:
        return np.concatenate([_broken(getattr(trace, kind)[None]) for trace in found.traces])

    return SimulatedAgain(
        kind="closed_loop",
        sentence="Efforts in MuJoCo, from the written MJCF: the whole motion under the recorded commands, with the "
        "controller that explains the measured efforts best.",
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
    return np.concatenate(list(_shifted(times)))


def _shifted(times: Sequence[FloatArray]) -> Iterator[FloatArray]:
    start = 0.0
    for part in times:
        yield part - part[0] + start
        start += float(part[-1] - part[0])
