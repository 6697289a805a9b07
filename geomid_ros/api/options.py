"""Options of each function and of its command."""

from __future__ import annotations

from dataclasses import KW_ONLY, MISSING, dataclass, field
from typing import TYPE_CHECKING

from geomid_ros.files.models.readers import DESCRIBED_FOR, URDF
from geomid_ros.options import Options, Progress, option, silent
from geomid_ros.session.options import DescriptionOptions, PackageOptions, PathLike, Paths, Texts

if TYPE_CHECKING:
    from geomid_ros.excitation.motion import Trajectory

ESTIMATE = "estimate.json"


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
