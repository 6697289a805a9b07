"""The recipe of the bags in this folder. `python bags/make_bags.py FOLDER` records them again (by default: here)."""

from __future__ import annotations

import sys
from pathlib import Path

from geomid_ros.simulation.description import WRIST_FRAME, robot_description
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate

RECIPES = {
    "arm7": SimulationOptions(robot="arm7", seed=1, duration=12.0, rate=100.0, wrench_frame=WRIST_FRAME),
    "arm3": SimulationOptions(robot="arm3", seed=2, duration=8.0, rate=100.0, wrench_frame=WRIST_FRAME),
}


def make_bags(folder: Path) -> None:
    """Record every recipe into ``folder``, where none of its bags may exist yet, and put the URDFs beside them."""
    for name, options in RECIPES.items():
        simulate(folder / name, options)
        (folder / f"{name}.urdf").write_text(robot_description(options.robot), encoding="utf-8")


if __name__ == "__main__":
    make_bags(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
