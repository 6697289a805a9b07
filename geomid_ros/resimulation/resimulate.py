"""Resimulation of recordings from written files: in short windows, before the findings and after; and of whole
recordings from their commands, with a fitted controller."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal, NamedTuple, TypeAlias

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


class WindowSimulation:
    """Simulation of windows of one ``segment`` on one ``robot``; :meth:`run` accepts a disturbance of the efforts."""

    def __init__(self, robot: WrittenRobot, segment: UniformSegment, starts: IntArray, intervals: int) -> None:
        """Prepare windows of ``intervals`` sampling periods each; ``starts (W,)`` index the segment's samples."""
        self.robot, self.segment, self._starts = robot, segment, starts
        self.ends = starts + intervals
        """Indices of the last sample of each window ``(W,)``."""
        # Integration steps between two samples, none longer than the robot's step.
        self._substeps = max(1, int(np.ceil(segment.period / robot.step - 1e-9)))
        self.step = segment.period / self._substeps
        middles = segment.period * (np.arange(intervals * self._substeps) + 0.5) / self._substeps
        self.instants = segment.times[starts, None] + middles
        """Middles of the integration steps of each window ``(W, steps)`` [s]."""

    @cached_property
    def _driving_efforts(self) -> FloatArray:
        """Measured efforts, converted to drive the joints in MuJoCo, in the middle of each step ``(W, steps, J)``."""
        robot, segment = self.robot, self.segment
        measured = interpolated(segment.times, segment.samples.effort, self.instants + robot.delay)
        return robot.driving_effort(robot.true_effort(measured), motion_at(segment, self.instants))

    @cached_property
    def _states(self) -> tuple[FloatArray, FloatArray]:
        """MuJoCo's positions and velocities at the windows' starts, each ``(W, nv)``."""
        robot, segment, starts = self.robot, self.segment, self._starts
        position, velocity = np.zeros((2, len(starts), robot.model.nv))
        samples = segment.samples.select(starts)
        position[:, robot.dofs], velocity[:, robot.dofs] = samples.position, samples.velocity
        if robot.gears:
            gears = list(robot.gears)
            deflection, rate, _ = filtered(robot.gear_deflections(segment.samples), GAP_CUTOFF, segment.period)
            position[:, gears], velocity[:, gears] = deflection[starts], rate[starts]
        return position, velocity

    @cached_property
    def undisturbed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Result of :meth:`run` under the measured efforts."""
        return self.run()

    def run(
        self, disturbance: FloatArray | float = 0.0, driving_efforts: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Simulate under the measured efforts, or ``driving_efforts (W, steps, J)``, plus a disturbance of that shape.

        Returns:
            Positions and velocities of the joints at the samples ``(W, intervals, J)``, and the mean sensor readings
            over each window ``(W, values)``.
        """
        efforts = (self._driving_efforts if driving_efforts is None else driving_efforts) + disturbance
        position, velocity, sensed = self.robot.rollout(*self._states, efforts, self.step)
        at_samples = slice(self._substeps - 1, None, self._substeps)
        return position[:, at_samples], velocity[:, at_samples], sensed.mean(axis=1)


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

    def _measured(self, segment: UniformSegment, sensor: WrenchSensor) -> FloatArray:
        measured = segment.samples.wrenches[:, self._sensors[sensor], sensor.axis_indices]
        return np.asarray(sensor.sign * measured)

    def of(self, simulation: WindowSimulation) -> FloatArray:
        """Measured minus simulated quantities ``(W, channels)``."""
        segment, robot, instants = simulation.segment, simulation.robot, simulation.instants
        _, velocity, mean_wrenches = simulation.undisturbed
        motion = Motion(motion_at(segment, instants).states.mean(axis=2))
        wrenches = [
            interpolated(segment.times, self._measured(segment, sensor), instants).mean(axis=1)
            - robot.wrench(mean_wrenches, sensor)[:, sensor.axis_indices]
            - robot.wrench_error(motion, sensor)
            for sensor in self._sensors
        ]
        return np.hstack([segment.samples.velocity[simulation.ends] - velocity[:, -1], *wrenches])

    def of_noise(self, simulation: WindowSimulation) -> FloatArray:
        """Changes due to noise in the efforts and wrenches ``(draws W, channels)``."""
        random, robot = np.random.default_rng(0), simulation.robot
        _, undisturbed, mean_wrenches = simulation.undisturbed
        changes: list[FloatArray] = []
        for _ in range(_DRAWS):
            noise = self._noise.at(simulation.instants, random.uniform(0.0, self._noise.duration))
            _, velocity, disturbed = simulation.run(noise[..., : self._joints] / robot.gain)
            change = disturbed - mean_wrenches
            wrenches = [robot.wrench(change, sensor)[:, sensor.axis_indices] for sensor in self._sensors]
            changes.append(np.hstack([velocity[:, -1] - undisturbed[:, -1], *wrenches]))
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
    efforts = np.concatenate([part.samples.effort for part in parts])
    moves = np.max([np.ptp(part.samples.position, axis=0) for part in parts], axis=0) > _STILL
    evaluated = np.all(np.isfinite(efforts), axis=0) & moves  # the motion of these joints can be simulated
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
    segment: UniformSegment, errors: WindowErrors, before: WrittenRobot, after: WrittenRobot
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the errors of a segment's windows with the robots before and after the findings, ``(W, channels)`` each,
    and the changes due to noise ``(draws W, channels)``."""
    intervals = max(1, round(HORIZON / segment.period))
    starts = np.arange(0, len(segment.times) - intervals, intervals)
    affordable = max(1, int(_MOST_STEPS * min(before.step, after.step) / (intervals * segment.period)))
    chosen = starts[:: max(1, -(-len(starts) // affordable))]
    first, last = (WindowSimulation(robot, segment, chosen, intervals) for robot in (before, after))
    return errors.of(first), errors.of(last), errors.of_noise(last)


_SEPARATIONS = (0.03, 0.05, 0.08)  # [s] lags at which filtered noise is independent, and the motion nearly the same
_EXPLAINED = 0.9  # fraction of an effort's variance that a controller must explain


@dataclass(frozen=True, eq=False)
class Tracking:
    """Position errors of a simulated robot against the measured one, under the recorded commands.

    Attributes:
        rms: RMS of the position difference by joint [rad, m]; without the joints whose efforts do not follow from the
            commands.
        skipped: Reason why there is no result, else empty.
    """

    rms: Mapping[str, float]
    skipped: str = ""

    @property
    def total(self) -> float:
        """RMS over the joints [rad, m]."""
        return float(np.sqrt(np.mean(np.square([*self.rms.values()]))))


@dataclass(frozen=True, eq=False)
class FittedController:
    """Proportional gain, derivative gain and constant effort of each joint ``(J,)``. ``explains_efforts`` is True if
    these explain its measured efforts."""

    stiffness: FloatArray
    damping: FloatArray
    constant: FloatArray
    explains_efforts: BoolArray


class _Commanded(NamedTuple):
    """Segment with its set-points; their efforts are the feed-forward."""

    segment: UniformSegment
    setpoints: Samples


def resimulate_closed_loop(
    model: MeasurementModel,
    before: ModelFiles,
    after: ModelFiles,
    recordings: Sequence[Samples],
    commands: Sequence[Samples],
    *,
    noise: ResidualNoise,
    cutoff: float,
) -> Resimulated:
    """Simulate recordings under their commands.

    The controller is the one that explains the measured efforts best, ``u = feed-forward + k (q_d - q) + d (v_d - v) +
    constant`` at every joint. A joint whose efforts no such controller explains follows its measured motion.

    Args:
        model: Model of the robot.
        before, after: Model files before and after the findings.
        recordings: Measured samples.
        commands: Set-points, with the feed-forward as efforts, on the same grid of stamps, from a pipeline with the
            same settings.
        noise: Example of the sensors' noise.
        cutoff: Errors are evaluated below this frequency [Hz]; the cutoff of ``noise``.

    Returns:
        Errors of the controller's efforts, without the joints whose efforts do not follow from the commands.

    Raises:
        NotSimulatedError: This robot or recording cannot be simulated so.
    """
    parts, robots, controller = _prepared(model, (before, after), recordings, commands)
    joints = model.robot.joint_names
    traces = []
    for part in parts:
        simulated = (_simulated_effort(part, controller, robot) for robot in robots)
        traces.append(SimulatedEfforts(part.segment.times, part.segment.samples.effort, *simulated))
    floor = np.sqrt(np.mean(noise.only(joints).values ** 2, axis=0))
    evaluated = controller.explains_efforts & (floor > 0.0)

    def ratios(kind: str) -> dict[str, float]:
        errors = [trace.measured - getattr(trace, kind) for trace in traces]
        filtered_errors = [filtered(e, cutoff, p.segment.period)[0] for e, p in zip(errors, parts, strict=True)]
        return in_units(floor, joints, evaluated, filtered_errors)

    return Resimulated(kind="closed_loop", before=ratios("before"), after=ratios("after"), efforts=traces)


def tracking(
    model: MeasurementModel, files: ModelFiles, recordings: Sequence[Samples], commands: Sequence[Samples]
) -> Tracking:
    """Simulate recordings under their commands, with the controller that explains the measured efforts best.

    Args:
        model: Model of the robot.
        files: Files of the written model.
        recordings, commands: As for :func:`resimulate_closed_loop`.
    """
    try:
        parts, (robot,), controller = _prepared(model, (files,), recordings, commands)
    except NotSimulatedError as reason:
        return Tracking({}, str(reason))
    errors = [_simulated_motion(part, controller, robot)[0] - part.segment.samples.position for part in parts]
    rms = root_mean_square(errors)
    pairs = zip(model.robot.joint_names, rms.tolist(), controller.explains_efforts, strict=True)
    return Tracking({name: value for name, value, explained in pairs if explained})


def _prepared(
    model: MeasurementModel, files: Sequence[ModelFiles], recordings: Sequence[Samples], commands: Sequence[Samples]
) -> tuple[list[_Commanded], list[WrittenRobot], FittedController]:
    """Segments with their commands, the robots of ``files``, and the controller, fitted with the last robot.

    Raises NotSimulatedError.
    """
    if model.robot.floating_base:
        raise NotSimulatedError(FLOATING_BASE_REASON)
    parts = [part for pair in zip(recordings, commands, strict=True) for part in _commanded(*pair)]
    if not parts:
        raise NotSimulatedError("commands and measurements do not overlap in time")
    efforts = np.concatenate([part.segment.samples.effort for part in parts])
    robots = loaded_robots(files, model.robot.joint_names, efforts)
    controller = fitted_controller(parts, robots[-1])
    if not np.any(controller.explains_efforts):
        raise NotSimulatedError(
            "the measured efforts cannot be reproduced from the commands with gains and feed-forward"
        )
    return parts, robots, controller


def _commanded(recording: Samples, commands: Samples) -> list[_Commanded]:
    _, in_recording, in_commands = np.intersect1d(recording.stamps, commands.stamps, return_indices=True)
    measured, commanded = recording.select(in_recording), commands.select(in_commands)
    result = []
    for segment in uniform_segments([measured]):
        first = int(np.searchsorted(commanded.stamps, segment.samples.stamps[0]))
        part = commanded.select(slice(first, first + len(segment.times)))
        result.append(_Commanded(segment, replace(part, effort=np.nan_to_num(part.effort))))
    return result


def fitted_controller(parts: Sequence[_Commanded], robot: WrittenRobot) -> FittedController:
    """Fit the gains that explain the true efforts: the measured ones, corrected by the sidecar of ``robot``.

    A good controller's errors are hardly larger than their measurement noise, so least squares would underestimate the
    gains. Therefore the errors shortly before and after, whose noise is independent, serve as instruments: two-stage
    least squares.
    """
    efforts = [robot.true_effort(_undelayed_efforts(part.segment, robot)) for part in parts]
    joints = len(robot.joints)
    gains, explained = np.zeros((joints, 3)), np.zeros(joints, dtype=bool)
    for joint in np.flatnonzero(np.all([np.all(np.isfinite(effort), axis=0) for effort in efforts], axis=0)):
        columns = [_feedback_columns(part, int(joint)) for part in parts]
        feedback = [e[:, joint] - part.setpoints.effort[:, joint] for e, part in zip(efforts, parts, strict=True)]
        instruments = [_neighbours(c, part.segment.period) for c, part in zip(columns, parts, strict=True)]
        z, x, y = (np.concatenate(lists) for lists in (instruments, columns, feedback))
        predicted = z @ np.linalg.lstsq(z, x, rcond=None)[0]
        solution, *_ = np.linalg.lstsq(predicted, y, rcond=None)
        total = np.concatenate([effort[:, joint] for effort in efforts])
        explained[joint] = solution[0] > 0.0 and np.var(y - x @ solution) < (1.0 - _EXPLAINED) * np.var(total)
        gains[joint] = solution if explained[joint] else 0.0
    return FittedController(gains[:, 0], np.maximum(gains[:, 1], 0.0), gains[:, 2], explained)


def _feedback_columns(part: _Commanded, joint: int) -> FloatArray:
    """Errors of position and velocity, and a constant column ``(N, 3)``."""
    samples, setpoints = part.segment.samples, part.setpoints
    errors = setpoints.position - samples.position, setpoints.velocity - samples.velocity
    return np.stack([*(error[:, joint] for error in errors), np.ones(len(samples))], axis=1)


def _neighbours(columns: FloatArray, period: float) -> FloatArray:
    """``columns (N, K)`` shifted before and after by the lags, side by side ``(N, 6 K)``; the ends are repeated."""
    shifts = [round(sign * separation / period) for separation in _SEPARATIONS for sign in (-1, 1)]
    indices = np.arange(len(columns))[:, None] + np.array(shifts)
    return np.asarray(columns[np.clip(indices, 0, len(columns) - 1)].reshape(len(columns), -1))


def _undelayed_efforts(segment: UniformSegment, robot: WrittenRobot) -> FloatArray:
    """Measured efforts without their delay ``(N, J)``."""
    effort = segment.samples.effort
    shifted = interpolated(segment.times, effort, segment.times + robot.delay)
    return np.where(np.all(np.isfinite(effort), axis=0), shifted, np.nan)


def _simulated_effort(part: _Commanded, controller: FittedController, robot: WrittenRobot) -> FloatArray:
    """Simulated efforts ``(N, J)`` as the sensors would show them."""
    times = part.segment.times
    true_effort = _effort(part, controller, *_simulated_motion(part, controller, robot))
    return robot.measured_effort(interpolated(times, true_effort, np.maximum(times - robot.delay, 0.0)))


def _simulated_motion(
    part: _Commanded, controller: FittedController, robot: WrittenRobot
) -> tuple[FloatArray, FloatArray]:
    """Simulate positions and velocities ``(N, J)`` under the commands, from the measured initial state."""
    samples = part.segment.samples
    closed = robot.in_closed_loop(controller.stiffness, controller.damping, controller.explains_efforts)
    simulation = WindowSimulation(closed, part.segment, starts=np.zeros(1, dtype=np.int64), intervals=len(samples) - 1)
    (position,), (velocity,), _ = simulation.run(driving_efforts=_driving(part, controller, robot, simulation))
    return np.vstack([samples.position[:1], position]), np.vstack([samples.velocity[:1], velocity])


def _effort(part: _Commanded, controller: FittedController, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Efforts of the controller at the samples ``(N, J)``."""
    proportional = controller.stiffness * (part.setpoints.position - position)
    damping = controller.damping * (part.setpoints.velocity - velocity)
    return part.setpoints.effort + controller.constant + proportional + damping


def _driving(
    part: _Commanded, controller: FittedController, robot: WrittenRobot, simulation: WindowSimulation
) -> FloatArray:
    """Efforts ``(1, steps, J)`` that drive the joints in addition to the controller's springs and dampers.

    MuJoCo's springs act by the beginning of a step and its dampers by the end. So do the set-points here, otherwise a
    joint would lag by half a step.
    """
    (segment, commands), middles, half = part, simulation.instants, 0.5 * simulation.step
    setpoints = controller.stiffness * interpolated(segment.times, commands.position, middles - half)
    setpoints += controller.damping * interpolated(segment.times, commands.velocity, middles + half)
    commanded = _effort(part, controller, segment.samples.position, segment.samples.velocity)
    effort, feedforward = (interpolated(segment.times, values, middles) for values in (commanded, commands.effort))
    motion = motion_at(segment, middles)
    controlled = feedforward + controller.constant + setpoints - robot.sidecar_friction(effort, motion)
    return np.where(controller.explains_efforts, controlled, robot.prescribed_effort(motion.acceleration))
