"""Simulations shared by the tests of this folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from geomid_ros.simulation.description import WRIST_FRAME
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import contributions, control_loop, record, write_truth
from geomid_ros.simulation.robot import TrueRobot, build_robot

from .independent import Independent


@dataclass(frozen=True)
class Run:
    """One simulation, noise-free, and what pinocchio makes of its truth file."""

    robot: TrueRobot
    trace: RunTrace
    independent: Independent


def simulated(options: SimulationOptions, folder: Path) -> Run:
    """Run a simulation and read its truth file, written into ``folder``, by the independent route."""
    robot = build_robot(options)
    trace = record(robot, control_loop(robot, options), options)
    write_truth(folder / "truth.json", robot, options, contributions(trace, robot, options))
    return Run(robot, trace, Independent.read(robot.nominal.text, folder / "truth.json"))


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The large arm for five seconds."""
    pytest.importorskip("mujoco")
    options = SimulationOptions(robot="arm7", seed=3, duration=5.0, wrench_frame=WRIST_FRAME)
    return simulated(options, tmp_path_factory.mktemp("truth"))
