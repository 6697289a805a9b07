"""Recordings of realistic robots whose motion changes its kind, or that change themselves in mid-motion."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from geomid_ros.files.bags.bag import Bag
from geomid_ros.live.threads import Received
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.simulation.bag import START, write_bag
from geomid_ros.simulation.description import UrdfLimits
from geomid_ros.simulation.motion import FADE_IN, SetPoints, exciting_motion
from geomid_ros.simulation.options import Hidden, RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.realistic import RealisticLoop, RealisticRobot, build_realistic
from geomid_ros.simulation.recording import sampling
from geomid_ros.simulation.robot import JointController, check_motion, run, tuned_controller
from geomid_ros.types import FloatArray

REST = "rest"
"""A part of a motion in which nothing moves; the others are kinds of motion that ``geomid simulate`` knows."""
_NANO = 1_000_000_000

Part: TypeAlias = tuple[str, float]
"""A kind of motion, or :data:`REST`, and how long it lasts [s]."""
Messages: TypeAlias = Iterator[tuple[float, Received]]
"""Joint states and their times since the beginning [s], in the order in which they were recorded."""


@dataclass(frozen=True)
class Change:
    """The robot changes ``at`` a time [s], evenly within ``ramp`` [s], and is what it was from ``until`` [s] on.

    Friction of the ``joint``, all of it, grows by the share ``grows``; or the ``payload`` comes.
    """

    at: float
    ramp: float = 0.0
    joint: str = ""
    grows: float = 0.0
    payload: Hidden | None = None
    until: float = np.inf


@dataclass(eq=False)
class _ChangingLoop(RealisticLoop):
    """Becomes another loop, ``after``, whose bristles are bent as its own."""

    after: RealisticLoop | None = None
    share: Callable[[float], float] = lambda _: 0.0  # of what the other is, at a time [s]

    def acceleration(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        share = self.share(0.5 * half_step * self.step)
        if self.after is None or share == 0.0:
            return super().acceleration(half_step, position, velocity)
        self.after.bend = self.bend
        other = self.after.acceleration(half_step, position, velocity)
        own = super().acceleration(half_step, position, velocity)  # last: the bristles are bent by its dry friction
        return own + share * (other - own)


def messages(options: SimulationOptions, parts: Sequence[Part], change: Change | None = None) -> Messages:
    """What a realistic robot publishes in a motion of these ``parts``, as long as ``options.duration``."""
    robot = build_realistic(options)
    loop = _loop(robot, options, parts)
    if change is not None:
        loop = replace(loop, after=_after(loop, options, change), share=_share(change))
    trace = run(loop, sampling(robot, options))
    check_motion(trace, robot.joints)
    seen = robot.published(trace, options)
    with tempfile.TemporaryDirectory(prefix="geomid_") as folder:
        bag = Path(folder) / "bag"
        write_bag(bag, seen, robot.plant.joints, robot.nominal.text, options)
        with Bag(bag) as recorded:
            for _, stamp, _, data in recorded.raw_messages(["/" + JOINT_STATES]):
                yield (stamp - START * _NANO) / _NANO, Received(JOINT_STATES, data, time.perf_counter())


def _loop(robot: RealisticRobot, options: SimulationOptions, parts: Sequence[Part]) -> _ChangingLoop:
    """Under a controller that knows the nominal model only."""
    nominal = Plant(robot.nominal, robot.nominal.inertias)
    setpoints = _motion(2 * sampling(robot, options).steps + 1, robot.joints, options, parts)
    controller: JointController = tuned_controller(setpoints, nominal, robot.plant, robot.joints, nominal)
    return _ChangingLoop(robot.plant, controller.slowed(robot.plant, options.step), options.step, robot)


def _after(loop: RealisticLoop, options: SimulationOptions, change: Change) -> RealisticLoop:
    """The loop of the changed robot."""
    robot = loop.truth
    if change.payload is not None:
        robot = build_realistic(replace(options, hide=(change.payload,)))
    else:
        factor = 1.0 + change.grows * np.equal(robot.plant.joints, change.joint)
        own = robot.friction
        scaled = ("level", "excess", "stiffness", "damping", "viscous")  # the bristles bend as before, and push more
        robot = replace(robot, friction=replace(own, **{name: factor * getattr(own, name) for name in scaled}))
    return RealisticLoop(robot.plant, loop.controller, loop.step, robot)


def _share(change: Change) -> Callable[[float], float]:
    def share(time: float) -> float:
        if time >= change.until:
            return 0.0
        return min(max((time - change.at) / max(change.ramp, 1e-9), 0.0), 1.0)

    return share


def _motion(count: int, joints: Sequence[UrdfLimits], options: SimulationOptions, parts: Sequence[Part]) -> SetPoints:
    """Set-points ``(count, n)`` half a step apart; each part begins and ends at rest in the middle of the ranges."""
    rng = generator(options.recording_seed, RandomStream.MOTION)
    half = np.float64(0.5 * options.step)
    moved = [_part(kind, half * np.arange(round(time / half)), joints, options, rng) for kind, time in parts]
    moved.append(_at_rest(max(count - sum(len(each.position) for each in moved), 0), joints))
    columns = zip(*(vars(each).values() for each in moved), strict=True)
    return SetPoints(*(np.concatenate(column)[:count] for column in columns))


def _part(
    kind: str, times: FloatArray, joints: Sequence[UrdfLimits], options: SimulationOptions, rng: np.random.Generator
) -> SetPoints:
    rest = _at_rest(len(times), joints)
    if kind == REST:
        return rest
    motion = exciting_motion(times, joints, replace(options, motion=kind), rng)
    x = np.clip((times[-1] - times[:, None]) / FADE_IN, 0.0, 1.0)
    fade = x**3 * (6.0 * x**2 - 15.0 * x + 10.0)
    rate = -30.0 * x**2 * (x - 1.0) ** 2 / FADE_IN
    rise = 60.0 * x * (2.0 * x**2 - 3.0 * x + 1.0) / FADE_IN**2
    moved = motion.position - rest.position
    return SetPoints(
        rest.position + fade * moved,
        rate * moved + fade * motion.velocity,
        rise * moved + 2.0 * rate * motion.velocity + fade * motion.acceleration,
    )


def _at_rest(count: int, joints: Sequence[UrdfLimits]) -> SetPoints:
    centre = np.array([joint.centre for joint in joints])
    return SetPoints(np.tile(centre, (count, 1)), np.zeros((count, len(joints))), np.zeros((count, len(joints))))
