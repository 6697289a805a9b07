"""A case: what is hidden in which robot, how it is recorded. The same kind and seed always give the same case."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, files
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import WRIST_FRAME
from geomid_ros.simulation.effect_sizes import SIZES
from geomid_ros.simulation.options import GEARS, Hidden, SimulationOptions

OUTSIDE = ("cogging", "cable_force", "drift", "position_friction", "joint_coupling")
"""Effects that the workflow has no name for."""
LIBRARY = tuple(effect for effect in SIZES if effect not in OUTSIDE)
"""Effects that the workflow can name."""
KINDS = ("single", "double", "none", "outside", "large_inertia_errors")

_DRAKE_SHARE = 0.25
_LARGE_ERROR = 0.6  # three times the 0.2 that the workflow takes for usual
_UR5 = "ur5_joint_limited_robot.urdf"
# Robot, frame of its wrench sensor, and how often it is drawn.
_ROBOTS = (
    ("arm7", WRIST_FRAME, 0.4),
    ("arm7", None, 0.2),
    ("arm3", WRIST_FRAME, 0.1),
    ("arm3", None, 0.1),
    (_UR5, None, 0.2),
)


@dataclass(frozen=True)
class Case:
    """Recordings to learn from and one to be judged on, made by ``simulator`` (``mujoco`` or ``drake``).

    A single payload is looked for as one does: the robot was identified from recordings without it, ``unloaded``. From
    recordings with it alone nothing tells a payload from an error of the link that carries it.
    """

    kind: str
    seed: int
    simulator: str
    training: tuple[SimulationOptions, ...]
    held_out: SimulationOptions
    unloaded: tuple[SimulationOptions, ...] = ()

    @property
    def name(self) -> str:
        """A folder's name, which says nothing of the answer."""
        return f"{self.seed}-{KINDS.index(self.kind)}"

    def document(self) -> dict[str, Any]:
        """Everything that decides the recordings, for JSON."""
        return asdict(self)

    def slower(self) -> Case:
        """The same with calmer motions."""
        calmer = {
            name: tuple(replace(each, motion_speed=0.7 * each.motion_speed) for each in recordings)
            for name, recordings in (("training", self.training), ("unloaded", self.unloaded))
        }
        held_out = replace(self.held_out, motion_speed=0.7 * self.held_out.motion_speed)
        return replace(self, held_out=held_out, **calmer)


def draw(kind: str, seed: int) -> Case:
    """The case of a seed. Effects take turns from seed to seed; all else is drawn."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    hide = _hidden(kind, seed, rng)
    robot, frame = _robot(any(request.effect == "wrench_offset" for request in hide), rng)
    common = SimulationOptions(
        robot=robot,
        seed=seed,
        rate=float(rng.choice([100.0, 100.0, 200.0])),
        wrench_frame=frame,
        inertia_error=_LARGE_ERROR if kind == "large_inertia_errors" else _between(0.03, 0.2, rng),
        hide=hide,
        commands=True,
    )
    common = _noisy(common, rng)
    common = replace(common, wrench_lag=rng.uniform(0.0, 1.0 / common.rate) if frame else 0.0)
    simulator = "drake" if rng.uniform() < _DRAKE_SHARE else "mujoco"
    motions = _motions(common, rng)
    training = tuple(motions[:-1])
    loaded = [request.effect for request in hide] == ["payload"]
    unloaded = tuple(replace(each, hide=(), motion_seed=1_000_000 + common.seed) for each in training[:1])
    return Case(kind, seed, simulator, training, motions[-1], unloaded if loaded else ())


def robot_file(robot: str) -> str:
    """A shipped robot's name as it is; of others the path of their URDF."""
    if not robot.endswith(".urdf"):
        return robot
    try:
        found = [str(file.locate()) for file in files("example-robot-data") or () if file.name == robot]
    except PackageNotFoundError as error:
        raise InputError(f"{robot} is missing: pip install -r requirements-bench.txt") from error
    return found[0]


def _hidden(kind: str, seed: int, rng: np.random.Generator) -> tuple[Hidden, ...]:
    if kind == "none":
        return ()
    if kind == "outside":
        return (Hidden(OUTSIDE[seed % len(OUTSIDE)]),)
    first = LIBRARY[seed % len(LIBRARY)]
    if kind != "double":
        return (Hidden(first),)
    others = [effect for effect in LIBRARY if effect != first and not {effect, first} <= {*GEARS}]
    return Hidden(first), Hidden(str(rng.choice(others)))


def _robot(needs_wrench: bool, rng: np.random.Generator) -> tuple[str, str | None]:
    robots = [(name, frame, share) for name, frame, share in _ROBOTS if frame or not needs_wrench]
    shares = np.array([share for _, _, share in robots])
    name, frame, _ = robots[int(rng.choice(len(robots), p=shares / shares.sum()))]
    return name, frame


def _noisy(options: SimulationOptions, rng: np.random.Generator) -> SimulationOptions:
    """White or coloured, of efforts and wrench; half of the robots have coarse sensors."""
    coarse, coloured = rng.uniform(size=2) < 0.5
    wrench = _between(0.5, 2.0, rng)
    return replace(
        options,
        position_noise=_between(1e-5, 5e-5, rng),
        velocity_noise=_between(5e-4, 2e-3, rng),
        effort_noise=_between(1e-3, 3e-3, rng),
        force_noise=0.1 * wrench,
        torque_noise=5e-3 * wrench,
        noise_time=_between(0.005, 0.05, rng) * float(coloured),
        position_step=2.0 * math.pi / 2.0 ** int(rng.integers(16, 21)) * float(coarse),
        effort_step=_between(2e-4, 2e-3, rng) * float(coarse),
    )


def _motions(common: SimulationOptions, rng: np.random.Generator) -> list[SimulationOptions]:
    """Two periodic recordings of two periods each or one of another kind; the last, held out, is another motion."""
    period, harmonics = rng.uniform(5.0, 7.0), int(rng.integers(5, 10))
    period = round(period * common.rate) / common.rate
    moving = replace(common, motion_period=period, motion_harmonics=harmonics, motion_range=rng.uniform(0.5, 0.8))
    moving = replace(moving, motion_speed=rng.uniform(0.4, 0.7))
    seeds = [100_000 * part + common.seed for part in (1, 2, 3)]
    kind = str(rng.choice(["sines", "aperiodic", "points", "chirp"], p=[0.6, 0.2, 0.1, 0.1]))
    held_out = replace(moving, motion_seed=seeds[2], duration=24.0, motion=str(rng.choice(["sines", "aperiodic"])))
    if kind == "sines":
        periodic = replace(moving, duration=2.0 + 2.0 * period)
        return [*(replace(periodic, motion_seed=each) for each in seeds[:2]), held_out]
    return [replace(moving, motion=kind, motion_seed=seeds[0], duration=28.0), held_out]


def _between(low: float, high: float, rng: np.random.Generator) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
