"""How well simulated robots carry a payload that no model has: PD alone, with efforts of a model, and with adaptation.

    python -m benchmarks.adaptation [--robots panda.urdf ur5_robot.urdf] [--seeds 1 2 3] [--lacking 0.2] [--friction]
    python -m benchmarks.adaptation --stability 20
    python -m benchmarks.adaptation --worst
    python -m benchmarks.adaptation --endurance 3600

Each robot is recorded for half a minute and identified. Then it follows another motion under PD at 1 kHz, a third as
stiff as that of ``benchmarks.feedforward``, and picks up 1.5 kg after three seconds. Errors are those of the hand, root
mean square in mm: before, in the first second with the payload, and after it. ``--worst`` compares with PD alone in the
same mishap, which begins after five seconds: two with the payload. A payload that is too heavy shows once more effort
is asked for than a joint has: times [s] count from when it is picked up, and from then on. ``--endurance`` feeds random
tracking errors, absurd ones too, to the adaptation at 500 Hz, and looks at every instant whether the body is possible.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table

import geomid_ros
from benchmarks.endurance import endure
from benchmarks.feedforward import described, hand_distances, hand_error
from geomid_ros.api.feedforward import robot_to_move
from geomid_ros.control.correction import Correction, Reading
from geomid_ros.control.feedforward import MotorEfforts
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.session.options import FillOptions
from geomid_ros.simulation.description import LinkInertia, body_of, pseudo_inertia, robot_description
from geomid_ros.simulation.motion import exciting_motion
from geomid_ros.simulation.options import RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.recording import control_loop, simulate
from geomid_ros.simulation.robot import build_robot
from geomid_ros.types import BoolArray, FloatArray

CYCLE = 1e-3  # [s] of the controller
_DURATION, _PICKED, _MISHAP = 8.0, 3.0, 5.0  # [s]
_POINTS = 0.05  # [s] between the points of the trajectory
_SOFTER = 1.0 / 3.0
_OTHER_MOTION = 1000  # added to the seed
HEAVIEST = 3.0  # [kg] that adaptation may find
_NOISE = np.array([1e-4, 1e-3, 2e-3])  # of positions [rad], velocities [rad/s], efforts (shares of the limits)


@dataclass(frozen=True)
class Link:
    """How the adaptation is reached: its ``period`` in controller's cycles, and how many its readings and its efforts
    travel; after a mishap the readings take ``late`` cycles, or are ``frozen``, or ``stop``."""

    period: int
    readings: int
    efforts: int
    late: int | None = None
    frozen: bool = False
    stop: bool = False


FAST, SLOW, LATE = Link(2, 1, 1), Link(10, 5, 5), Link(10, 15, 15)


@dataclass(eq=False)
class Adapting:
    """An adaptation in the loop: what it adds at every cycle, and what became of it."""

    correction: Correction
    commanded: FloatArray
    link: Link
    rng: np.random.Generator
    limits: FloatArray
    added: list[FloatArray] = field(default_factory=list)
    latched: float = np.inf
    smallest: float = np.inf
    _seen: list[Reading] = field(default_factory=list)
    _sent: deque[tuple[int, FloatArray]] = field(default_factory=deque)

    def see(self, cycle: int, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> None:
        """Note what is measured at a cycle."""
        noise = _NOISE[:, None] * self.rng.standard_normal((3, len(position)))
        state = np.array([position, velocity, effort]) + noise * [
            np.ones_like(effort),
            np.ones_like(effort),
            self.limits,
        ]
        if self.link.frozen and cycle * CYCLE >= _MISHAP:
            last = self._seen[-1]
            state = np.array([last.position, last.velocity, last.effort])
        self._seen.append(Reading(cycle * CYCLE, *state))

    def efforts(self, cycle: int) -> FloatArray:
        """Efforts that arrive by a cycle."""
        after = cycle * CYCLE >= _MISHAP
        age = self.link.late if after and self.link.late is not None else self.link.readings
        if cycle % self.link.period == 0 and 0 <= cycle - age < len(self._seen):
            now, at = cycle * CYCLE, cycle - age
            if after:  # none comes until they are as late
                at = max(at, round(_MISHAP / CYCLE) - self.link.readings)
            if not (after and self.link.stop):
                self.correction.learn(now, self._seen[at], self.commanded[:, at])
            arrival = cycle + self.link.efforts
            self._sent.append((arrival, self.correction(now, self.commanded[:, arrival])))
            values = np.linalg.eigvalsh(self.correction.adaptation.point.pseudo_inertias[0])
            self.smallest = min(self.smallest, float(values[0] / values[-1]))
            if self.correction.latch.reason:
                self.latched = min(self.latched, now)
        last = self.added[-1] if self.added else np.zeros(len(self.limits))
        while self._sent and self._sent[0][0] <= cycle:
            last = self._sent.popleft()[1]
        self.added.append(last)
        return last


@dataclass(frozen=True, eq=False)
class Run:
    """The hand's errors [mm] before, in the first second with the payload, and after it; after a mishap, and the
    largest one since the payload is there. When efforts were ``saturated (cycles,)``, more was asked for than a joint
    has."""

    errors: tuple[float, float, float]
    mishap: float
    largest: float
    saturated: BoolArray
    adapting: Adapting | None

    def saturated_since(self, begin: float) -> tuple[float, float]:
        """When [s] efforts saturated first from ``begin`` [s] on, infinite if never, and for how long [s] in all."""
        cycles = np.flatnonzero(self.saturated[round(begin / CYCLE) :])
        return begin + CYCLE * float(cycles[0]) if len(cycles) else np.inf, CYCLE * len(cycles)


class Robot:
    """A simulated robot that was identified, its controller and the trajectory to follow."""

    def __init__(self, name: str, seed: int, folder: Path, lacking: float = 0.0, friction: bool = False) -> None:
        """``lacking``: share of the friction and of all other effects that the model has not; ``friction``: True if
        friction adapts, too."""
        self.lacking, self.friction = lacking, friction
        self.name, self.seed = Path(name).stem, seed
        options = SimulationOptions(robot=described(name, folder), seed=seed, duration=30.0, rate=200.0)
        bag = folder / f"{self.name}_{seed}"
        if not bag.exists():
            simulate(bag, options)
            geomid_ros.identify(bag).save(folder / f"{self.name}_{seed}_estimate", report=False)
        self.options = replace(options, motion_seed=seed + _OTHER_MOTION, duration=_DURATION)
        self.robot = build_robot(self.options)
        self.joints = tuple(self.robot.plant.joints)
        self.limits = np.array([joint.effort for joint in self.robot.joints])
        controller = control_loop(self.robot, self.options).controller
        self.stiffness, self.damping = _SOFTER * controller.stiffness, np.sqrt(_SOFTER) * controller.damping
        self.urdf = robot_description(options.robot)
        estimate = EstimateFile.read(bag.with_name(f"{bag.name}_estimate") / "estimate.json")
        self.session = robot_to_move(FillOptions(force=True), estimate)
        self.body = self.session.robot.body_names[-1]
        cycles = round(_DURATION / CYCLE)
        self.times = CYCLE * np.arange(cycles + 200)  # what is commanded arrives later
        self.commanded = self._trajectory.states(self.times)[:3]
        self.cycles = cycles

    @cached_property
    def _trajectory(self) -> Trajectory:
        times = np.arange(0.0, _DURATION + 0.5 * _POINTS, _POINTS)
        numbers = generator(self.options.recording_seed, RandomStream.MOTION)
        motion = exciting_motion(times, self.robot.joints, self.options, numbers)
        return Trajectory(self.joints, times, motion.position, motion.velocity, motion.acceleration)

    def model(self, prior: float = 0.0) -> MotorEfforts:
        """Efforts of the identified model, whose last body has ``prior`` [kg] too much."""
        parameters = self.session.known_parameters.copy()
        parameters[len(self.session.model.nominal_inertias) :] *= 1.0 - self.lacking
        place = 10 * self.session.model.body_names.index(self.body)
        parameters[place : place + 10] += _dynamic(_payload(self.body, prior, self.seed))
        return MotorEfforts(self.session.model, parameters, self.session.effort_gains, self.joints, "the motion")

    @cached_property
    def from_urdf(self) -> FloatArray:
        """Efforts ``(N, joints)`` of the URDF."""
        session = robot_to_move(FillOptions(self.urdf), None)
        return MotorEfforts(session.model, session.known_parameters, session.effort_gains, self.joints, "the motion")(
            self.commanded
        )

    def adapting(self, link: Link, prior: float = 0.0) -> Adapting:
        """An adaptation of this robot's last body."""
        correction = Correction(self.model(prior), self.joints, self.body, HEAVIEST, self.friction)
        return Adapting(correction, self.commanded, link, np.random.default_rng(self.seed), self.limits)

    def run(
        self, forward: FloatArray | None, adapting: Adapting | None = None, mass: float = 1.5, push: float = 0.0
    ) -> Run:
        """Follow the trajectory with efforts ``forward (N, joints)``, a payload of this ``mass`` [kg] and after the
        mishap a force at the hand [N]."""
        plants = [self.robot.plant, self._carrying(mass)]
        position, velocity = plants[0].at_rest(self.commanded[0, 0])
        jacobian, force = self._hand(), _direction(self.seed) * push
        positions, saturated = [], np.zeros(self.cycles, dtype=np.bool_)
        for cycle in range(self.cycles):
            loaded, mishap = (cycle * CYCLE >= begin for begin in (_PICKED, _MISHAP))
            wanted, speed = self.commanded[:2, cycle]
            effort = self.stiffness * (wanted - position) + self.damping * (speed - velocity)
            effort += forward[cycle] if forward is not None else 0.0
            effort += adapting.efforts(cycle) if adapting else 0.0
            saturated[cycle] = np.any(np.abs(effort) > self.limits)
            effort = np.clip(effort, -self.limits, self.limits)
            if adapting:
                adapting.see(cycle, position, velocity, effort)
            positions.append(position)
            pushed = effort + jacobian(position).T @ force if push and mishap else effort
            position, velocity = _advanced(plants[int(loaded)], position, velocity, pushed)
        return self._judged(np.array(positions), saturated, adapting)

    def _judged(self, positions: FloatArray, saturated: BoolArray, adapting: Adapting | None) -> Run:
        def pair(begin: float, end: float) -> FloatArray:
            part = slice(round(begin / CYCLE), round(end / CYCLE), 5)
            return np.array([positions[part], self.commanded[0, : self.cycles][part]])

        ends = (0.0, _PICKED, _PICKED + 1.0, _DURATION)
        before, first, carrying = (hand_error(self.urdf, self.joints, pair(*part)) for part in pairwise(ends))
        mishap = hand_error(self.urdf, self.joints, pair(_MISHAP, _DURATION))
        largest = float(np.max(hand_distances(self.urdf, self.joints, pair(_PICKED, _DURATION))))
        return Run((before, first, carrying), mishap, largest, saturated, adapting)

    def _carrying(self, mass: float) -> Plant:
        load = _payload(self.body, mass, self.seed)
        bodies = [
            body_of(body.name, pseudo_inertia(body) + pseudo_inertia(load)) if body.name == self.body else body
            for body in self.robot.bodies
        ]
        return Plant(self.robot.nominal, bodies, self.robot.effects)

    def _hand(self) -> Callable[[FloatArray], FloatArray]:
        model = pin.buildModelFromXML(self.urdf)
        data, frame = model.createData(), model.getFrameId(self.body)
        places = [model.joints[model.getJointId(joint)].idx_q for joint in self.joints]

        def jacobian(position: FloatArray) -> FloatArray:
            q = pin.neutral(model)
            q[places] = position
            full = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
            return np.asarray(full[:3, places])

        return jacobian


def _advanced(
    plant: Plant, position: FloatArray, velocity: FloatArray, effort: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The state a cycle later, under efforts that are held."""
    state, rates = np.array([position, velocity]), []
    for share in (0.0, 0.5, 0.5, 1.0):
        reached, speed = state + share * CYCLE * rates[-1] if rates else state
        rates.append(np.array([speed, plant.acceleration(reached, speed, effort)]))
    first, second, third, fourth = rates
    position, velocity = state + CYCLE / 6.0 * (first + 2.0 * (second + third) + fourth)
    return position, velocity


def _payload(body: str, mass: float, seed: int) -> LinkInertia:
    """A ball of 10 cm whose centre lies up to 15 cm from the link's origin, along its axis above all."""
    centre = np.random.default_rng(seed).uniform([-0.04, -0.04, 0.05], [0.04, 0.04, 0.12])
    return LinkInertia(body, max(mass, 1e-12), centre, 0.4 * max(mass, 1e-12) * 0.05**2 * np.eye(3))


def _dynamic(body: LinkInertia) -> FloatArray:
    inertia = pin.Inertia(body.mass, body.com, body.inertia)
    return np.asarray(inertia.toDynamicParameters())


def _direction(seed: int) -> FloatArray:
    direction = np.random.default_rng(seed + 7).standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction))


def accuracy(names: list[str], seeds: list[int], folder: Path, lacking: float = 0.0, friction: bool = False) -> Table:
    """Errors by robot, seed and kind of feed-forward."""
    table = Table("robot", "seed", "efforts", "before", "first 1 s", "carrying")
    for name in names:
        for seed in seeds:
            robot = Robot(name, seed, folder, lacking, friction)
            model = robot.model()(robot.commanded)
            found = {
                "PD alone": robot.run(None),
                "URDF": robot.run(robot.from_urdf),
                "identified": robot.run(model),
                **{
                    f"+ adaptation, {label}": robot.run(model, robot.adapting(link))
                    for label, link in (("500 Hz, 2 ms", FAST), ("100 Hz, 10 ms", SLOW), ("100 Hz, 30 ms", LATE))
                },
            }
            for kind, run in found.items():
                latched = run.adapting is not None and np.isfinite(run.adapting.latched)
                says = f" ({run.adapting.correction.latch.reason})" if latched else ""
                table.add_row(robot.name, str(seed), kind + says, *(f"{error:.3g}" for error in run.errors))
    return table


def stability(names: list[str], count: int, folder: Path) -> Table:
    """The worst of so many seeds."""
    table = Table("robot", "adaptation", "first 1 s", "carrying", "switched off", "least eigenvalue ratio")
    for name in names:
        robots = [Robot(name, seed, folder) for seed in range(1, count + 1)]
        for label, link in (("100 Hz, 10 ms", SLOW), ("100 Hz, 30 ms", LATE)):
            runs = [robot.run(robot.model()(robot.commanded), robot.adapting(link)) for robot in robots]
            _, first, carrying = np.max([run.errors for run in runs], axis=0)
            own = [run.adapting for run in runs if run.adapting is not None]
            off = sum(np.isfinite(adapting.latched) for adapting in own)
            least = min(adapting.smallest for adapting in own)
            table.add_row(Path(name).stem, label, f"{first:.3g}", f"{carrying:.3g}", str(off), f"{least:.2g}")
    return table


@dataclass(frozen=True)
class Mishap:
    """What goes wrong: in the ``link``, with a payload of so much ``mass`` and ``prior`` [kg], under a ``push`` [N]."""

    link: Link = SLOW
    mass: float = 1.5
    prior: float = 0.0
    push: float = 0.0


MISHAPS = {
    "sensor frozen": Mishap(replace(SLOW, frozen=True)),
    "sensor silent": Mishap(replace(SLOW, stop=True)),
    "100 ms late": Mishap(replace(SLOW, late=100)),
    "contact, 40 N": Mishap(push=40.0),
    "10 kg, saturated": Mishap(mass=10.0),
    "model has 3 kg too much": Mishap(prior=3.0),
}


def worst(names: list[str], seeds: list[int], folder: Path) -> Table:
    """Errors in mishaps, and the largest since the payload is there, against PD alone in the same."""
    table = Table("robot", "seed", "mishap", "PD alone", "adapting", "largest: PD alone", "adapting", "largest share")
    for heading in ("off after", "after the first saturation", "saturated: PD alone", "adapting", "reason"):
        table.add_column(heading)
    for name in names:
        for seed in seeds:
            robot = Robot(name, seed, folder)
            for label, mishap in MISHAPS.items():
                alone = robot.run(None, mass=mishap.mass, push=mishap.push)
                adapting = robot.adapting(mishap.link, mishap.prior)
                forward = robot.model(mishap.prior)(robot.commanded)
                run = robot.run(forward, adapting, mishap.mass, mishap.push)
                share = np.max(np.abs(adapting.added) / robot.limits)
                begin = _PICKED if mishap.mass > HEAVIEST else _MISHAP
                shown, lasted = run.saturated_since(begin)
                table.add_row(
                    robot.name,
                    str(seed),
                    label,
                    *(f"{each:.3g}" for each in (alone.mishap, run.mishap, alone.largest, run.largest)),
                    f"{share:.2f}",
                    f"{adapting.latched - begin:.2f}",
                    f"{adapting.latched - shown:.2f}" if np.isfinite(shown) else "not saturated",
                    *(f"{each:.2f}" for each in (alone.saturated_since(begin)[1], lasted)),
                    adapting.correction.latch.reason,
                )
    return table


def endurance(names: list[str], seconds: float, folder: Path) -> Table:
    """Whether a body stays possible for so long, whatever the errors are."""
    table = Table("robot", "steps", "that moved the body", "after which it is impossible", "least eigenvalue ratio")
    for name in names:
        found = endure(name, seconds, HEAVIEST, folder)
        counts = found.steps, found.moved, found.impossible
        table.add_row(Path(name).stem, *map(str, counts), f"{found.least:.2g}")
    return table


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.adaptation", description=__doc__)
    parser.add_argument("--robots", nargs="+", default=["panda.urdf", "ur5_robot.urdf"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--lacking", type=float, default=0.0, help="share of the friction that the model has not")
    parser.add_argument("--friction", action="store_true", help="friction adapts, too")
    parser.add_argument("--stability", type=int, metavar="SEEDS", help="the worst of so many seeds")
    parser.add_argument("--worst", action="store_true", help="mishaps")
    parser.add_argument("--endurance", type=float, metavar="SECONDS", help="random errors at 500 Hz for so long")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.endurance:
            table = endurance(arguments.robots, arguments.endurance, folder)
        elif arguments.stability:
            table = stability(arguments.robots, arguments.stability, folder)
        elif arguments.worst:
            table = worst(arguments.robots, arguments.seeds, folder)
        else:
            table = accuracy(arguments.robots, arguments.seeds, folder, arguments.lacking, arguments.friction)
    Console(width=200).print(table)


if __name__ == "__main__":
    main()
