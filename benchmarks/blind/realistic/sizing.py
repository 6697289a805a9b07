"""How far a change shows: in units of the floor, beside the link inertias that fit best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.blind.case import robot_file
from benchmarks.blind.realistic.case import RealisticCase
from geomid_ros.errors import InputError
from geomid_ros.simulation.description import body_of, pseudo_inertia
from geomid_ros.simulation.effects import noiseless_measurement
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.realistic import RealisticRobot, build_realistic, published
from geomid_ros.simulation.recording import control_loop, record
from geomid_ros.types import FloatArray

LEAST, MOST = 3.0, 10.0
"""Between which multiples of the floor the worst channel lies."""

_BAND = 5.0  # Hz
_EVERY = 0.05  # s, between the rows that are fitted
_ROUNDS = 5
_DRAWS = 10  # of noise: the floor is that of the sensors, not of one recording
_CLOSE = 1.15  # of the target


@dataclass(frozen=True, eq=False)
class Shown:
    """The worst channel's share of a change, in floors: beside inertias fitted to both recordings, or to the second."""

    both: float
    alone: float


def sized(case: RealisticCase) -> tuple[RealisticCase, Shown]:
    """The case with its change scaled to the target, and how far it shows then."""
    was = _Run(case.was)
    as_it_was = _Run(replace(case.now, hide=()))
    rows = [was.rows(), as_it_was.rows()]
    floor = as_it_was.floor()
    for _ in range(_ROUNDS):
        shown = _shown(_Run(case.now), as_it_was, rows, floor)
        if LEAST <= shown.both <= MOST and 1.0 / _CLOSE < shown.both / case.target < _CLOSE:
            return case, shown
        case = case.scaled(float(np.clip(case.target / shown.both, 0.1, 10.0)))
    raise InputError(f"no size of {case.change.effect} shows {case.target:.1f} times the floor")


class _Run:
    """A recording before noise."""

    def __init__(self, options: SimulationOptions) -> None:
        options = replace(options, robot=robot_file(options.robot))
        self.robot: RealisticRobot = build_realistic(options)
        self.trace: RunTrace = record(self.robot, control_loop(self.robot, options), options)
        self.effort = noiseless_measurement(self.trace, self.robot.plant.joints, self.robot.effects).effort
        self._rate = options.rate
        self._at = np.arange(0, options.samples, max(1, round(_EVERY * options.rate)))

    def in_band(self, effort: FloatArray) -> FloatArray:
        """Efforts ``(T, n)`` below the band's end, at the instants of the rows ``(R, n)``."""
        filtered = sosfiltfilt(butter(2, _BAND, fs=self._rate, output="sos"), effort, axis=0)
        return np.asarray(filtered[self._at], dtype=np.float64)

    def rows(self) -> FloatArray:
        """Efforts ``(R, n, 10 links)`` per relative change of the links' inertias."""
        bodies, nominal = self.robot.bodies, self.robot.nominal
        moving = [index for index, body in enumerate(bodies) if self.robot.nominal.moved_by(body.name)]
        without = self._needed(Plant(nominal, bodies))
        columns = []
        for index in moving:
            root = np.linalg.cholesky(pseudo_inertia(bodies[index]))
            for direction in _directions():
                changed = body_of(bodies[index].name, root @ (np.eye(4) + 0.3 * direction) @ root.T)
                plant = Plant(nominal, (*bodies[:index], changed, *bodies[index + 1 :]))
                columns.append((self._needed(plant) - without) / 0.3)
        return np.stack(columns, axis=-1)

    def _needed(self, plant: Plant) -> FloatArray:
        trace = self.trace
        rows = zip(trace.position[self._at], trace.velocity[self._at], trace.acceleration[self._at], strict=True)
        return np.array([plant.inverse_dynamics(*row) for row in rows])

    def floor(self) -> FloatArray:
        """Root mean square ``(n,)`` of what nobody can model, in the band."""
        still, clean = replace(self.robot.sensors, jitter=0.0, lost=0.0), replace(self.trace, effort=self.effort)
        unseen = np.array(list(map(self.robot.motors.unmeasured_effort, self.trace.effort, self.trace.position)))
        squares = []
        for draw in range(_DRAWS):
            noisy = published(clean, still, np.random.default_rng(draw)).effort
            squares.append(self.in_band(noisy - self.effort - (unseen - unseen.mean(axis=0))) ** 2)
        return np.sqrt(np.mean(squares, axis=(0, 1)))


def _directions() -> list[FloatArray]:
    """The ten symmetric unit matrices ``(4, 4)``."""
    units = []
    for row, column in zip(*np.triu_indices(4), strict=True):
        unit = np.zeros((4, 4))
        unit[row, column] = unit[column, row] = 1.0
        units.append(unit)
    return units


def _shown(now: _Run, as_it_was: _Run, rows: list[FloatArray], floor: FloatArray) -> Shown:
    change = now.in_band(now.effort - as_it_was.effort)
    quiet = np.zeros(rows[0].shape[:2])
    return Shown(_beside(rows, [quiet, change], floor), _beside(rows[1:], [change], floor))


def _beside(rows: list[FloatArray], targets: list[FloatArray], floor: FloatArray) -> float:
    """What is left of the last target's worst channel beside the best inertias, in floors."""
    matrix = (np.concatenate(rows) / floor[:, None]).reshape(-1, rows[0].shape[-1])
    target = (np.concatenate(targets) / floor).ravel()
    rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    last = rest.reshape(-1, len(floor))[-len(targets[-1]) :]
    return float(np.sqrt(np.mean(last**2, axis=0)).max())
