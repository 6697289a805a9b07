"""How well simulated robots track a trajectory: PD alone, and with efforts of the URDF or of what was identified.

    python -m benchmarks.feedforward [--robots arm7 panda.urdf ur5_robot.urdf] [--seeds 1 2 3] [--realistic]

Each robot is recorded for half a minute and identified. Then it follows another motion, sent as a trajectory of points,
under a controller that adds the trajectory's efforts to its PD, as ros2_controllers' joint_trajectory_controller does;
the true robot is MuJoCo's. Errors are those of the hand, root mean square in mm.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table

import geomid_ros
from benchmarks.blind.case import robot_file
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.simulation.description import robot_description
from geomid_ros.simulation.motion import exciting_motion
from geomid_ros.simulation.options import RandomStream, SimulationOptions, generator
from geomid_ros.simulation.realistic import build_realistic
from geomid_ros.simulation.recording import control_loop, sampling, simulate
from geomid_ros.simulation.robot import ControlLoop, JointController, TrueRobot, build_robot, run
from geomid_ros.types import FloatArray

_POINTS = 0.05  # [s] between the points of the trajectory
_CYCLE = 1e-3  # [s] of the controller
_OTHER_MOTION = 1000  # added to the seed
KINDS = ("PD alone", "URDF", "identified")


@dataclass(frozen=True, eq=False)
class TrajectoryController(JointController):
    """PD at a fixed rate, with the efforts of a trajectory: straight lines between its points."""

    trajectory: Trajectory = field(kw_only=True)
    step: float = field(kw_only=True)
    _held: dict[int, FloatArray] = field(default_factory=dict, init=False)

    def effort(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        cycle = int(half_step * 0.5 * self.step / _CYCLE + 1e-9)
        if cycle not in self._held:
            time, trajectory = cycle * _CYCLE, self.trajectory
            wanted, speed = trajectory.at(time)
            added = [np.interp(time, trajectory.times, own) for own in trajectory.efforts.T]
            feedback = self.stiffness * (wanted - position) + self.damping * (speed - velocity)
            self._held.clear()
            self._held[cycle] = feedback + (np.array(added) if added else 0.0)
        return self._held[cycle]


def tracked(robot: TrueRobot, loop: ControlLoop, options: SimulationOptions, trajectory: Trajectory) -> FloatArray:
    """Positions ``(2, N, joints)`` of the robot and of the trajectory, at the recorded instants."""
    own = loop.controller
    controller = TrajectoryController(
        own.setpoints, own.feedforward, own.stiffness, own.damping, trajectory=trajectory, step=options.step
    )
    trace = run(replace(loop, controller=controller), sampling(robot, options))
    wanted = trajectory.states(trace.time)[0]
    return np.array([trace.position, wanted])


def hand_error(urdf: str, joints: tuple[str, ...], positions: FloatArray) -> float:
    """Root mean square of :func:`hand_distances` [mm]."""
    return float(np.sqrt(np.mean(hand_distances(urdf, joints, positions) ** 2)))


def hand_distances(urdf: str, joints: tuple[str, ...], positions: FloatArray) -> FloatArray:
    """Distances ``(N,)`` [mm], between two motions ``(2, N, joints)``, of a point .1 m from the last joint."""
    model = pin.buildModelFromXML(urdf)
    data, last = model.createData(), model.njoints - 1
    places = [model.joints[model.getJointId(name)].idx_q for name in joints]
    hands = []
    for motion in positions:
        points = []
        for row in motion:
            q = pin.neutral(model)
            q[places] = row
            pin.forwardKinematics(model, data, q)
            frame = data.oMi[last]
            points.append(frame.act(np.array([0.0, 0.0, 0.1])))
        hands.append(points)
    return np.asarray(1e3 * np.linalg.norm(np.diff(hands, axis=0)[0], axis=1))


def described(robot: str, folder: Path) -> str:
    """A shipped robot's name, or the path of a URDF in which fingers do not move: no trajectory says where they are."""
    path = robot_file(robot)
    if path == robot:
        return robot
    tree = ElementTree.parse(path)  # noqa: S314 it is ours
    for joint in tree.findall("joint"):
        if "finger" in joint.get("name", ""):
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    tree.write(folder / Path(path).name)
    return str(folder / Path(path).name)


def errors(robot_name: str, seed: int, realistic: bool, folder: Path, seconds: float = 30.0) -> dict[str, float]:
    """The hand's errors by the kind of feed-forward [mm], in a third of the ``seconds`` that are recorded before."""
    options = SimulationOptions(
        robot=described(robot_name, folder), seed=seed, duration=seconds, rate=200.0, realistic=realistic
    )
    bag = folder / f"{Path(robot_name).stem}_{seed}"
    simulate(bag, options)
    estimate = geomid_ros.identify(bag).save(bag.with_name(f"{bag.name}_estimate"), report=False)[0]
    other = replace(options, motion_seed=seed + _OTHER_MOTION, duration=seconds / 3.0)
    robot = build_realistic(other) if realistic else build_robot(other)
    loop = control_loop(robot, other)
    times = np.arange(0.0, other.duration + 0.5 * _POINTS, _POINTS)
    motion = exciting_motion(times, robot.joints, other, generator(other.recording_seed, RandomStream.MOTION))
    plain = Trajectory(robot.plant.joints, times, motion.position, motion.velocity, motion.acceleration)
    urdf = robot_description(options.robot)
    models = {
        KINDS[0]: plain,
        KINDS[1]: geomid_ros.feedforward(plain, None, urdf=urdf).trajectory,
        KINDS[2]: geomid_ros.feedforward(plain, estimate, force=True).trajectory,
    }
    names = robot.plant.joints
    return {kind: hand_error(urdf, names, tracked(robot, loop, other, sent)) for kind, sent in models.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.feedforward", description=__doc__)
    parser.add_argument("--robots", nargs="+", default=["arm7", "panda.urdf", "ur5_robot.urdf"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--realistic", action="store_true", help="LuGre friction, ripple, delays")
    arguments = parser.parse_args()
    table = Table("robot", "seed", *KINDS, "PD / identified", "URDF / identified")
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.robots:
            for seed in arguments.seeds:
                found = errors(name, seed, arguments.realistic, Path(folder))
                alone, urdf, identified = found.values()
                ratios = (alone / identified, urdf / identified)
                table.add_row(name, str(seed), *(f"{value:.3g}" for value in (*found.values(), *ratios)))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
