"""Resimulation of recordings in short windows, from the written files before the findings and after."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal, TypeAlias

import numpy as np

from geomid_ros.files.models.written_model import ModelFiles
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.workflow import CUTOFF as GAP_CUTOFF
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import Motion
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.written_robot import FLOATING_BASE_REASON, WrittenRobot, loaded_robots
from geomid_ros.signals.kernels import filtered
from geomid_ros.types import BoolArray, FloatArray, IntArray

# Long enough for the noise of efforts to average out, short enough for errors not to grow by themselves: in this time
# an error of 1 grows to 1.1 in an arm that falls like a pendulum of half a metre.
HORIZON = 0.1  # [s]
_MOST_STEPS = 30_000  # of all windows of a segment together; beyond, only evenly spaced windows are simulated


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one segment, each of ``intervals`` sampling periods; ``starts (W,)`` index its samples."""

    segment: UniformSegment
    starts: IntArray
    intervals: int

    @staticmethod
    def of(segment: UniformSegment, step: float) -> Windows:
        """Choose the windows to simulate in steps of ``step`` [s]."""
        intervals = max(1, round(HORIZON / segment.period))
        starts = np.arange(0, len(segment.times) - intervals, intervals)
        affordable = max(1, int(_MOST_STEPS * step / (intervals * segment.period)))
        return Windows(segment, starts[:: max(1, -(-len(starts) // affordable))], intervals)

    @property
    def samples(self) -> IntArray:
        """Indices of each window's samples after its start ``(W, intervals)``."""
        return self.starts[:, None] + 1 + np.arange(self.intervals)


@dataclass(frozen=True, eq=False)
class WindowStates:
    """Result of simulated windows: the joints' ``position, velocity (W, intervals, J)`` at the samples, and the mean
    sensor readings over each window, ``mean_wrenches (W, values)``."""

    position: FloatArray
    velocity: FloatArray
    mean_wrenches: FloatArray


class WindowSimulation:
    """Simulation of windows on one robot; :meth:`run` accepts a disturbance of the efforts."""

    def __init__(self, robot: WrittenRobot, windows: Windows) -> None:
        self._robot = robot
        self.windows = windows
        period, times = windows.segment.period, windows.segment.times
        # Integration steps between two samples, none longer than the robot's step.
        self._substeps = max(1, int(np.ceil(period / robot.step - 1e-9)))
        self.step = period / self._substeps
        middles = period * (np.arange(windows.intervals * self._substeps) + 0.5) / self._substeps
        self.instants = times[windows.starts, None] + middles
        """Middles of the integration steps of each window ``(W, steps)`` [s]."""

    @cached_property
    def driving_efforts(self) -> FloatArray:
        """Measured efforts, converted to drive the joints in MuJoCo, in the middle of each step ``(W, steps, J)``."""
        robot, samples, times = self._robot, self.windows.segment.samples, self.windows.segment.times
        true_effort = robot.true_effort(interpolated(times, samples.effort, self.instants + robot.delay))
        return robot.driving_effort(true_effort, motion_at(self.windows.segment, self.instants))

    @cached_property
    def _states(self) -> tuple[FloatArray, FloatArray]:
        """MuJoCo's positions and velocities at the windows' starts, each ``(W, nv)``."""
        robot, stretch, starts = self._robot, self.windows.segment, self.windows.starts
        position, velocity = np.zeros((2, len(starts), robot.model.nv))
        samples = stretch.samples.select(starts)
        position[:, robot.dofs], velocity[:, robot.dofs] = samples.position, samples.velocity
        if robot.gears:
            gears = list(robot.gears)
            deflection, rate, _ = filtered(robot.gear_deflections(stretch.samples), GAP_CUTOFF, stretch.period)
            position[:, gears], velocity[:, gears] = deflection[starts], rate[starts]
        return position, velocity

    def run(self, disturbance: FloatArray | float = 0.0, driving_efforts: FloatArray | None = None) -> WindowStates:
        """Simulate under the measured efforts, or ``driving_efforts (W, steps, J)``, plus a disturbance of that
        shape."""
        efforts = (self.driving_efforts if driving_efforts is None else driving_efforts) + disturbance
        position, velocity, sensed = self._robot.rollout(*self._states, efforts, self.step)
        at_samples = slice(self._substeps - 1, None, self._substeps)
        return WindowStates(position[:, at_samples], velocity[:, at_samples], sensed.mean(axis=1))


@dataclass(frozen=True, eq=False)
class UniformSegment:
    """Samples at equal distances of ``period`` [s]; ``times (N,)`` [s] count from the first of them."""

    samples: Samples
    times: FloatArray
    period: float


def uniform_segments(recordings: Iterable[Samples]) -> list[UniformSegment]:
    """Parts of recordings without a pause that are at least as long as two windows."""
    result: list[UniformSegment] = []
    for samples in recordings:
        period = 1e-9 * float(np.median(np.diff(samples.stamps))) if len(samples) > 1 else 0.0
        result += [
            UniformSegment(part, 1e-9 * (part.stamps - part.stamps[0]), period)
            for part in samples.segments()
            if len(part) * period >= 2.0 * HORIZON
        ]
    return result


def interpolated(times: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate ``values (N, K)`` at ``times (N,)`` to the times ``at (...)`` by cubic splines, ``(..., K)``.

    Columns that are not measured throughout are zero.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 takes long to load

    spline = CubicSpline(times, np.where(np.all(np.isfinite(values), axis=0), values, 0.0))
    return np.asarray(spline(at))


def motion_at(segment: UniformSegment, instants: FloatArray) -> Motion:
    """Measured motion at ``instants (...)`` [s], ``(..., J)`` each."""
    samples = segment.samples
    parts = (samples.position, samples.velocity, samples.acceleration)
    return Motion(np.array([interpolated(segment.times, part, instants) for part in parts]))


_DRAWS = 4  # noise realisations per window


class WindowErrors:
    """Errors of windows: the joints' velocities at the windows' ends, then the means of the wrench channels.

    ``names`` are the channels of ``model``; arrays ``(W, channels)`` follow them.
    """

    def __init__(self, model: MeasurementModel, noise: ResidualNoise) -> None:
        self.names = [channel.name for channel in model.channels]
        self._joints = len(model.robot.joints)
        self._sensors = {sensor: model.sensors.index(sensor) for sensor in model.mounted}
        self._noise = noise.only(self.names)

    def measured_wrenches(self, parts: Sequence[UniformSegment]) -> BoolArray:
        """True for each wrench channel that is measured throughout."""
        columns = [
            np.all([np.all(np.isfinite(self._measured(part, sensor)), axis=0) for part in parts], axis=0)
            for sensor in self._sensors
        ]
        return np.concatenate([np.zeros(0, dtype=bool), *columns])

    def _measured(self, stretch: UniformSegment, sensor: WrenchSensor) -> FloatArray:
        measured = stretch.samples.wrenches[:, self._sensors[sensor], sensor.axis_indices]
        return np.asarray(sensor.sign * measured)

    def of(self, windows: Windows, instants: FloatArray, robot: WrittenRobot, simulated: WindowStates) -> FloatArray:
        """Measured minus simulated quantities ``(W, channels)``."""
        velocity = windows.segment.samples.velocity[windows.samples[:, -1]] - simulated.velocity[:, -1]
        motion = Motion(motion_at(windows.segment, instants).states.mean(axis=2))
        wrenches = [
            interpolated(windows.segment.times, self._measured(windows.segment, sensor), instants).mean(axis=1)
            - robot.wrench(simulated.mean_wrenches, sensor)[:, sensor.axis_indices]
            - robot.wrench_error(motion, sensor)
            for sensor in self._sensors
        ]
        return np.hstack([velocity, *wrenches])

    def of_noise(self, simulation: WindowSimulation, robot: WrittenRobot, undisturbed: WindowStates) -> FloatArray:
        """Changes due to noise in the efforts and wrenches ``(draws W, channels)``."""
        random = np.random.default_rng(0)
        changes: list[FloatArray] = []
        for _ in range(_DRAWS):
            noise = self._noise.at(simulation.instants, random.uniform(0.0, self._noise.duration))
            disturbed = simulation.run(noise[..., : self._joints] / robot.gain)
            velocity = disturbed.velocity[:, -1] - undisturbed.velocity[:, -1]
            change = disturbed.mean_wrenches - undisturbed.mean_wrenches
            wrenches = [robot.wrench(change, sensor)[:, sensor.axis_indices] for sensor in self._sensors]
            changes.append(np.hstack([velocity, *wrenches]))
            changes[-1][:, self._joints :] -= noise[..., self._joints :].mean(axis=1)
        return np.concatenate(changes)


def root_mean_square(parts: Sequence[FloatArray]) -> FloatArray:
    """RMS of each column ``(K,)`` of all parts ``(N, K)``; infinite where a simulation diverged."""
    values = np.concatenate(parts)
    return np.asarray(np.sqrt(np.mean(np.where(np.isfinite(values), values, np.inf) ** 2, axis=0)))


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Example of the noise in every channel: ``values (M, channels)`` [N m, N] every ``period`` [s], NaN where a
    channel is not measured."""

    channels: tuple[str, ...]
    period: float
    values: FloatArray

    @staticmethod
    def of(result: GapResult) -> ResidualNoise:
        """Scale the final model's remainder on held-out data to the noise floor. The noise then has the floor's size,
        and the colour and the correlation between channels of the remainder."""
        remainder = result.trace.measured - result.trace.after
        counts = np.count_nonzero(np.isfinite(remainder), axis=0)
        size = np.sqrt(np.nansum(remainder**2, axis=0) / np.maximum(counts, 1))
        scale = np.divide(result.floor, size, out=np.full(len(size), np.nan), where=size > 0.0)
        period = 1e-9 * float(np.median(np.diff(result.trace.stamps)))
        return ResidualNoise(result.channels, period, scale * remainder)

    @property
    def duration(self) -> float:
        """Length of the example [s]."""
        return len(self.values) * self.period

    def at(self, times: FloatArray, shift: float) -> FloatArray:
        """Noise ``(..., channels)`` at ``times (...)`` [s], begun ``shift`` [s] later and repeated periodically."""
        index = (np.asarray(times) + shift) / self.period
        first = np.floor(index).astype(np.int64)
        fraction = (index - first)[..., None]
        count = len(self.values)
        return (1.0 - fraction) * self.values[first % count] + fraction * self.values[(first + 1) % count]

    def only(self, names: Sequence[str]) -> ResidualNoise:
        """Noise of these channels; zero for unknown channels."""
        zeros = np.zeros(len(self.values))
        columns = [self.values[:, self.channels.index(name)] if name in self.channels else zeros for name in names]
        return ResidualNoise(tuple(names), self.period, np.nan_to_num(np.stack(columns, axis=1)))


CUTOFF = 32.0
"""Low-pass [Hz] of samples to simulate from, where the recording's rate allows it. Dry friction jumps when a joint
reverses, and a measured effort that jumps more slowly causes errors of the simulation."""

_STILL = 1e-3  # [rad, m] a joint that moves less is constrained by forces that are not measured


Kind: TypeAlias = Literal["windows", "closed_loop"]


class NotSimulatedError(Exception):
    """A recording cannot be simulated, for the reason in the message."""


@dataclass(frozen=True, eq=False)
class SimulatedEfforts:
    """Joint efforts in one segment, in closed loop: ``times (N,)`` [s], the ``measured`` ones, and the simulated ones
    ``before`` and ``after`` the findings, each ``(N, J)``."""

    times: FloatArray
    measured: FloatArray
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Resimulated:
    """Errors of a simulation, in short windows or in closed loop, before the findings and after.

    Attributes:
        kind: Short windows or closed loop.
        before, after: RMS error by joint (velocity at the window's end, or effort in closed loop) or wrench channel
            (mean), in units of the errors that noise alone causes; without channels that cannot be evaluated.
        efforts: Efforts of each segment in closed loop; empty if the result is read from a file.
    """

    kind: Kind
    before: Mapping[str, float]
    after: Mapping[str, float]
    efforts: Sequence[SimulatedEfforts] = ()

    @property
    def errors(self) -> dict[str, Mapping[str, float]]:
        """Errors by stage: "before" and "after" the findings."""
        return {"before": self.before, "after": self.after}


def resimulate(
    model: MeasurementModel, before: ModelFiles, after: ModelFiles, recordings: Sequence[Samples], noise: ResidualNoise
) -> Resimulated:
    """Simulate ``recordings`` in windows of :data:`HORIZON`.

    Each starts from the measured position and velocity and runs under the measured efforts, corrected by the sidecar's
    sensor effects. A joint whose effort is not measured, or that does not move, follows its measured motion and is not
    evaluated. The errors' unit is the RMS of the change that ``noise`` causes when it is added to the efforts with a
    time shift: a perfect model has about 1 everywhere. Samples filtered at :data:`CUTOFF` are best.

    Raises:
        InputError: The files cannot be read.
        NotSimulatedError: This robot or recording cannot be simulated so.
    """
    if model.robot.floating_base:
        raise NotSimulatedError(FLOATING_BASE_REASON)
    if model.external:
        raise NotSimulatedError("external loads act on the robot, which the written models do not contain")
    parts = uniform_segments(recordings)
    if not parts:
        raise NotSimulatedError("the recording is too short")
    efforts, evaluated = np.concatenate([part.samples.effort for part in parts]), _evaluated_joints(parts)
    if not np.any(evaluated):
        raise NotSimulatedError("no joint moves and has a measured effort")
    robots = loaded_robots((before, after), model.robot.joint_names, efforts)
    for robot in robots:
        robot.prescribe(~evaluated)
    errors = WindowErrors(model, noise)
    of_before, of_after, of_noise = zip(*(_errors(part, errors, *robots) for part in parts), strict=True)
    floor = root_mean_square(of_noise)
    usable = np.concatenate([evaluated, errors.measured_wrenches(parts)]) & (floor > 0.0)
    in_noise = partial(in_units, floor, errors.names, usable)
    return Resimulated(kind="windows", before=in_noise(of_before), after=in_noise(of_after))


def in_units(
    floor: FloatArray, names: Sequence[str], known: BoolArray, errors: Sequence[FloatArray]
) -> dict[str, float]:
    """RMS of ``errors``, each ``(W, channels)``, in units of ``floor (channels,)``, by channel name. Only for channels
    that are ``known (channels,)``."""
    ratios = root_mean_square(errors) / np.where(known, floor, 1.0)
    return {name: ratio for name, ratio, is_known in zip(names, ratios.tolist(), known, strict=True) if is_known}


def _errors(
    stretch: UniformSegment, errors: WindowErrors, before: WrittenRobot, after: WrittenRobot
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the errors of a segment's windows with the robots before and after the findings, ``(W, channels)`` each,
    and the changes due to noise ``(draws W, channels)``."""
    windows = Windows.of(stretch, min(before.step, after.step))
    simulation_before, simulation_after = WindowSimulation(before, windows), WindowSimulation(after, windows)
    run_after = simulation_after.run()
    return (
        errors.of(windows, simulation_before.instants, before, simulation_before.run()),
        errors.of(windows, simulation_after.instants, after, run_after),
        errors.of_noise(simulation_after, after, run_after),
    )


def _evaluated_joints(parts: Sequence[UniformSegment]) -> BoolArray:
    """True for each joint that moves and has a measured effort ``(J,)``: its motion can be simulated."""
    measured = np.all([np.all(np.isfinite(part.samples.effort), axis=0) for part in parts], axis=0)
    moves = np.max([np.ptp(part.samples.position, axis=0) for part in parts], axis=0) > _STILL
    return np.asarray(measured & moves)
