"""Parts of a recording without a pause, short windows simulated from measured states, and their errors and noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.gap.result import GapResult
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import Motion
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.written_robot import WrittenRobot
from geomid_ros.signals.kernels import filtered
from geomid_ros.types import BoolArray, FloatArray, IntArray

# Long enough for the noise of efforts to average out, short enough for errors not to grow by themselves: an arm that
# falls like a pendulum of half a metre makes 1.1 of an error of 1 in this time.
HORIZON = 0.1  # [s]
_GEAR_CUTOFF = 8.0  # [Hz] of what turns gears that give; faster is the noise of accelerations
_MOST_STEPS = 30_000  # of all windows of a stretch together; of more, evenly spaced ones are simulated


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one stretch, each of ``intervals`` sampling periods; ``starts (W,)`` index its samples."""

    stretch: Stretch
    starts: IntArray
    intervals: int

    @staticmethod
    def of(stretch: Stretch, step: float) -> Windows:
        """The windows to be simulated in steps of ``step`` [s]."""
        intervals = max(1, round(HORIZON / stretch.period))
        starts = np.arange(0, len(stretch.times) - intervals, intervals)
        affordable = max(1, int(_MOST_STEPS * step / (intervals * stretch.period)))
        return Windows(stretch, starts[:: max(1, -(-len(starts) // affordable))], intervals)

    @staticmethod
    def whole(stretch: Stretch) -> Windows:
        """All of a stretch as one window."""
        return Windows(stretch, np.zeros(1, dtype=np.int64), len(stretch.times) - 1)

    @property
    def samples(self) -> IntArray:
        """Indices of each window's samples behind its start ``(W, intervals)``."""
        return self.starts[:, None] + 1 + np.arange(self.intervals)


@dataclass(frozen=True, eq=False)
class Simulated:
    """What the windows led to: the joints' ``position, velocity (W, intervals, J)`` at their samples, and the mean over
    each window of what the sensors would show, ``sensed (W, values)``."""

    position: FloatArray
    velocity: FloatArray
    sensed: FloatArray


class WindowSimulation:
    """Windows on one robot; :meth:`run` may be called with disturbed efforts."""

    def __init__(self, robot: WrittenRobot, windows: Windows) -> None:
        self._robot = robot
        self.windows = windows
        period, times = windows.stretch.period, windows.stretch.times
        # From one sample to the next, none longer than the robot's step.
        self._substeps = max(1, int(np.ceil(period / robot.step - 1e-9)))
        self.step = period / self._substeps
        middles = period * (np.arange(windows.intervals * self._substeps) + 0.5) / self._substeps
        self.instants = times[windows.starts, None] + middles
        """The middles of the integration steps of each window ``(W, steps)`` [s]."""

    @cached_property
    def driving(self) -> FloatArray:
        """Measured efforts as they drive the joints in MuJoCo, in the middle of each step ``(W, steps, J)``."""
        robot, samples, times = self._robot, self.windows.stretch.samples, self.windows.stretch.times
        true = robot.true_effort(interpolated(times, samples.effort, self.instants + robot.delay))
        return robot.driving_effort(true, motion_at(self.windows.stretch, self.instants))

    @cached_property
    def _states(self) -> tuple[FloatArray, FloatArray]:
        """MuJoCo's positions and velocities at the windows' starts, each ``(W, nv)``."""
        robot, stretch, starts = self._robot, self.windows.stretch, self.windows.starts
        position, velocity = np.zeros((2, len(starts), robot.model.nv))
        samples = stretch.samples.select(starts)
        position[:, robot.dofs], velocity[:, robot.dofs] = samples.position, samples.velocity
        if robot.gears:
            gears = list(robot.gears)
            deflection, rate, _ = filtered(robot.gear_deflections(stretch.samples), _GEAR_CUTOFF, stretch.period)
            position[:, gears], velocity[:, gears] = deflection[starts], rate[starts]
        return position, velocity

    def run(self, disturbance: FloatArray | float = 0.0, driving: FloatArray | None = None) -> Simulated:
        """Simulate under the measured efforts, or those ``driving (W, steps, J)``, and a disturbance of that shape."""
        efforts = (self.driving if driving is None else driving) + disturbance
        position, velocity, sensed = self._robot.rollout(*self._states, efforts, self.step)
        at_samples = slice(self._substeps - 1, None, self._substeps)
        return Simulated(position[:, at_samples], velocity[:, at_samples], sensed.mean(axis=1))


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples at equal distances of ``period`` [s]; ``times (N,)`` [s] from the first sample of all."""

    samples: Samples
    times: FloatArray
    period: float


def stretches(recordings: Iterable[Samples]) -> list[Stretch]:
    """The parts of recordings without a pause that are as long as two windows."""
    found: list[Stretch] = []
    for samples in recordings:
        period = 1e-9 * float(np.median(np.diff(samples.stamps))) if len(samples) > 1 else 0.0
        found += [
            Stretch(part, 1e-9 * (part.stamps - part.stamps[0]), period)
            for part in samples.stretches()
            if len(part) * period >= 2.0 * HORIZON
        ]
    return found


def interpolated(times: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic interpolation of ``values (N, K)`` at ``times (N,)`` to the instants ``at (...)``, ``(..., K)``.

    Columns that are not measured throughout are zero.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 takes long to load

    spline = CubicSpline(times, np.where(np.all(np.isfinite(values), axis=0), values, 0.0))
    return np.asarray(spline(at))


def motion_at(stretch: Stretch, instants: FloatArray) -> Motion:
    """The measured motion at ``instants (...)`` [s], ``(..., J)`` each."""
    samples = stretch.samples
    parts = (samples.position, samples.velocity, samples.acceleration)
    return Motion(np.array([interpolated(stretch.times, part, instants) for part in parts]))


_DRAWS = 4  # of noise for each window


class Errors:
    """Errors of windows by quantity: the joints' velocities at the windows' ends, then the wrench channels' means.

    ``names`` are the channels of ``model``; arrays ``(W, channels)`` follow them.
    """

    def __init__(self, model: MeasurementModel, noise: Noise) -> None:
        self.names = [channel.name for channel in model.channels]
        self._joints = len(model.robot.joints)
        self._sensors = model.mounted
        self._all_sensors = model.sensors
        self._noise = noise.only(self.names)

    def measured_wrenches(self, parts: Sequence[Stretch]) -> BoolArray:
        """Whether each wrench channel is measured throughout."""
        columns = [
            np.all([np.all(np.isfinite(self._measured(part, sensor)), axis=0) for part in parts], axis=0)
            for sensor in self._sensors
        ]
        return np.concatenate([np.zeros(0, dtype=bool), *columns])

    def _measured(self, stretch: Stretch, sensor: WrenchSensor) -> FloatArray:
        measured = stretch.samples.wrenches[:, self._all_sensors.index(sensor), sensor.axis_indices]
        return np.asarray(sensor.sign * measured)

    def of(self, windows: Windows, instants: FloatArray, robot: WrittenRobot, simulated: Simulated) -> FloatArray:
        """Measured minus simulated."""
        velocity = windows.stretch.samples.velocity[windows.samples[:, -1]] - simulated.velocity[:, -1]
        motion = Motion(motion_at(windows.stretch, instants).states.mean(axis=2))
        wrenches = [
            interpolated(windows.stretch.times, self._measured(windows.stretch, sensor), instants).mean(axis=1)
            - robot.wrench(simulated.sensed, sensor)[:, sensor.axis_indices]
            - robot.wrench_error(motion, sensor)
            for sensor in self._sensors
        ]
        return np.hstack([velocity, *wrenches])

    def of_noise(self, simulation: WindowSimulation, robot: WrittenRobot, undisturbed: Simulated) -> FloatArray:
        """What noise in the efforts and wrenches changes, ``(draws W, channels)``."""
        random = np.random.default_rng(0)
        changes: list[FloatArray] = []
        for _ in range(_DRAWS):
            noise = self._noise.at(simulation.instants, random.uniform(0.0, self._noise.duration))
            disturbed = simulation.run(noise[..., : self._joints] / robot.gain)
            velocity = disturbed.velocity[:, -1] - undisturbed.velocity[:, -1]
            change = disturbed.sensed - undisturbed.sensed
            wrenches = [robot.wrench(change, sensor)[:, sensor.axis_indices] for sensor in self._sensors]
            changes.append(np.hstack([velocity, *wrenches]))
            changes[-1][:, self._joints :] -= noise[..., self._joints :].mean(axis=1)
        return np.concatenate(changes)


def root_mean_square(parts: Sequence[FloatArray]) -> FloatArray:
    """Of parts ``(N, K)``, each column ``(K,)``; infinite where a simulation diverged."""
    values = np.concatenate(parts)
    return np.asarray(np.sqrt(np.mean(np.where(np.isfinite(values), values, np.inf) ** 2, axis=0)))


@dataclass(frozen=True, eq=False)
class Noise:
    """An example of the noise in every channel: ``values (M, channels)`` [N m, N] every ``period`` [s], NaN where a
    channel is not measured."""

    channels: tuple[str, ...]
    period: float
    values: FloatArray

    @staticmethod
    def of(result: GapResult) -> Noise:
        """What the final model leaves of the held-out data, scaled to the noise floor: its size is the floor's, its
        colour and what channels have in common are those of the remainder."""
        remainder = result.trace.measured - result.trace.after
        counts = np.count_nonzero(np.isfinite(remainder), axis=0)
        size = np.sqrt(np.nansum(remainder**2, axis=0) / np.maximum(counts, 1))
        scale = np.divide(result.floor, size, out=np.full(len(size), np.nan), where=size > 0.0)
        period = 1e-9 * float(np.median(np.diff(result.trace.stamps)))
        return Noise(result.channels, period, scale * remainder)

    @property
    def duration(self) -> float:
        """Length of the example [s]."""
        return len(self.values) * self.period

    def at(self, times: FloatArray, shift: float) -> FloatArray:
        """The noise at ``times (...)`` [s], begun ``shift`` [s] later and repeated without end, ``(..., channels)``."""
        place = (np.asarray(times) + shift) / self.period
        first = np.floor(place).astype(np.int64)
        share = (place - first)[..., None]
        count = len(self.values)
        return (1.0 - share) * self.values[first % count] + share * self.values[(first + 1) % count]

    def only(self, names: Sequence[str]) -> Noise:
        """The noise of these channels; none where it is not known."""
        silent = np.zeros(len(self.values))
        found = [self.values[:, self.channels.index(name)] if name in self.channels else silent for name in names]
        return Noise(tuple(names), self.period, np.nan_to_num(np.stack(found, axis=1)))
