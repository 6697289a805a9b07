"""Recording of a simulated robot: from options to a bag, and to separate files with the planted truth, which is not in
the bag, and with the controller's gains."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from geomid_ros.errors import InputError
from geomid_ros.simulation.bag import write_bag
from geomid_ros.simulation.description import LinkInertia
from geomid_ros.simulation.effects import noiseless_measurement
from geomid_ros.simulation.motion import RunTrace, exciting_motion
from geomid_ros.simulation.options import RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import GRAVITY, Plant
from geomid_ros.simulation.realistic import build_realistic
from geomid_ros.simulation.robot import (
    Builder,
    ControlLoop,
    JointController,
    Sampling,
    TrueRobot,
    build_robot,
    check_motion,
    run,
    tuned_controller,
)
from geomid_ros.types import FloatArray

Progress = Callable[[float], None]


@dataclass(frozen=True)
class SimulationResult:
    """Written files: the bag's folder, the truth and, with commands, the controller's gains; ``samples`` per topic."""

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
        out_bag: New folder for the bag. The truth goes to ``<out_bag>.truth.json`` next to it, and with
            ``options.commands`` the controller's gains to ``<out_bag>.controller.yaml``.
        options: Robot, motion and sensors to simulate.
        progress: Called with the finished fraction, 0 to 1.
        builder: Builds the simulator.

    Raises:
        InputError: A file exists already, or the robot or the motion cannot be simulated.
    """
    options = options or SimulationOptions()
    bag = Path(out_bag)
    truth = companion_path(bag, "truth.json")
    gains = companion_path(bag, "controller.yaml") if options.commands else None
    refuse_existing(bag, truth, gains)
    robot = build_realistic(options) if options.realistic else build_robot(options, builder)
    loop = control_loop(robot, options)
    true_trace = record(robot, loop, options, progress)
    trace = robot.published(true_trace, options)
    order = generator(options.seed, RandomStream.ORDER).permutation(len(robot.joints))
    names = [robot.plant.joints[index] for index in order]
    write_bag(bag, trace.reordered(order), names, robot.nominal.text, options)
    write_truth(truth, robot, options, contributions(true_trace, robot, options))
    if gains is not None:
        write_gains(gains, robot.plant.joints, loop.controller)
    return SimulationResult(bag, truth, gains, len(trace.time))


def companion_path(bag: Path, what: str) -> Path:
    """Path of a file about a bag: ``arm7.truth.json`` next to ``arm7``."""
    return bag.with_name(f"{bag.name}.{what}")


def refuse_existing(*paths: Path | None) -> None:
    """Raise InputError if a file or folder would be overwritten."""
    for path in filter(None, paths):
        if path.exists():
            raise InputError(f"{path} exists already. Choose another name or delete it first.")


def control_loop(robot: TrueRobot, options: SimulationOptions) -> ControlLoop:
    """Put the robot under a controller that knows only the nominal model."""
    half_steps = np.arange(2 * sampling(robot, options).steps + 1, dtype=np.float64)
    numbers = generator(options.recording_seed, RandomStream.MOTION)
    motion = exciting_motion(0.5 * options.step * half_steps, robot.joints, options, numbers)
    nominal = Plant(robot.nominal, robot.nominal.inertias)
    truth_is_secret = options.realistic or options.hide is not None  # so the gains must not reveal it
    tuned_on = nominal if truth_is_secret else robot.plant
    controller = tuned_controller(motion, nominal, robot.plant, robot.joints, tuned_on)
    return robot.controlled(controller.slowed(robot.plant, options.step), options.step)


def record(
    robot: TrueRobot, loop: ControlLoop, options: SimulationOptions, progress: Progress | None = None
) -> RunTrace:
    """Simulate the true motion at the recorded samples, before sensors."""
    trace = run(loop, sampling(robot, options), progress)
    check_motion(trace, robot.joints)
    return trace


def sampling(robot: TrueRobot, options: SimulationOptions) -> Sampling:
    """Integration steps to record. The run continues for as long as the sensors look ahead."""
    lag = round(options.wrench_lag / options.step)
    lead = -min((effect.parameters.get("delay", 0.0) for effect in robot.effects), default=0.0)
    return Sampling(options.samples, options.substeps, lag, max(lag, math.ceil(lead / options.step)))


def contributions(trace: RunTrace, robot: TrueRobot, options: SimulationOptions) -> dict[str, FloatArray]:
    """RMS of the effects' contributions to the measured efforts ``(n,)`` and wrench ``(6,)`` or ``(0,)``.

    It is the difference between the readings of perfect sensors and the efforts that the true bodies alone would need
    at the motors' positions. Other inertias could explain a part of it.
    """
    bare = Plant(robot.nominal, robot.bodies, (), options.wrench_frame)
    efforts, wrenches = [], []
    for row in zip(trace.position, trace.velocity, trace.acceleration, strict=True):
        efforts.append(bare.inverse_dynamics(*row))
        bare.acceleration(*row[:2], efforts[-1])
        wrenches.append(bare.wrench())
    measured = noiseless_measurement(trace, robot.plant.joints, robot.effects)
    columns = [np.interp(trace.wrench_time, trace.time, column) for column in np.array(wrenches).T]
    wrench = measured.wrench - np.reshape(columns, (-1, len(trace.time))).T
    return {"effort": _rms(measured.effort - np.array(efforts)), "wrench": _rms(wrench)}


def _rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def write_truth(path: Path, robot: TrueRobot, options: SimulationOptions, added: Mapping[str, FloatArray]) -> None:
    """Write the truth of the robot in a recording: links, effects, the noise of each channel, and the options.

    A link fixed to another has a separate entry; one that no joint moves (``moves`` false) cannot show in the data.
    ``added`` are the effects' contributions, see :func:`contributions`.
    """
    truth = {
        "robot": options.robot,
        "seed": options.seed,
        "motion_seed": options.recording_seed,
        "gravity": [0.0, 0.0, -GRAVITY],
        "links": [link_entry(body, robot.nominal.moved_by(body.name) is not None) for body in robot.bodies],
        "contributions": {channel: values.tolist() for channel, values in added.items()},
        "joints": robot.plant.joints,
        "noise": {channel: level.tolist() for channel, level in robot.noise(options).items()},
        "options": asdict(options),
        **robot.document(),
    }
    path.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def link_entry(body: LinkInertia, moves: bool) -> dict[str, Any]:
    """Entry of a link in a file."""
    return {name: np.asarray(value).tolist() for name, value in vars(body).items()} | {"moves": moves}


def write_gains(path: Path, joints: Sequence[str], controller: JointController) -> None:
    """Write ``p`` [N m/rad] and ``d`` [N m s/rad] of every joint, as a joint_trajectory_controller's parameters.

    The commanded effort is the recorded feed-forward, plus ``p`` times the motors' position error, plus ``d`` times
    their velocity error. Set-points between two messages are to be interpolated.
    """
    rows = zip(joints, controller.stiffness.tolist(), controller.damping.tolist(), strict=True)
    gains = {joint: {"p": stiffness, "i": 0.0, "d": damping} for joint, stiffness, damping in rows}
    parameters = {"joints": list(joints), "gains": gains}
    document = {"joint_trajectory_controller": {"ros__parameters": parameters}}
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
