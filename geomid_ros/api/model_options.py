"""The options of each function that uses a model, and of its command."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

from geomid_ros.options import Options, option
from geomid_ros.session.options import DescriptionOptions, PackageOptions, PathLike, Texts

if TYPE_CHECKING:
    from geomid_ros.excitation.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class FillOptions(DescriptionOptions):
    """How exact the efforts of a trajectory are.

    Attributes:
        urdf: robot description, URDF or .xacro. [default: identified.urdf beside the model]
        tolerance: largest error of linearly interpolated efforts, as a share of the joint's largest effort.
        force: take a model whose verdict is not 'usable', too.
    """

    tolerance: float = option(0.01, min=0.0, min_open=True, max=1.0, max_open=True, metavar="SHARE")
    force: bool = False


@dataclass(frozen=True)
class GivenTrajectory(Options):
    """A motion and a model.

    Attributes:
        trajectory: a ``trajectory_msgs/JointTrajectory``: YAML, as 'geomid excite' writes or 'ros2 topic echo' prints
            it, or a rosbag.
        model: an estimate.json; None for the URDF alone.
    """

    trajectory: PathLike | Trajectory
    model: PathLike | None


@dataclass(frozen=True, kw_only=True)
class FeedforwardOptions(FillOptions, GivenTrajectory):
    """Which trajectory, and how exact its efforts are.

    Attributes:
        topic: topic of the trajectory, if TRAJECTORY is a bag with several.
    """

    topic: str | None = option(metavar="TOPIC")


@dataclass(frozen=True)
class ExportOptions(PackageOptions):
    """A payload to export, or how.

    Attributes:
        model: an estimate.json with its identified.urdf beside it, or a URDF.
        tool: who is to read it: ur, franka, urdf, moveit, isaac, gazebo, drake or mujoco.
        frame: the flange: the payload is this link and all links after it, in its axes. [default: for ur and franka
            the one link whose name ends with tool0 or link8]
        links: the payload is these links.
        without: model of the robot without the payload (estimate.json or URDF); the payload is the difference.
        into: for mujoco: print this file with the identified values of the bodies and joints of the same names; the
            rest is unchanged.
        force: export a model whose verdict is not 'usable', too.
    """

    model: PathLike
    tool: str
    _: KW_ONLY
    frame: str | None = option(metavar="LINK")
    links: Texts | None = None
    without: PathLike | None = None
    into: PathLike | None = option(metavar="MJCF")
    force: bool = False


@dataclass(frozen=True)
class SampleOptions(PackageOptions):
    """Which robots to draw.

    Attributes:
        model: an estimate.json with the identified.urdf and the posterior.npz of the same run beside it.
        tool: who is to read them: urdf, moveit, isaac, gazebo, drake, mujoco or json.
        count: number of robots.
        into: for mujoco: write this file with each robot's numbers for the bodies and joints of the same names; the
            rest is unchanged.
        spread: factor on all standard deviations.
        seed: random seed; the same seed gives the same robots.
    """

    model: PathLike
    tool: str
    _: KW_ONLY
    count: int = option(100, flag="-n", min=1, max=100_000)
    into: PathLike | None = option(metavar="MJCF")
    spread: float = option(1.0, min=0.0, min_open=True, max=3.0)
    seed: int = option(0, min=0)
