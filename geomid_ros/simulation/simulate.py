"""From options to a bag and its truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.simulation.bag import write_bag
from geomid_ros.simulation.motion import exciting_motion
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.recorder import ClosedLoop, Trace, check_motion, run, tuned_controller
from geomid_ros.simulation.robot import Robot, build_robot
from geomid_ros.simulation.seeds import Stream, generator
from geomid_ros.simulation.sensors import measured
from geomid_ros.simulation.truth import truth_path, write_truth

Progress = Callable[[float], None]


@dataclass(frozen=True)
class SimulationResult:
    """What was written: the bag's folder and the truth's file; ``samples`` per topic."""

    bag: Path
    truth: Path
    samples: int


def simulate(
    out_bag: Path | str, options: SimulationOptions | None = None, progress: Progress | None = None
) -> SimulationResult:
    """Record a simulated robot into the new folder ``out_bag``, and its truth into ``<out_bag>.truth.json`` beside it.

    ``progress`` is called with the finished fraction, 0 to 1. The same options give the same messages.
    """
    options = options or SimulationOptions()
    bag, truth = Path(out_bag), truth_path(Path(out_bag))
    for path in (bag, truth):
        if path.exists():
            raise InputError(f"{path} exists already. Choose another name or delete it first.")
    robot = build_robot(options)
    trace = measured(record(robot, options, progress), robot, options)
    order = generator(options.seed, Stream.ORDER).permutation(len(robot.joints))
    names = [robot.plant.joints[index] for index in order]
    write_bag(bag, trace.reordered(order), names, robot.nominal.text, options.wrench_frame)
    write_truth(truth, robot, options)
    return SimulationResult(bag, truth, options.samples)


def record(robot: Robot, options: SimulationOptions, progress: Progress | None = None) -> Trace:
    """What truly happens at the recorded instants while the robot follows its motion; sensors come later."""
    step = 1.0 / (options.rate * options.substeps)
    half_steps = np.arange(2 * (options.samples - 1) * options.substeps + 1, dtype=np.float64)
    numbers = generator(options.recording_seed, Stream.MOTION)
    motion = exciting_motion(0.5 * step * half_steps, robot.joints, options, numbers)
    nominal = Plant(robot.nominal, robot.nominal.inertias)
    controller = tuned_controller(motion, nominal, robot.plant, robot.joints)
    trace = run(ClosedLoop(robot.plant, controller, step), options.substeps, progress)
    check_motion(trace, robot.joints)
    return trace
