"""From options to a bag and its truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.simulation.bag import write_bag
from geomid_ros.simulation.effects.measurement import sensed
from geomid_ros.simulation.effects.physics import TrueEffect
from geomid_ros.simulation.motion import RunTrace, exciting_motion
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.realistic.loop import RealisticLoop
from geomid_ros.simulation.realistic.robot import RealisticRobot, build_realistic
from geomid_ros.simulation.realistic.sensors import published
from geomid_ros.simulation.realistic.truth import realistic_document
from geomid_ros.simulation.recorder import ControlLoop, Sampling, check_motion, run, slowed, tuned_controller
from geomid_ros.simulation.robot import Builder, TrueRobot, build_robot, measured
from geomid_ros.simulation.seeds import RandomStream, generator
from geomid_ros.simulation.truth import contributions, controller_path, truth_path, write_gains, write_truth

Progress = Callable[[float], None]


@dataclass(frozen=True)
class SimulationResult:
    """What was written: the bag's folder, the truth's file, with commands the controller's; ``samples`` per topic."""

    bag: Path
    truth: Path
    controller: Path | None
    samples: int


def simulate(
    out_bag: Path | str,
    options: SimulationOptions | None = None,
    progress: Progress | None = None,
    builder: Builder = Plant,
) -> SimulationResult:
    """Record a simulated robot; the same options give the same messages.

    Args:
        out_bag: New folder for the bag. The truth goes to ``<out_bag>.truth.json`` beside it, and with
            ``options.commands`` the controller's gains to ``<out_bag>.controller.yaml``.
        options: What to simulate.
        progress: Called with the finished fraction, 0 to 1.
        builder: Chooses the simulator.

    Raises:
        InputError: A file exists already, or the robot or the motion cannot be simulated.
    """
    options = options or SimulationOptions()
    bag = Path(out_bag)
    truth, gains = truth_path(bag), controller_path(bag) if options.commands else None
    for path in filter(None, (bag, truth, gains)):
        if path.exists():
            raise InputError(f"{path} exists already. Choose another name or delete it first.")
    robot: TrueRobot = build_realistic(options) if options.realistic else build_robot(options, builder)
    loop = closed_loop(robot, options)
    true_trace = record(robot, loop, options, progress)
    trace = seen(true_trace, robot, options)
    order = generator(options.seed, RandomStream.ORDER).permutation(len(robot.joints))
    names = [robot.plant.joints[index] for index in order]
    write_bag(bag, trace.reordered(order), names, robot.nominal.text, options)
    more = realistic_document(robot) if isinstance(robot, RealisticRobot) else {}
    write_truth(truth, robot, options, contributions(true_trace, robot, options), more)
    if gains is not None:
        write_gains(gains, robot.plant.joints, loop.controller)
    return SimulationResult(bag, truth, gains, len(trace.time))


def closed_loop(robot: TrueRobot, options: SimulationOptions) -> ControlLoop:
    """The robot with a controller that knows the nominal model only."""
    half_steps = np.arange(2 * sampling(robot, options).steps + 1, dtype=np.float64)
    numbers = generator(options.recording_seed, RandomStream.MOTION)
    motion = exciting_motion(0.5 * options.step * half_steps, robot.joints, options, numbers)
    nominal = Plant(robot.nominal, robot.nominal.inertias)
    public = options.realistic or options.hide is not None  # gains that reveal nothing of the truth
    tuned_on = nominal if public else robot.plant
    controller = tuned_controller(motion, nominal, robot.plant, robot.joints, tuned_on)
    controller = slowed(controller, robot.plant, options.step)
    if isinstance(robot, RealisticRobot):
        return RealisticLoop(robot.plant, controller, options.step, robot)
    return ControlLoop(robot.plant, controller, options.step)


def record(
    robot: TrueRobot, loop: ControlLoop, options: SimulationOptions, progress: Progress | None = None
) -> RunTrace:
    """The true motion at the recorded instants, before sensors."""
    trace = run(loop, sampling(robot, options), progress)
    check_motion(trace, robot.joints)
    return trace


def seen(trace: RunTrace, robot: TrueRobot, options: SimulationOptions) -> RunTrace:
    """What the robot publishes of the true motion."""
    if not isinstance(robot, RealisticRobot):
        return measured(trace, robot, options)
    numbers = generator(options.recording_seed, RandomStream.NOISE)
    return published(sensed(trace, robot.plant.joints, robot.effects), robot.sensors, numbers)


def sampling(robot: TrueRobot, options: SimulationOptions) -> Sampling:
    """Which steps of the integration are recorded; it runs on for as long as the sensors look ahead."""
    lag = round(options.wrench_lag / options.step)
    early = -min(effect.parameters.get("delay", 0.0) for effect in (*robot.effects, TrueEffect("", "", {})))
    return Sampling(options.samples, options.substeps, lag, max(lag, math.ceil(early / options.step)))
