"""From a robot description to a motion that identifies much of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from geomid_ros.api.options import DescribedRobot, PathLike, RobotOptions, Texts, texts
from geomid_ros.errors import InputError
from geomid_ros.excitation.learning import PREDICTION
from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.report.excitation import save
from geomid_ros.session import excitation
from geomid_ros.session.collision_scene import Surroundings
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.excitation import Excitation, MotionRequest
from geomid_ros.session.recordings import Progress, silent

_SHORTEST, _LONGEST, _MOST_REPEATS = 2.0, 600.0, 20


@dataclass(frozen=True, eq=False)
class MotionDesign:
    """A designed motion: ``excitation`` has its margins, and what it is expected to identify."""

    excitation: Excitation

    @property
    def trajectory(self) -> Trajectory:
        """The motion as points."""
        return self.excitation.trajectory

    @property
    def sentences(self) -> list[str]:
        """What the motion is expected to identify, in sentences."""
        return list(self.excitation.learning.sentences)

    def save(self, folder: PathLike) -> list[Path]:
        """Write trajectory.yaml, trajectory.csv, trajectory_bag, excitation.json, excitation.png and motion.html.

        Args:
            folder: made if it does not exist.

        Returns:
            The files.

        Raises:
            GeomidError: a file cannot be written.
        """
        return save(self.excitation, Path(folder))


def excite(
    urdf: PathLike | None = None,
    *,
    xacro_args: Texts = (),
    model: PathLike | None = None,
    lock: Texts | None = None,
    wrench: Texts = (),
    aim: str = PREDICTION,
    settle: PathLike | None = None,
    limits: PathLike | None = None,
    duration: float = 20.0,
    repeats: int = 2,
    speed: float = 0.5,
    start: Sequence[float] = (),
    avoid: Texts = (),
    clearance: float = 0.02,
    collision: bool = True,
    package_path: Mapping[str, Path] | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> MotionDesign:
    """Design an exciting trajectory that is feasible at every instant and at rest at both ends.

    ``geomid excite`` calls this; its options have the same names, but ``--for`` for ``aim`` and ``--from`` for
    ``model``.

    Args:
        urdf, xacro_args, lock, wrench: as of :class:`~geomid_ros.RobotOptions`.
        model: an estimate.json with the posterior.npz beside it: what it does not know yet is aimed at.
        aim: prediction (of the efforts in other motions), friction, payload or link:NAME.
        settle: a gap.json whose rivals are to be told apart.
        limits: joint_limits.yaml, as MoveIt has it.
        duration: of all periods together [s].
        repeats: number of periods.
        speed: share of the velocity limits.
        start: where it begins and ends, a number for each joint [rad, m]; found by itself if empty.
        avoid: obstacles: box:X,Y,Z,LENGTH,WIDTH,HEIGHT, plane:NX,NY,NZ,OFFSET or a mesh file, in the base frame [m].
        clearance: least distance of links from each other and from obstacles [m].
        collision: whether collisions are looked for.
        package_path: folders of ROS packages, by name.
        seed: of the search.
        progress: called with what is being done and the share of it, 0 to 1, that is done.

    Raises:
        InputError: a file or an argument cannot be used, or the robot cannot begin.
    """
    _check(duration, repeats, speed, clearance)
    robot, known = robot_to_excite(RobotOptions(urdf=urdf, xacro_args=xacro_args, lock=lock, wrench=wrench), model)
    wish = MotionRequest(
        limits=None if limits is None else Path(limits),
        duration=duration,
        repeats=repeats,
        start=start,
        surroundings=Surroundings(
            avoid=texts(avoid), clearance=clearance, collide=collision, packages=package_path or {}
        ),
        speed=speed,
        aim=aim,
        settle=None if settle is None else Path(settle),
        seed=seed,
    )
    return designed_motion(robot, known, wish, progress)


def _check(duration: float, repeats: int, speed: float, clearance: float) -> None:
    """Refuse numbers that no motion has. Raises InputError."""
    for name, value, valid, expected in (
        ("duration", duration, _SHORTEST <= duration <= _LONGEST, f"from {_SHORTEST:g} to {_LONGEST:g} s"),
        ("repeats", repeats, 1 <= repeats <= _MOST_REPEATS, f"from 1 to {_MOST_REPEATS}"),
        ("speed", speed, 0.0 < speed <= 1.0, "above 0 and up to 1"),
        ("clearance", clearance, 0.0 <= clearance < math.inf, "of 0 m or more"),
    ):
        if not valid:
            raise InputError(f"{name} is {value:g}, expected a number {expected}")


def robot_to_excite(options: RobotOptions, model: PathLike | None) -> tuple[DescribedRobot, Configuration]:
    """The robot to design motions for, and what is known of it. Raises InputError where none is given."""
    if options.urdf is None and model is None:
        raise InputError("no robot is given: add --urdf ROBOT.urdf (or --from estimate.json, with identified.urdf)")
    return options.description([], model), options.configuration(model)


def designed_motion(
    robot: DescribedRobot, known: Configuration, wish: MotionRequest, progress: Progress = silent
) -> MotionDesign:
    """Design a motion as it is wished for, from what is ``known`` of a robot."""
    task = excitation.task_of(robot.text, Path(robot.source), known, wish)
    return MotionDesign(excitation.design(task, wish, progress))
