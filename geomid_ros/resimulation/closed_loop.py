"""Simulation of whole recordings from their commands, with a fitted controller and the written robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.files.models.written_model import ModelFiles
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.resimulate import (
    NotSimulatedError,
    ResidualNoise,
    Resimulated,
    SimulatedEfforts,
    UniformSegment,
    Windows,
    WindowSimulation,
    in_units,
    interpolated,
    motion_at,
    root_mean_square,
    uniform_segments,
)
from geomid_ros.resimulation.written_robot import FLOATING_BASE_REASON, WrittenRobot, loaded_robots
from geomid_ros.signals.kernels import filtered
from geomid_ros.types import BoolArray, FloatArray

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


@dataclass(frozen=True, eq=False)
class _Commanded:
    """Segment with its set-points and feed-forward efforts, each ``(N, J)``."""

    stretch: UniformSegment
    position: FloatArray
    velocity: FloatArray
    feedforward: FloatArray


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
        traces.append(SimulatedEfforts(part.stretch.times, part.stretch.samples.effort, *simulated))
    floor = np.sqrt(np.mean(noise.only(joints).values ** 2, axis=0))
    evaluated = controller.explains_efforts & (floor > 0.0)

    def ratios(kind: str) -> dict[str, float]:
        errors = [trace.measured - getattr(trace, kind) for trace in traces]
        filtered_errors = [filtered(e, cutoff, p.stretch.period)[0] for e, p in zip(errors, parts, strict=True)]
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
    errors = [_simulated_motion(part, controller, robot)[0] - part.stretch.samples.position for part in parts]
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
    efforts = np.concatenate([part.stretch.samples.effort for part in parts])
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
    for stretch in uniform_segments([measured]):
        first = int(np.searchsorted(commanded.stamps, stretch.samples.stamps[0]))
        part = commanded.select(slice(first, first + len(stretch.times)))
        result.append(_Commanded(stretch, part.position, part.velocity, np.nan_to_num(part.effort)))
    return result


def fitted_controller(parts: Sequence[_Commanded], robot: WrittenRobot) -> FittedController:
    """Fit the gains that explain the true efforts: the measured ones, corrected by the sidecar of ``robot``.

    A good controller's errors are hardly larger than their measurement noise, so least squares would underestimate the
    gains. Therefore the errors shortly before and after, whose noise is independent, serve as instruments: two-stage
    least squares.
    """
    efforts = [robot.true_effort(_undelayed_efforts(part.stretch, robot)) for part in parts]
    joints = len(robot.joints)
    gains, explained = np.zeros((joints, 3)), np.zeros(joints, dtype=bool)
    for joint in np.flatnonzero(np.all([np.all(np.isfinite(effort), axis=0) for effort in efforts], axis=0)):
        columns = [_feedback_columns(part, int(joint)) for part in parts]
        feedback = [effort[:, joint] - part.feedforward[:, joint] for effort, part in zip(efforts, parts, strict=True)]
        instruments = [_neighbours(c, p.stretch.period) for c, p in zip(columns, parts, strict=True)]
        z, x, y = (np.concatenate(lists) for lists in (instruments, columns, feedback))
        predicted = z @ np.linalg.lstsq(z, x, rcond=None)[0]
        solution, *_ = np.linalg.lstsq(predicted, y, rcond=None)
        total = np.concatenate([effort[:, joint] for effort in efforts])
        explained[joint] = solution[0] > 0.0 and np.var(y - x @ solution) < (1.0 - _EXPLAINED) * np.var(total)
        gains[joint] = solution if explained[joint] else 0.0
    return FittedController(gains[:, 0], np.maximum(gains[:, 1], 0.0), gains[:, 2], explained)


def _feedback_columns(part: _Commanded, joint: int) -> FloatArray:
    """Errors of position and velocity, and a constant column ``(N, 3)``."""
    samples = part.stretch.samples
    errors = part.position - samples.position, part.velocity - samples.velocity
    return np.stack([*(error[:, joint] for error in errors), np.ones(len(samples))], axis=1)


def _neighbours(columns: FloatArray, period: float) -> FloatArray:
    """``columns (N, K)`` shifted before and after by the lags, side by side ``(N, 6 K)``; the ends are repeated."""
    shifts = [round(sign * separation / period) for separation in _SEPARATIONS for sign in (-1, 1)]
    indices = np.arange(len(columns))[:, None] + np.array(shifts)
    return np.asarray(columns[np.clip(indices, 0, len(columns) - 1)].reshape(len(columns), -1))


def _undelayed_efforts(stretch: UniformSegment, robot: WrittenRobot) -> FloatArray:
    """Measured efforts without their delay ``(N, J)``."""
    effort = stretch.samples.effort
    shifted = interpolated(stretch.times, effort, stretch.times + robot.delay)
    return np.where(np.all(np.isfinite(effort), axis=0), shifted, np.nan)


def _simulated_effort(part: _Commanded, controller: FittedController, robot: WrittenRobot) -> FloatArray:
    """Simulated efforts ``(N, J)`` as the sensors would show them."""
    times = part.stretch.times
    true_effort = _effort(part, controller, *_simulated_motion(part, controller, robot))
    return robot.measured_effort(interpolated(times, true_effort, np.maximum(times - robot.delay, 0.0)))


def _simulated_motion(
    part: _Commanded, controller: FittedController, robot: WrittenRobot
) -> tuple[FloatArray, FloatArray]:
    """Simulate positions and velocities ``(N, J)`` under the commands, from the measured initial state."""
    samples = part.stretch.samples
    closed = robot.in_closed_loop(controller.stiffness, controller.damping, controller.explains_efforts)
    whole = Windows(part.stretch, starts=np.zeros(1, dtype=np.int64), intervals=len(samples) - 1)
    simulation = WindowSimulation(closed, whole)
    simulated = simulation.run(driving_efforts=_driving(part, controller, robot, simulation))
    position, velocity = simulated.position[0], simulated.velocity[0]
    return np.vstack([samples.position[:1], position]), np.vstack([samples.velocity[:1], velocity])


def _effort(part: _Commanded, controller: FittedController, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Efforts of the controller at the samples ``(N, J)``."""
    proportional = controller.stiffness * (part.position - position)
    damping = controller.damping * (part.velocity - velocity)
    return part.feedforward + controller.constant + proportional + damping


def _driving(
    part: _Commanded, controller: FittedController, robot: WrittenRobot, simulation: WindowSimulation
) -> FloatArray:
    """Efforts ``(1, steps, J)`` that drive the joints in addition to the controller's springs and dampers.

    MuJoCo's springs act by the beginning of a step and its dampers by the end. So do the set-points here, otherwise a
    joint would lag by half a step.
    """
    samples, times, middles = part.stretch.samples, part.stretch.times, simulation.instants
    setpoints = controller.stiffness * interpolated(times, part.position, middles - 0.5 * simulation.step)
    setpoints += controller.damping * interpolated(times, part.velocity, middles + 0.5 * simulation.step)
    commanded = _effort(part, controller, samples.position, samples.velocity)
    effort, feedforward = (interpolated(times, values, middles) for values in (commanded, part.feedforward))
    motion = motion_at(part.stretch, middles)
    controlled = feedforward + controller.constant + setpoints - robot.sidecar_friction(effort, motion)
    return np.where(controller.explains_efforts, controlled, robot.prescribed_effort(motion.acceleration))
