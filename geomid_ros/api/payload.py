"""From a recording of a robot without a payload and one with it to the payload."""

from __future__ import annotations

from dataclasses import dataclass

from geomid_ros.api.arguments import Config, PathLike, Paths, Texts, bag_paths, configuration, description
from geomid_ros.errors import InputError
from geomid_ros.exports.formats import CONTROLLERS
from geomid_ros.exports.inertial import Export, Summand, UncertainInertia, total
from geomid_ros.model.samples import Samples
from geomid_ros.session.payload import GAIN, WeighedPayload, weigh
from geomid_ros.session.recordings import Bags, Progress, Topics, read_bags, silent
from geomid_ros.session.session import Session


@dataclass(frozen=True, kw_only=True, eq=False)
class Payload:
    """What was weighed, in the axes and about the origin of the link ``frame``.

    Attributes:
        weighed: the payload in the axes of the moving link that carries it, with how well it is known.
        inertial: the same in those of ``frame``.
    """

    frame: str
    weighed: WeighedPayload
    inertial: UncertainInertia

    @property
    def mass(self) -> float:
        """[kg]."""
        return self.inertial.mass

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the mass [kg], with the uncertainty of the efforts' gain."""
        return self.weighed.interval

    def commands(self, controller: str) -> str:
        """The text that sets the payload at a controller: ``ur`` or ``franka``. Raises InputError for one that the
        controller refuses."""
        return CONTROLLERS[controller].commands(Export(f"payload at '{self.frame}'", self.frame, self.inertial))


def weigh_payload(
    empty: Paths,
    loaded: Paths,
    urdf: PathLike,
    *,
    frame: str | None = None,
    gain: float = GAIN,
    config: Config | None = None,
    floating_base: bool = False,
    wrench: Texts = (),
    joint_topic: str = "joint_states",
    odom_topic: str = "odom",
    progress: Progress = silent,
) -> Payload:
    """Weigh what a robot carries: the same links and friction in two recordings, and one body more in the second.

    ``geomid payload`` calls this; its options have the same names. Both recordings move all joints; the motions need
    not be the same.

    Args:
        empty: rosbag folders, or .mcap and .db3 files, without the payload.
        loaded: the same with it.
        urdf: path or text of the robot description.
        frame: the flange, a link of the URDF; None for the last link that moves.
        gain: standard deviation of the efforts' common gain, relative; 0 for calibrated torque sensors.
        config: the node's parameter file (YAML), or parameters by their full names.
        floating_base: whether the base moves; its pose is read from ``odom_topic``.
        wrench: wrench sensors, as ``TOPIC:FRAME:ROLE[:AXES]``; ``ROLE`` is mounted or external.
        joint_topic: topic of the joint states.
        odom_topic: topic of the base's pose.
        progress: called with what is being done and the share of it, 0 to 1, that is done.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    if not 0.0 <= gain < 1.0:
        raise InputError(f"gain is {gain:g}, expected a number from 0 to 1")
    # What imitates a payload, springs and friction in proportion to the load, is not looked for here.
    parameters = configuration(config, model=None, floating_base=floating_base, wrench=wrench, candidates=[])
    text, source = description(urdf)
    session = Session(text, parameters, source)
    robot = session.robot
    link = session.model.body_names[-1] if frame is None else robot.carrier(frame)
    topics = Topics(joint_topic, odom_topic)
    before, after = (_all(session, bags, topics, progress) for bags in (empty, loaded))
    progress("solving", 0.0)
    weighed = weigh(session, before, after, link, gain)
    own = frame or link
    return Payload(frame=own, weighed=weighed, inertial=_seen_from(session, weighed, own))


def _all(session: Session, bags: Paths, topics: Topics, progress: Progress) -> list[Samples]:
    """All samples of some bags."""
    train, _ = read_bags(session, Bags(fitted=bag_paths(bags), hold_out=0.0, topics=topics), progress)
    return train


def _seen_from(session: Session, weighed: WeighedPayload, frame: str) -> UncertainInertia:
    """The payload in the axes of another link that is fixed to the one that carries it."""
    inertial = UncertainInertia(weighed.quantities, weighed.std)
    return total([Summand(inertial, session.robot.fixed_placement(weighed.link, frame))], f"the payload at '{frame}'")
