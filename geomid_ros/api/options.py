"""The options of each function that reads recordings, and of its command."""

from __future__ import annotations

from dataclasses import dataclass, field

from geomid_ros.files.models.readers import DESCRIBED_FOR, URDF
from geomid_ros.options import Options, Progress, option, silent
from geomid_ros.session.options import DescriptionOptions, PathLike, Paths, Texts


@dataclass(frozen=True, kw_only=True)
class RobotOptions(DescriptionOptions):
    """Which robot it is, what is measured on it, and how that is read.

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
        contacts: feet on the ground whose legs' efforts tell their forces, FRAME or FRAME:RADIUS [m].
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
    """The same, and where to start from, what to judge on, and who reads the result.

    Attributes:
        model: start from this estimate.json. Without --urdf, identified.urdf in the same folder is used.
        hold_out: share of each bag, at its end, held out for testing. [default: 0.3; 0 with --validate]
        validate: bag to test on.
        reader: format of the robot description. The file is fitted with what the format can hold, loaded again, and
            tested on held-out data.
    """

    model: PathLike | None = None
    hold_out: float | None = option(min=0.0, max=0.9)
    validate: Paths = ()
    reader: str = option(URDF, flag="--for", choices=DESCRIBED_FOR)


@dataclass(frozen=True)
class FittedBags(Options):
    """Recordings.

    Attributes:
        bags: rosbag folders, folders of them, or .mcap and .db3 files.
    """

    bags: Paths


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(RecordingOptions, FittedBags):
    """What to identify.

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
    prior: PathLike | None = option(sets="prior")


@dataclass(frozen=True, kw_only=True)
class GapOptions(RecordingOptions, FittedBags):
    """What to compare with.

    Attributes:
        simulated: recording of your simulator under the commands of a bag; one for each of BAGS, in their order.
    """

    simulated: Paths = ()


@dataclass(frozen=True)
class PayloadBags(Options):
    """Recordings of a payload.

    Attributes:
        empty: rosbag folders, or .mcap and .db3 files, without the payload; or the estimate.json of an earlier
            identification without it, with the posterior.npz that was written beside it.
        loaded: rosbag folders, or .mcap and .db3 files, with it.
    """

    empty: Paths
    loaded: Paths


@dataclass(frozen=True, kw_only=True)
class PayloadOptions(RobotOptions, PayloadBags):
    """Where a payload is carried.

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

    model: PathLike
    validate: Paths


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(RobotOptions, PredictedBags):
    """What is required of a model.

    Attributes:
        require: requirement, such as rms<2*floor, joint2.rms<1.5, rms<0.5*urdf, total.mass>20, link3.mass<1.1*urdf,
            from_data>=0.1.
    """

    require: Texts = option((), metavar="[PLACE.]QUANTITY<BOUND")


@dataclass(frozen=True)
class ComparedResults(Options):
    """Two results.

    Attributes:
        first: an estimate.json, or a URDF if the other is none.
        second: the same.
    """

    first: PathLike
    second: PathLike


@dataclass(frozen=True, kw_only=True)
class CompareOptions(RobotOptions, ComparedResults):
    """What both results are judged on.

    Attributes:
        bag: bag that both models predict. [default: the held-out data of each]
    """

    bag: Paths = ()


@dataclass(frozen=True)
class FleetBags(Options):
    """Recordings of many robots, and where results go.

    Attributes:
        bags: a folder with a folder of bags for each robot, a pattern, or a table (.csv) with the columns ``robot`` and
            ``bag``; on a disk, or at a URL that fsspec supports.
        out: output folder, with a subfolder for each robot.
    """

    bags: str
    out: PathLike = field(kw_only=True)


@dataclass(frozen=True, kw_only=True)
class FleetOptions(RobotOptions, FleetBags):
    """Which bags are of which robots, and who reads them.

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
