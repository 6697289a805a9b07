"""From a recording of a robot without a payload and one with it to the payload."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from geomid_ros.api.arguments import Config, PathLike, Paths, Texts, bag_paths, configuration, description
from geomid_ros.errors import InputError
from geomid_ros.exports.weighed_payload import Payload, weigh_at
from geomid_ros.model.samples import Samples
from geomid_ros.session.locking import read_with_locked
from geomid_ros.session.payload import payload_session
from geomid_ros.session.recordings import Bags, Progress, Topics, read_bags, silent
from geomid_ros.session.session import Session


def weigh_payload(
    empty: Paths,
    loaded: Paths,
    urdf: PathLike | None = None,
    *,
    frame: str | None = None,
    gain_std: float | None = None,
    config: Config | None = None,
    xacro_args: Texts = (),
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
        urdf: path or text of the robot description; None for what is recorded on robot_description in the bags.
        frame: the flange, a link of the URDF; None for the configured ``payload.frame``, or the last link that moves.
        gain_std: standard deviation of the efforts' common gain, relative; 0 for calibrated torque sensors; None for
            the configured ``payload.gain``.
        config: the node's parameter file (YAML), or parameters by their full names.
        xacro_args: arguments, as ``NAME:=VALUE``, of ``urdf``, if that is a .xacro file, which is run.
        floating_base: whether the base moves; its pose is read from ``odom_topic``.
        wrench: wrench sensors, as ``TOPIC:FRAME:ROLE[:AXES]``; ``ROLE`` is mounted or external.
        joint_topic: topic of the joint states.
        odom_topic: topic of the base's pose.
        progress: called with what is being done and the share of it, 0 to 1, that is done.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    if gain_std is not None and not 0.0 <= gain_std < 1.0:
        raise InputError(f"gain_std is {gain_std:g}, expected a number from 0 to 1")
    parameters = configuration(config, model=None, floating_base=floating_base, wrench=wrench)
    both = bag_paths(empty), bag_paths(loaded)
    robot, topics = description(urdf, [*both[0], *both[1]], xacro_args=xacro_args), Topics(joint_topic, odom_topic)
    session, (before, after) = read_with_locked(
        lambda chosen: payload_session(robot.text, chosen, robot.source),
        parameters,
        lambda session: [_all(session, bags, topics, progress) for bags in both],
    )
    session.settled.extend(robot.notes)
    progress("solving", 0.0)
    own_gain = parameters["payload.gain"] if gain_std is None else gain_std
    return weigh_at(session, before, after, frame or parameters["payload.frame"], own_gain)


def _all(session: Session, bags: Sequence[Path], topics: Topics, progress: Progress) -> list[Samples]:
    """All samples of some bags."""
    session.judge_apart()
    train, _ = read_bags(session, Bags(fitted=bags, hold_out=0.0, topics=topics), progress)
    return train
