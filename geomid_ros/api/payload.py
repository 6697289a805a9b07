"""Identification of a payload from rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from geomid_ros.api.robot import bag_paths, check_command_efforts, configuration, description, topics
from geomid_ros.exports.payload import Payload, identify_payload_at
from geomid_ros.files.models.posterior import posterior_path, read_posterior
from geomid_ros.model.samples import Samples
from geomid_ros.options import takes
from geomid_ros.session.options import Paths, PayloadOptions, paths
from geomid_ros.session.payload import payload_session
from geomid_ros.session.recordings import Bags, read_fitted
from geomid_ros.session.session import Session


@takes(PayloadOptions)
def weigh_payload(options: PayloadOptions) -> Payload:
    """Identify a payload. Both recordings share links and friction; the loaded one has an additional body.

    ``geomid payload`` calls this; its options have the same names. All joints must move in both recordings; the motions
    may differ.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    model = _estimate_without(options.empty)
    posterior = None if model is None else read_posterior(posterior_path(model))
    parameters = check_command_efforts(options, configuration(options, model))
    both = bag_paths(options.empty) if model is None else [], bag_paths(options.loaded)
    robot = description(options, [*both[0], *both[1]], model)
    session, (before, after) = robot.read(
        payload_session, parameters, lambda session: [_all_samples(session, bags, options) for bags in both]
    )
    session.review.check_description()
    options.progress("solving", 0.0)
    return identify_payload_at(
        session, posterior or before, after, parameters["payload.frame"], parameters["payload.gain"]
    )


def _estimate_without(empty: Paths) -> Path | None:
    """Return the estimate.json, if one is given instead of recordings."""
    given = paths(empty)
    return given[0] if len(given) == 1 and given[0].suffix == ".json" else None


def _all_samples(session: Session, bags: Sequence[Path], options: PayloadOptions) -> Sequence[Samples]:
    """Read all samples of the bags."""
    if not bags:
        return ()
    session.review.check_separately()
    return read_fitted(session, Bags(fitted=bags, hold_out=0.0, topics=topics(options)), options.progress)
