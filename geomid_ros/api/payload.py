"""Identification of a payload, from a recording with it, and a recording or an estimate without it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

from geomid_ros.api.options import PathLike, Paths, RobotKeywords, RobotOptions, bag_paths, paths
from geomid_ros.errors import InputError
from geomid_ros.exports.weighed_payload import Payload, weigh_at
from geomid_ros.files.models.posterior import beside, read_posterior
from geomid_ros.model.samples import Samples
from geomid_ros.session.payload import payload_session
from geomid_ros.session.recordings import Bags, Progress, Topics, read_fitted, read_with_locked, silent
from geomid_ros.session.session import Session


def weigh_payload(
    empty: Paths,
    loaded: Paths,
    urdf: PathLike | None = None,
    *,
    frame: str | None = None,
    gain_std: float | None = None,
    progress: Progress = silent,
    **options: Unpack[RobotKeywords],
) -> Payload:
    """Identify a payload: both recordings share links and friction; the loaded one has an additional body.

    ``geomid payload`` calls this; its options have the same names. All joints must move in both recordings; the motions
    may differ.

    Args:
        empty: rosbag folders, or .mcap and .db3 files, without the payload; or the estimate.json of an earlier
            identification without it, with the posterior.npz that was written beside it.
        loaded: rosbag folders, or .mcap and .db3 files, with it.
        urdf: path or text of the robot description, see :class:`~geomid_ros.RobotOptions`.
        frame: the flange, a link of the URDF; None for the configured ``payload.frame``, or the last link that moves.
        gain_std: relative standard deviation of the effort gain; 0 for calibrated torque sensors; None for the
            configured ``payload.gain``.
        progress: called with the current stage and its completed share, 0 to 1.
        options: which robot it is and how its recordings are read, see :class:`~geomid_ros.RobotOptions`.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    if gain_std is not None and not 0.0 <= gain_std < 1.0:
        raise InputError(f"gain_std is {gain_std:g}, expected a number from 0 to 1")
    chosen, model = RobotOptions(urdf=urdf, **options), _estimate(empty)
    known = None if model is None else read_posterior(beside(model))
    parameters = chosen.efforts_of_command(chosen.configuration(model))
    both = bag_paths(empty) if model is None else [], bag_paths(loaded)
    robot = chosen.description([*both[0], *both[1]], model)
    session, (before, after) = read_with_locked(
        lambda configured: payload_session(robot.text, configured, robot.source),
        parameters,
        lambda session: [_all(session, bags, chosen.topics, progress) for bags in both],
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
