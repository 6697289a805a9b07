"""Robots simulated by MuJoCo that record rosbags: planted truth for demonstrations and tests.

The bag holds only what a real robot would publish; the truth goes into a file beside it. Nothing here shares code with
the estimator, and MuJoCo is imported when a simulation starts, not before.
"""

from geomid_ros.simulation.options import JointEffect, SimulationOptions
from geomid_ros.simulation.robots import WRIST_FRAME, robot_names
from geomid_ros.simulation.simulate import SimulationResult, simulate

__all__ = ["WRIST_FRAME", "JointEffect", "SimulationOptions", "SimulationResult", "robot_names", "simulate"]
