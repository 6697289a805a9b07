"""Options of each function and of its command, and of the robots, recordings and motions that they share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from geomid_ros.errors import InputError
from geomid_ros.files.models.readers import DESCRIBED_FOR, URDF
from geomid_ros.options import Options, Progress, option, silent

if TYPE_CHECKING:
    from geomid_ros.excitation.motion import Trajectory
    from geomid_ros.session.configuration import Configuration

ESTIMATE = "estimate.json"
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

    model: PathLike | None = option(flag="--from", file=ESTIMATE)
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


@dataclass(frozen=True, kw_only=True)
class RobotOptions(DescriptionOptions):
    """Robot, measured topics, and how they are read.

    Attributes:
        urdf: robot description, URDF or .xacro. [default: robot_description in the bags]
        cutoff: cutoff of the low-pass filter on all signals.
        alike: links that err alike. [default: urdf]
        merge: several publishers send joint states, each for some joints.
        joint_topic: topic of the joint states.
        command: topic of the recorded joint set-points (JointState); identify and gap simulate under them.
        gains: gains of motors without torque sensors, whose efforts are those of --command, or a parameter file of a
            joint_trajectory_controller.
        imu: IMU on a moving base, in place of its pose.
        contacts: feet on the ground, FRAME or FRAME:RADIUS [m]; contact forces are computed from leg efforts.
        floating_base: the base moves; its pose is read from the odometry topic.
        odom_topic: topic of the base pose.
        progress: called with the current stage and its completed share, 0 to 1.
    """

    cutoff: float | None = option(metavar="HZ", sets="filter.cutoff")
    alike: str | None = option(choices=("urdf", "none"), sets="alike")
    merge: bool = option(False, sets="merge_joint_states")
    joint_topic: str = "joint_states"
    command: str | None = option(metavar="TOPIC")
    gains: Texts = option((), metavar="[JOINT=]KP:KD")
    imu: str | None = option(metavar="TOPIC:FRAME")
    contacts: Texts | None = option(metavar="FEET", sets="contacts")
    floating_base: bool = option(False, sets="floating_base")
    odom_topic: str = "odom"
    progress: Progress = silent


@dataclass(frozen=True, kw_only=True)
class RecordingOptions(RobotOptions):
    """Options of a robot, and start, test data and reader of an identification.

    Attributes:
        model: start from this estimate.json. Without --urdf, identified.urdf in the same folder is used.
        hold_out: share of each bag, at its end, held out for testing. [default: 0.3; 0 with --validate]
        validate: bag to test on.
        reader: format of the robot description. The file is fitted with what the format can hold, loaded again, and
            tested on held-out data.
    """

    model: PathLike | None = option(file=ESTIMATE)
    hold_out: float | None = option(min=0.0, max=0.9)
    validate: Paths = ()
    reader: str = option(URDF, flag="--for", choices=DESCRIBED_FOR)


@dataclass(frozen=True)
class FittedBags(Options):
    """Recordings to fit.

    Attributes:
        bags: rosbag folders, folders of them, or .mcap and .db3 files.
    """

    bags: Paths


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(RecordingOptions, FittedBags):
    """Parameters to identify.

    Attributes:
        effects: effects to identify at every place. [default: see the reference]
        candidates: effects to add where the data need them. [default: see the reference]
        links: links to identify. [default: all]
        known: weighed mass of a link, of LINK+LINK together, or of the total [kg].
        prior: start from this population.json, written by 'geomid fleet' for this type of robot.
    """

    effects: Texts | None = option(or_none=True, sets="effects")
    candidates: Texts | None = option(or_none=True, sets="candidates")
    links: Texts | None = option(sets="links")
    known: Texts = option((), metavar="LINK=MASS:STD", sets="known")
    prior: PathLike | None = option(sets="prior", file="population.json")


@dataclass(frozen=True, kw_only=True)
class GapOptions(RecordingOptions, FittedBags):
    """Reference of the gap workflow.

    Attributes:
        simulated: recording of your simulator under the commands of a bag; one for each of BAGS, in their order.
    """

    simulated: Paths = ()


@dataclass(frozen=True)
class PayloadBags(Options):
    """Recordings without and with a payload.

    Attributes:
        empty: rosbag folders, or .mcap and .db3 files, without the payload; or the estimate.json of an earlier
            identification without it, with its posterior.npz in the same folder.
        loaded: rosbag folders, or .mcap and .db3 files, with it.
    """

    empty: Paths
    loaded: Paths


@dataclass(frozen=True, kw_only=True)
class PayloadOptions(RobotOptions, PayloadBags):
    """Place of a payload, and trust in the efforts.

    Attributes:
        frame: link that is the flange. [default: payload.frame, or the last moving link]
        gain_std: relative standard deviation of the effort gain; 0 for calibrated torque sensors.
            [default: payload.gain]
    """

    frame: str | None = option(metavar="LINK", sets="payload.frame")
    gain_std: float | None = option(min=0.0, max=1.0, max_open=True, sets="payload.gain")


@dataclass(frozen=True)
class PredictedBags(Options):
    """A model, and recordings to predict.

    Attributes:
        model: an estimate.json.
        validate: rosbag folders, or .mcap and .db3 files.
    """

    model: PathLike = option(MISSING, file=ESTIMATE)
    validate: Paths = option(MISSING)


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(RobotOptions, PredictedBags):
    """Requirements on a model.

    Attributes:
        require: requirement, such as rms<2*floor, joint2.rms<1.5, rms<0.5*urdf, total.mass>20, link3.mass<1.1*urdf,
            from_data>=0.1.
    """

    require: Texts = option((), metavar="[PLACE.]QUANTITY<BOUND")


@dataclass(frozen=True)
class ComparedResults(Options):
    """Two results to compare.

    Attributes:
        first: an estimate.json, or a URDF if the other is none.
        second: an estimate.json, or a URDF if the other is none.
    """

    first: PathLike = option(MISSING, file=ESTIMATE)
    second: PathLike = option(MISSING, file=ESTIMATE)


@dataclass(frozen=True, kw_only=True)
class CompareOptions(RobotOptions, ComparedResults):
    """Test data for both results.

    Attributes:
        bag: bag that both models predict. [default: the held-out data of each]
    """

    bag: Paths = ()


@dataclass(frozen=True)
class FleetBags(Options):
    """Recordings of many robots, and the output folder.

    Attributes:
        bags: a folder with a folder of bags for each robot, a pattern, or a table (.csv) with the columns ``robot`` and
            ``bag``; on a disk, or at a URL that fsspec supports.
        out: output folder, with a subfolder for each robot.
    """

    bags: str
    out: PathLike = field(kw_only=True)


@dataclass(frozen=True, kw_only=True)
class FleetOptions(RobotOptions, FleetBags):
    """Assignment of bags to robots, and the workers that read them.

    Attributes:
        by: column of the table that names the robot.
        scheduler: Dask cluster. [default: the cores of this machine]
        hold_out: share of each bag, at its end, held out for testing. [default: 0.3]
        since: folder of an earlier run, to report which robots have changed.
        keep: where workers store intermediate results. [default: the folder 'kept' in --out]
    """

    by: str = "robot"
    scheduler: str | None = option(metavar="tcp://HOST:PORT")
    hold_out: float | None = option(min=0.0, max=0.9)
    since: PathLike | None = None
    keep: str | None = option(metavar="FOLDER|URL")


@dataclass(frozen=True, kw_only=True)
class FillOptions(DescriptionOptions):
    """Accuracy of the efforts of a trajectory.

    Attributes:
        urdf: robot description, URDF or .xacro. [default: identified.urdf in the folder of the model]
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
    model: PathLike | None = option(MISSING, file=ESTIMATE)


@dataclass(frozen=True, kw_only=True)
class FeedforwardOptions(FillOptions, GivenTrajectory):
    """Trajectory in a bag, and accuracy of its efforts.

    Attributes:
        topic: topic of the trajectory, if TRAJECTORY is a bag with several.
    """

    topic: str | None = option(metavar="TOPIC")


@dataclass(frozen=True)
class ExportOptions(PackageOptions):
    """Payload or robot to export, and its format.

    Attributes:
        model: an estimate.json with its identified.urdf in the same folder, or a URDF.
        tool: software that reads it: ur, franka, urdf, moveit, isaac, gazebo, drake or mujoco.
        frame: the flange: the payload is this link and all links after it, in its axes. [default: for ur and franka
            the one link whose name ends with tool0 or link8]
        links: the payload is these links.
        without: model of the robot without the payload (estimate.json or URDF); the payload is the difference.
        into: for mujoco: print this file with the identified values of the bodies and joints of the same names; the
            rest is unchanged.
        force: export a model whose verdict is not 'usable', too.
    """

    model: PathLike = option(MISSING, file=ESTIMATE)
    tool: str = option(MISSING)
    _: KW_ONLY
    frame: str | None = option(metavar="LINK")
    links: Texts | None = None
    without: PathLike | None = option(file=ESTIMATE)
    into: PathLike | None = option(metavar="MJCF")
    force: bool = False


@dataclass(frozen=True)
class SampleOptions(PackageOptions):
    """Robots to sample.

    Attributes:
        model: an estimate.json with the identified.urdf and the posterior.npz of the same run in its folder.
        tool: software that reads them: urdf, moveit, isaac, gazebo, drake, mujoco or json.
        count: number of robots.
        into: for mujoco: write this file with each robot's numbers for the bodies and joints of the same names; the
            rest is unchanged.
        spread: factor on all standard deviations.
        seed: random seed; the same seed gives the same robots.
    """

    model: PathLike = option(MISSING, file=ESTIMATE)
    tool: str = option(MISSING)
    _: KW_ONLY
    count: int = option(100, flag="-n", min=1, max=100_000)
    into: PathLike | None = option(metavar="MJCF")
    spread: float = option(1.0, min=0.0, min_open=True, max=3.0)
    seed: int = option(0, min=0)
