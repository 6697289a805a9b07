"""From a recording with a payload, and a recording or an estimate of the robot without it, to the payload."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from geomid_ros.api.arguments import Config, PathLike, Paths, Texts, bag_paths, configuration, description, paths
from geomid_ros.errors import InputError
from geomid_ros.exports.weighed_payload import Payload, weigh_at
from geomid_ros.files.models.posterior import beside, read_posterior
from geomid_ros.model.samples import Samples
from geomid_ros.session.locking import read_with_locked
from geomid_ros.session.payload import payload_session
from geomid_ros.session.recordings import Bags, Progress, Topics, read_fitted, silent
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
    """Weigh what a robot carries: the same links and friction with and without it, and one body more with it.

    ``geomid payload`` calls this; its options have the same names. The recordings move all joints; the motions need not
    be the same.

    Args:
        empty: rosbag folders, or .mcap and .db3 files, without the payload; or the estimate.json of an earlier
            identification without it, with the posterior.npz that was written beside it.
        loaded: rosbag folders, or .mcap and .db3 files, with it.
        urdf: path or text of the robot description; None for the identified.urdf beside the estimate.json, or else what
            is recorded on robot_description in the bags.
        frame: the flange, a link of the URDF; None for the configured ``payload.frame``, or the last link that moves.
        gain_std: standard deviation of the efforts' gain, relative; 0 for calibrated torque sensors; None for
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
    model = _estimate(empty)
    known = None if model is None else read_posterior(beside(model))
    parameters = configuration(config, model=model, floating_base=floating_base, wrench=wrench)
    both = bag_paths(empty) if model is None else [], bag_paths(loaded)
    topics = Topics(joint_topic, odom_topic)
    robot = description(urdf, [*both[0], *both[1]], model=model, xacro_args=xacro_args)
    session, (before, after) = read_with_locked(
        lambda chosen: payload_session(robot.text, chosen, robot.source),
        parameters,
        lambda session: [_all(session, bags, topics, progress) for bags in both],
    )
    session.settled.extend(robot.notes)
    session.check_description()
    progress("solving", 0.0)
    own_gain = parameters["payload.gain"] if gain_std is None else gain_std
    return weigh_at(session, known or before, after, frame or parameters["payload.frame"], own_gain)


def _estimate(empty: Paths) -> Path | None:
    """The estimate.json that is given in place of recordings."""
    given = paths(empty)
    return given[0] if len(given) == 1 and given[0].suffix == ".json" else None


def _all(session: Session, bags: Sequence[Path], topics: Topics, progress: Progress) -> Sequence[Samples]:
    """All samples of some bags."""
    if not bags:
        return ()
    session.judge_apart()
    return read_fitted(session, Bags(fitted=bags, hold_out=0.0, topics=topics), progress)
