"""What is written beside a bag: the planted truth, of which nothing is in the bag, and the controller's gains."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from geomid_ros.simulation.description import LinkInertia
from geomid_ros.simulation.effects.measurement import sensed
from geomid_ros.simulation.effects.physics import TrueEffect
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.plant import GRAVITY, Plant
from geomid_ros.simulation.recorder import JointController
from geomid_ros.simulation.robot import TrueRobot, noise_levels
from geomid_ros.types import FloatArray


def truth_path(bag: Path) -> Path:
    """Where the truth about a bag lies: ``arm7.truth.json`` beside ``arm7``."""
    return bag.with_name(bag.name + ".truth.json")


def contributions(trace: RunTrace, robot: TrueRobot, options: SimulationOptions) -> dict[str, FloatArray]:
    """Root mean square of what the effects add to the measured efforts ``(n,)`` and wrench ``(6,)`` or ``(0,)``.

    It is the difference between what perfect sensors show and what the true bodies alone would need at the motors'
    positions; other inertias could explain a part of it.
    """
    bare = Plant(robot.nominal, robot.bodies, (), options.wrench_frame)
    efforts, wrenches = [], []
    for row in zip(trace.position, trace.velocity, trace.acceleration, strict=True):
        efforts.append(bare.inverse_dynamics(*row))
        bare.acceleration(*row[:2], efforts[-1])
        wrenches.append(bare.wrench())
    seen = sensed(trace, robot.plant.joints, robot.effects)
    columns = [np.interp(trace.wrench_time, trace.time, column) for column in np.array(wrenches).T]
    wrench = seen.wrench - np.reshape(columns, (-1, len(trace.time))).T
    return {"effort": _rms(seen.effort - np.array(efforts)), "wrench": _rms(wrench)}


def _rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def write_truth(
    path: Path,
    robot: TrueRobot,
    options: SimulationOptions,
    added: Mapping[str, FloatArray],
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write what is true of the robot in a recording: links, effects, the noise of each channel, and the options.

    A link fixed to another one stands by itself; one that no joint moves (``moves`` false) cannot show in the data.
    ``added`` is what the effects contribute, see :func:`contributions`; ``more`` is written as it is,
    in place of what is here where the names are the same.
    """
    truth = {
        "robot": options.robot,
        "seed": options.seed,
        "motion_seed": options.recording_seed,
        "gravity": [0.0, 0.0, -GRAVITY],
        "links": [link_entry(body, robot.plant.moves(body.name)) for body in robot.bodies],
        "effects": [effect_document(effect) for effect in robot.effects],
        "contributions": {channel: values.tolist() for channel, values in added.items()},
        "joints": robot.plant.joints,
        "noise": {channel: level.tolist() for channel, level in noise_levels(robot.joints, options).items()},
        "options": asdict(options),
        **(more or {}),
    }
    path.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def effect_document(effect: TrueEffect) -> dict[str, Any]:
    """An effect, its places and its parameters."""
    places = {"joint": effect.joint, "link": effect.link, "other": effect.other}
    named = {key: name for key, name in places.items() if name or key == "joint"}
    return {"effect": effect.name, **named, "parameters": dict(effect.parameters)}


def link_entry(body: LinkInertia, moves: bool) -> dict[str, Any]:
    return {
        "name": body.name,
        "mass": body.mass,
        "com": body.com.tolist(),
        "inertia": body.inertia.tolist(),
        "moves": moves,
    }


def controller_path(bag: Path) -> Path:
    """Where the gains lie: ``arm7.controller.yaml`` beside ``arm7``."""
    return bag.with_name(bag.name + ".controller.yaml")


def write_gains(path: Path, joints: Sequence[str], controller: JointController) -> None:
    """Write ``p`` [N m/rad] and ``d`` [N m s/rad] of every joint, as a joint_trajectory_controller's parameters.

    The commanded effort is the recorded feed-forward plus ``p`` times the error of position plus ``d`` times that of
    velocity, of the motors; set-points between two messages are to be interpolated.
    """
    rows = zip(joints, controller.stiffness.tolist(), controller.damping.tolist(), strict=True)
    gains = {joint: {"p": stiffness, "i": 0.0, "d": damping} for joint, stiffness, damping in rows}
    parameters = {"joints": list(joints), "gains": gains}
    document = {"joint_trajectory_controller": {"ros__parameters": parameters}}
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
