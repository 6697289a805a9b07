"""Errors of simulated windows, and what noise alone makes of them: the unit of these errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.gap.result import GapResult
from geomid_ros.model.effects import Motion
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.resimulation.windows import Simulated, Stretch, Windows, WindowSimulation, interpolated
from geomid_ros.resimulation.written_robot import WrittenRobot
from geomid_ros.types import BoolArray, FloatArray

_DRAWS = 4  # of noise for each window
_SEED = 0


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
        motion = self._mean_motion(windows, instants)
        wrenches = [
            _mean(windows, instants, self._measured(windows.stretch, sensor))
            - robot.wrench(simulated.sensed, sensor)[:, sensor.axis_indices]
            - robot.wrench_error(motion, sensor)
            for sensor in self._sensors
        ]
        return np.hstack([velocity, *wrenches])

    @staticmethod
    def _mean_motion(windows: Windows, instants: FloatArray) -> Motion:
        samples = windows.stretch.samples
        parts = (samples.position, samples.velocity, samples.acceleration)
        return Motion(*(_mean(windows, instants, part) for part in parts))

    def of_noise(self, simulation: WindowSimulation, robot: WrittenRobot, undisturbed: Simulated) -> FloatArray:
        """What noise in the efforts and wrenches changes, ``(draws W, channels)``."""
        random = np.random.default_rng(_SEED)
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


def _mean(windows: Windows, instants: FloatArray, values: FloatArray) -> FloatArray:
    """Of ``values (N, K)`` at the instants of each window, ``(W, K)``."""
    return np.asarray(interpolated(windows.stretch.times, values, instants).mean(axis=1))


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
