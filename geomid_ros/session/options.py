"""Options for robots, recordings and motions: keywords of the functions and options of the commands."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from geomid_ros.errors import InputError
from geomid_ros.options import Options, Progress, option, silent

if TYPE_CHECKING:
    from geomid_ros.session.configuration import Configuration

PathLike: TypeAlias = str | Path
"""The path of a file or a folder."""
Paths: TypeAlias = PathLike | Sequence[PathLike]
"""One path or several."""
Texts: TypeAlias = str | Sequence[str]
"""One text or several."""
Packages: TypeAlias = Mapping[str, Path] | None
"""Folders of ROS packages, by name."""
Config: TypeAlias = "PathLike | Mapping[str, Any] | Configuration"
"""A parameter file (YAML), or parameters by their full names, as in ``{"filter.cutoff": 8.0}``."""
Gains: TypeAlias = float | str | Sequence[float | str] | Mapping[str, float]
"""Factor of all joints' efforts, ``[JOINT=]FACTOR`` as on the command line, several of these, or by joint."""


def paths(given: Paths) -> list[Path]:
    """Return one path or several as a list. Raises InputError for anything else."""
    result = [given] if isinstance(given, str | Path) or not isinstance(given, Iterable) else list(given)
    if wrong := [path for path in result if not isinstance(path, str | Path)]:
        raise InputError(f"{wrong[0]!r} is not a path")
    return [Path(path) for path in result]


def texts(given: Texts) -> list[str]:
    """Return one text or several as a list."""
    return [given] if isinstance(given, str) else list(given)


@dataclass(frozen=True, kw_only=True)
class DescriptionOptions(Options):
    """Description of a robot.

    ``urdf`` may be the text of a description, too; without it, the identified.urdf beside a model is taken, or the
    description in the bags. ``config`` may be parameters by their full names; the other options win over it.

    Attributes:
        urdf: robot description, URDF or .xacro.
        xacro_args: xacro argument.
        config: the node's parameter file (YAML).
        gravity: gravity in the base frame. [default: 0 0 -9.81]
        gain: factor from message efforts to N m (or N), for all joints or one.
        lock: joints that stay at zero.
        wrench: wrench topic; ROLE is mounted or external, -ROLE reverses the sign; AXES as in fz,tx,ty.
    """

    urdf: PathLike | None = field(default=None, kw_only=False)
    xacro_args: Texts = option((), flag="--xacro-arg", metavar="NAME:=VALUE")
    config: Config | None = None
    gravity: Sequence[float] | None = option(metavar="X Y Z", sets="gravity")
    gain: Gains = option((), metavar="[JOINT=]FACTOR")
    lock: Texts | None = option(metavar="JOINTS", sets="locked_joints")
    wrench: Texts = option((), metavar="TOPIC:FRAME:ROLE[:AXES]")


@dataclass(frozen=True, kw_only=True)
class PackageOptions(Options):
    """Location of meshes.

    Attributes:
        package_path: folder of package://NAME, if not above the URDF, in ROS_PACKAGE_PATH or in AMENT_PREFIX_PATH.
    """

    package_path: Packages = None


@dataclass(frozen=True, kw_only=True)
class Surroundings(PackageOptions):
    """Obstacles and clearance.

    Attributes:
        avoid: obstacle: box:X,Y,Z,LENGTH,WIDTH,HEIGHT (X,Y,Z is its centre), plane:NX,NY,NZ,OFFSET (solid below) or a
            mesh file (each part counts as its convex hull), in metres in the base frame.
        clearance: smallest distance between links, and to obstacles [m].
        collision: whether to check for collisions; a URDF without shapes needs --no-collision.
    """

    avoid: Texts = option((), metavar="OBSTACLE")
    clearance: float = option(0.02, min=0.0)
    collision: bool = True


@dataclass(frozen=True, kw_only=True)
class MotionOptions(Surroundings, DescriptionOptions):
    """Options of an exciting motion.

    Attributes:
        wrench: wrench sensor that will be recorded, too; ROLE is mounted or external.
        model: target what this estimate.json left uncertain; posterior.npz must be in the same folder.
        aim: what to identify: prediction (of efforts in other motions), friction, payload or link:NAME.
        discriminate: discriminate between the rival effects of this gap.json.
        limits: joint limits, in the format of MoveIt's joint_limits.yaml.
        duration: total duration [s].
        repeats: number of repetitions.
        speed: largest speed, as a share of the velocity limits.
        start: posture at both ends: one number for each joint, separated by commas.
        seed: random seed; another seed finds another motion.
        progress: called with the current stage and its completed share, 0 to 1.
    """

    model: PathLike | None = option(flag="--from", file="estimate.json")
    aim: str = option("prediction", flag="--for", metavar="AIM")
    discriminate: PathLike | None = option(earlier="--settle", file="gap.json")
    limits: PathLike | None = None
    duration: float = option(20.0, min=2.0, max=600.0)
    repeats: int = option(2, min=1, max=20)
    speed: float = option(0.5, min=0.0, min_open=True, max=1.0)
    start: Sequence[float] = option((), metavar="Q")
    seed: int = 0
    progress: Progress = silent


@dataclass(frozen=True, kw_only=True)
class RunOptions(Surroundings):
    """Controller of the robot, and limits that stop it.

    Attributes:
        controller: controller that follows the motion.
        joint_topic: topic of the joint states.
        tolerance: stop if a joint is this far off its trajectory [rad, m].
        silence: stop if no joint states arrive for this time [s].
            [default: 0.04, or three of their periods if that is longer]
    """

    controller: str = "/joint_trajectory_controller"
    joint_topic: str = "joint_states"
    tolerance: float = option(0.1, min=0.0, min_open=True)
    silence: float | None = option(min=0.0, min_open=True)
