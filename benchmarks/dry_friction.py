"""Dry friction of known shape: is it taken for what it is not, and does its interval hold the truth?

    python -m benchmarks.dry_friction [--seeds 20] [--kinds KIND ...] [--out after.json]

Simulated arms with Coulomb and viscous friction at every joint, whose URDF has the wrong inertias, are identified with
the default settings. Dry friction turns sharply (``tanh(v / 0.004)``), smoothly (``tanh(v / 0.02)``), as MuJoCo's
``frictionloss`` does, or has a true Stribeck excess. Recordings are kept in ``out/dry_friction``.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import geomid_ros
from benchmarks.posterior import true_parameters
from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.model.effects import DEFAULT_CANDIDATES
from geomid_ros.simulation.bag import write_bag
from geomid_ros.simulation.description import robot_description
from geomid_ros.simulation.effects import TrueEffect
from geomid_ros.simulation.motion import RunTrace, exciting_motion
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import control_loop, record, write_truth
from geomid_ros.simulation.robot import TrueRobot, build_robot
from geomid_ros.types import FloatArray

ROBOT = "arm7"
_FOLDER = Path("out/dry_friction")
_FIRST_SEED = 7000
_SECONDS = 30.0
_RATES = (100.0, 125.0, 250.0, 500.0)  # [Hz]
_MOTIONS = (  # slow, and exciting
    {"motion_period": 12.0, "motion_harmonics": 3, "motion_speed": 0.15},
    {"motion_period": 6.0, "motion_harmonics": 6, "motion_speed": 0.6},
)
_STRONGEST = 0.3  # dry friction of a weak joint, as a share of its effort limit
_MUJOCO = "MuJoCo"
KINDS = {"sharp": 0.004, _MUJOCO: 0.0, "smooth": 0.02, "Stribeck": 0.004}
"""Kinds of dry friction, and the speed [rad/s] over which it changes its sign."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot in a motion with the true dry friction of its joints: ``levels``, ``excesses`` [N m] ``(joints,)`` and
    Stribeck ``speeds`` [rad/s]."""

    kind: str
    options: SimulationOptions
    levels: FloatArray
    excesses: FloatArray
    speeds: FloatArray

    @classmethod
    def drawn(cls, kind: str, seed: int) -> Arm:
        """The arm of a seed; its links, motion and noise are the same for every kind."""
        rng = np.random.default_rng([seed, 1])
        base = SimulationOptions(
            robot=ROBOT, seed=_FIRST_SEED + seed, duration=_SECONDS, rate=float(rng.choice(_RATES))
        )
        joints = build_robot(base).joints
        count = len(joints)
        efforts = np.array([joint.effort for joint in joints])
        levels = np.minimum(rng.uniform(3.0, 12.0, count), _STRONGEST * efforts)
        viscous = rng.uniform(0.3, 1.5, count)
        rotors, offsets = rng.uniform(1e-3, 3e-3, count), rng.uniform(-5e-3, 5e-3, count)
        hidden = []
        for place, joint in enumerate(joints):
            hidden += [
                Hidden("viscous_friction", joint.name, float(viscous[place])),
                Hidden("rotor_inertia", joint.name, float(rotors[place] * joint.effort / joint.velocity)),
                Hidden("effort_offset", joint.name, float(offsets[place] * joint.effort)),
            ]
            if kind == _MUJOCO:
                hidden.append(Hidden("coulomb_friction", joint.name, float(levels[place])))
        motion: dict[str, Any] = _MOTIONS[seed % len(_MOTIONS)]
        options = replace(base, inertia_error=rng.uniform(0.1, 0.3), hide=tuple(hidden), **motion)
        excesses = levels * rng.uniform(0.2, 0.6, count) * (kind == "Stribeck")
        return cls(kind, options, levels, excesses, rng.uniform(0.05, 0.3, count))

    def recorded(self) -> tuple[Path, dict[str, Any]]:
        """Its bag and the truth about it; an earlier recording is used again."""
        bag = _FOLDER / f"{self.kind}_{self.options.seed}"
        path = bag.with_name(f"{bag.name}.truth.json")
        if not path.exists():
            shutil.rmtree(bag, ignore_errors=True)  # what an interrupted run left
            _FOLDER.mkdir(parents=True, exist_ok=True)
            robot = build_robot(self.options)
            true = (
                record(robot, control_loop(robot, self.options), self.options)
                if self._simulated
                else self._moved(robot)
            )
            write_bag(bag, robot.published(true, self.options), robot.plant.joints, robot.nominal.text, self.options)
            robot = replace(robot, effects=(*robot.effects, *self._dry(robot)))
            write_truth(path, robot, self.options, {})
        return bag, json.loads(path.read_text(encoding="utf-8"))

    @property
    def _simulated(self) -> bool:
        return self.kind == _MUJOCO

    def _dry(self, robot: TrueRobot) -> Iterator[TrueEffect]:
        """The dry friction that is no part of the plant."""
        for place, joint in enumerate(robot.plant.joints if not self._simulated else ()):
            yield TrueEffect("coulomb_friction", joint, {"level": float(self.levels[place])})
            if self.excesses[place]:
                values = {"excess": float(self.excesses[place]), "speed": float(self.speeds[place])}
                yield TrueEffect("stribeck_friction", joint, values)

    def _moved(self, robot: TrueRobot) -> RunTrace:
        """The trace of a robot that follows its set-points exactly: a closed loop cannot be integrated with friction
        that turns this sharply."""
        options = self.options
        times = np.arange(options.samples) / options.rate
        motion = exciting_motion(times, robot.joints, options, np.random.default_rng([options.seed, 2]))
        states = zip(motion.position, motion.velocity, motion.acceleration, strict=True)
        efforts = np.array([robot.plant.inverse_dynamics(*state) for state in states])
        levels = self.levels + self.excesses * np.exp(-((motion.velocity / self.speeds) ** 2))
        efforts += levels * np.tanh(motion.velocity / KINDS[self.kind])
        none = np.zeros((len(times), 0))
        return RunTrace(
            time=times,
            position=motion.position,
            velocity=motion.velocity,
            acceleration=motion.acceleration,
            effort=efforts,
            wrench_time=times,
            wrench=none,
            commands=motion,
            feedforward=efforts,
            fine_time=times,
            fine_effort=efforts,
        )


@dataclass(frozen=True)
class Row:
    """What was found of one arm.

    Attributes:
        stribeck, quadratic, other: Numbers of optional effects by name that are not there.
        found, true: Joints at which a true Stribeck excess was found, with its sign, and at which there is one.
        viscous, coulomb: Joints whose 95 % interval holds the truth.
        joints: Number of joints.
        distance: Squared Mahalanobis distance of the truth from the estimate, per direction.
        total: Sum over channels of the RMS on held-out data [N m].
    """

    stribeck: int
    quadratic: int
    other: int
    found: int
    true: int
    viscous: int
    coulomb: int
    joints: int
    distance: float
    total: float
    seconds: float


def row(kind: str, seed: int) -> Row:
    """Identify the arm of a seed, and compare with the truth."""
    bag, truth = Arm.drawn(kind, seed).recorded()
    urdf = robot_description(ROBOT)
    begin = time.process_time()
    identified = geomid_ros.identify(bag, urdf)
    seconds = time.process_time() - begin
    true = {(effect["effect"], effect["joint"]): effect["parameters"] for effect in truth["effects"]}
    optional = [effect for effect in identified.effects if effect.name in DEFAULT_CANDIDATES]
    phantoms = [effect.name for effect in optional if (effect.name, effect.joint) not in true]
    excesses = [name for name in true if name[0] == "stribeck_friction"]
    there = [effect for effect in optional if (effect.name, effect.joint) in excesses and effect.value > 0.0]
    held = {"viscous_friction": 0, "coulomb_friction": 0}
    for effect in identified.effects:
        if effect.name in held:
            expected = next(iter(true[effect.name, effect.joint].values()))
            held[effect.name] += abs(effect.value - expected) < STDS_OF_95 * effect.std
    posterior = identified.estimate.posterior
    error = posterior.coordinates(true_parameters(posterior, truth, urdf, ()))
    return Row(
        stribeck=phantoms.count("stribeck_friction"),
        quadratic=phantoms.count("quadratic_friction"),
        other=len(phantoms) - phantoms.count("stribeck_friction") - phantoms.count("quadratic_friction"),
        found=len(there),
        true=len(excesses),
        viscous=held["viscous_friction"],
        coulomb=held["coulomb_friction"],
        joints=len(truth["joints"]),
        distance=float(error @ np.linalg.solve(posterior.covariance, error)) / len(error),
        total=float(np.nansum(list(identified.rms.values()))),
        seconds=seconds,
    )


def _summary(kind: str, rows: Sequence[Row]) -> list[str]:
    """A line of the table."""
    joints = sum(each.joints for each in rows)

    def total(name: str) -> int:
        return int(sum(getattr(each, name) for each in rows))

    wrong = sum(each.stribeck + each.quadratic > 0 for each in rows)
    distances, totals = [each.distance for each in rows], [each.total for each in rows]
    return [
        kind,
        f"{wrong} of {len(rows)}",
        *(f"{total(name)}" for name in ("stribeck", "quadratic", "other")),
        f"{total('found')} of {total('true')}" if total("true") else "",
        *(f"{100 * total(name) / joints:.0f} %" for name in ("viscous", "coulomb")),
        f"{np.median(distances):.2f} ({np.mean(distances):.3g})",
        f"{np.exp(np.mean(np.log(totals))):.3f}",
        f"{np.mean([each.seconds for each in rows]):.1f}",
    ]


def main() -> None:
    """Print a line for each kind of friction."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dry_friction", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="arms of each kind (%(default)s)")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    arguments = parser.parse_args()
    table = Table(box=box.SIMPLE_HEAD)
    headings = ("friction", "arms with a phantom", "Stribeck", "quadratic", "other", "true found", "viscous", "Coulomb")
    for heading in (*headings, "distance² (mean)", "held out", "s"):
        table.add_column(heading, justify="left" if heading == "friction" else "right")
    found: dict[str, list[Row]] = {}
    for kind in arguments.kinds:
        found[kind] = list(map(partial(row, kind), range(arguments.seeds)))
        table.add_row(*_summary(kind, found[kind]))
        if arguments.out:
            kept = {name: [asdict(each) for each in rows] for name, rows in found.items()}
            arguments.out.write_text(json.dumps(kept, indent=2))
    console = Console(width=140)
    console.print(table)
    console.print(
        "Phantoms are optional effects that the arm has not; viscous and Coulomb: joints whose 95 % interval holds the "
        "truth; distance²: squared Mahalanobis distance of the truth per direction of the posterior, median and mean; "
        "held out: geometric mean of the sums of the channels' RMS [N m]."
    )


if __name__ == "__main__":
    main()
