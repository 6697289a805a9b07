"""The controller's gains, as ros2_control's joint_trajectory_controller has them among its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import yaml

from geomid_ros.simulation.recorder import Controller


def controller_path(bag: Path) -> Path:
    """Where the gains lie: ``arm7.controller.yaml`` beside ``arm7``."""
    return bag.with_name(bag.name + ".controller.yaml")


def write_gains(path: Path, joints: Sequence[str], controller: Controller) -> None:
    """Write ``p`` [N m/rad] and ``d`` [N m s/rad] of every joint.

    The commanded effort is the recorded feed-forward plus ``p`` times the error of position plus ``d`` times that of
    velocity, of the motors; set-points between two messages are to be interpolated.
    """
    rows = zip(joints, controller.stiffness.tolist(), controller.damping.tolist(), strict=True)
    gains = {joint: {"p": stiffness, "i": 0.0, "d": damping} for joint, stiffness, damping in rows}
    parameters = {"joints": list(joints), "gains": gains}
    document = {"joint_trajectory_controller": {"ros__parameters": parameters}}
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
