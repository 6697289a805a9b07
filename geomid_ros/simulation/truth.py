"""The planted truth, as a file beside the bag; nothing of it is in the bag."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from geomid_ros.simulation.description import LinkInertia
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.plant import GRAVITY
from geomid_ros.simulation.robot import Robot
from geomid_ros.simulation.sensors import noise_levels


def truth_path(bag: Path) -> Path:
    """Where the truth about a bag lies: ``arm7.truth.json`` beside ``arm7``."""
    return bag.with_name(bag.name + ".truth.json")


def write_truth(path: Path, robot: Robot, options: SimulationOptions) -> None:
    """Write what is true of the robot in a recording: links, effects, the noise of each channel, and the options.

    A link fixed to another one stands by itself; one that no joint moves (``moves`` false) cannot show in the data.
    """
    truth = {
        "robot": options.robot,
        "seed": options.seed,
        "motion_seed": options.recording_seed,
        "gravity": [0.0, 0.0, -GRAVITY],
        "links": [_link(body, robot.plant.moves(body.name)) for body in robot.bodies],
        "effects": [asdict(effect) for effect in robot.effects],
        "joints": robot.plant.joints,
        "noise": {channel: level.tolist() for channel, level in noise_levels(robot.joints, options).items()},
        "options": asdict(options),
    }
    path.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def _link(body: LinkInertia, moves: bool) -> dict[str, Any]:
    return {
        "name": body.name,
        "mass": body.mass,
        "com": body.com.tolist(),
        "inertia": body.inertia.tolist(),
        "moves": moves,
    }
