"""What was recorded, simulated again from the files that were written: before the findings and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

import numpy as np

from geomid_ros.files.models.written_model import ModelFiles
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.windows import (
    Errors,
    Noise,
    Stretch,
    Windows,
    WindowSimulation,
    root_mean_square,
    stretches,
)
from geomid_ros.resimulation.written_robot import FLOATING, WrittenRobot, loaded_robots
from geomid_ros.types import BoolArray, FloatArray

CUTOFF = 32.0
"""Low-pass [Hz] of samples to simulate from, where the recording's rate allows it: dry friction jumps when a joint
reverses, and a simulation feels every moment by which the measured effort jumps more slowly."""

_STILL = 1e-3  # [rad, m] a joint that moves less is held by forces that are not measured


Kind: TypeAlias = Literal["windows", "closed_loop"]


class NotSimulatedError(Exception):
    """Why a recording cannot be simulated."""


@dataclass(frozen=True, eq=False)
class SimulatedEfforts:
    """Efforts of the joints in one stretch, in closed loop: ``times (N,)`` [s], and what was ``measured`` and comes
    ``before, after`` the findings, each ``(N, J)``."""

    times: FloatArray
    measured: FloatArray
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Resimulated:
    """Errors of a simulation, in short windows or in closed loop, before the findings and after.

    Attributes:
        kind: Which of the two.
        before, after: Root mean square by joint (velocity at the window's end, or effort in closed loop) or wrench
            channel (mean), in units of the errors that noise alone causes; without those that cannot be judged.
        efforts: In closed loop, of each stretch, unless it is read from a file.
    """

    kind: Kind
    before: Mapping[str, float]
    after: Mapping[str, float]
    efforts: Sequence[SimulatedEfforts] = ()

    @property
    def errors(self) -> dict[str, Mapping[str, float]]:
        """{before, after}."""
        return {"before": self.before, "after": self.after}


def resimulate(
    model: MeasurementModel, before: ModelFiles, after: ModelFiles, recordings: Sequence[Samples], noise: Noise
) -> Resimulated:
    """Simulate ``recordings`` in windows of :data:`~geomid_ros.resimulation.windows.HORIZON`.

    Each starts from the measured position and velocity and runs under the measured efforts, corrected by the sidecar's
    effects of their sensors. A joint whose effort is not measured, or that is held, follows its measured motion and is
    not judged. The errors' unit is the root mean square of the change that ``noise`` causes, added to the efforts at
    other times than its own: a perfect model has about 1 everywhere. Samples filtered at :data:`CUTOFF` are best.

    Raises:
        InputError: The files cannot be read.
        NotSimulatedError: This robot or recording cannot be simulated so.
    """
    if reason := _why_not(model, recordings):
        raise NotSimulatedError(reason)
    parts = stretches(recordings)
    efforts, judged = np.concatenate([part.samples.effort for part in parts]), _judged_joints(parts)
    robots = loaded_robots((before, after), model.robot.joint_names, efforts)
    for robot in robots:
        robot.prescribe(~judged)
    errors = Errors(model, noise)
    runs = [_simulated(part, errors, *robots) for part in parts]
    floor = root_mean_square([run.noise for run in runs])
    known = np.concatenate([judged, errors.measured_wrenches(parts)]) & (floor > 0.0)
    in_noise = partial(in_units, floor, errors.names, known)
    of_before, of_after = in_noise([run.before for run in runs]), in_noise([run.after for run in runs])
    return Resimulated(kind="windows", before=of_before, after=of_after)


def in_units(
    floor: FloatArray, names: Sequence[str], known: BoolArray, errors: Sequence[FloatArray]
) -> dict[str, float]:
    """Root mean square of ``errors``, each ``(W, channels)``, in units of ``floor (channels,)`` by the channels' names;
    of those that are ``known (channels,)``."""
    ratios = root_mean_square(errors) / np.where(known, floor, 1.0)
    return {name: ratio for name, ratio, is_known in zip(names, ratios.tolist(), known, strict=True) if is_known}


@dataclass(frozen=True, eq=False)
class _Run:
    """The errors of a stretch's windows, each ``(W, channels)``, and the noise's ``(draws W, channels)``."""

    before: FloatArray
    after: FloatArray
    noise: FloatArray


def _simulated(stretch: Stretch, errors: Errors, before: WrittenRobot, after: WrittenRobot) -> _Run:
    windows = Windows.of(stretch, min(before.step, after.step))
    first, last = WindowSimulation(before, windows), WindowSimulation(after, windows)
    of_last = last.run()
    return _Run(
        errors.of(windows, first.instants, before, first.run()),
        errors.of(windows, last.instants, after, of_last),
        errors.of_noise(last, after, of_last),
    )


def _why_not(model: MeasurementModel, recordings: Sequence[Samples]) -> str:
    if model.robot.floating_base:
        return FLOATING
    if any(sensor.role == "external" for sensor in model.sensors):
        return "external loads act on the robot, which the written models do not contain"
    if not stretches(recordings):
        return "the recording is too short"
    if not np.any(_judged_joints(stretches(recordings))):
        return "no joint moves and has a measured effort"
    return ""


def _judged_joints(parts: Sequence[Stretch]) -> BoolArray:
    """Whether each joint's motion follows from what was measured ``(J,)``: it moves, and its effort is known."""
    measured = np.all([np.all(np.isfinite(part.samples.effort), axis=0) for part in parts], axis=0)
    moves = np.max([np.ptp(part.samples.position, axis=0) for part in parts], axis=0) > _STILL
    return np.asarray(measured & moves)
