"""From a model on disk and a recording to whether the model still holds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.api.arguments import Config, PathLike, Paths, Texts, bag_paths, configuration, description, texts
from geomid_ros.errors import InputError
from geomid_ros.files.models.results import read_estimate
from geomid_ros.model.samples import Samples
from geomid_ros.plausibility.requirements import TOTAL, Outcome, Requirement, Values
from geomid_ros.plausibility.verdict import recording_verdict
from geomid_ros.session.gap import gap_session, rms_of_model
from geomid_ros.session.locking import read_with_locked
from geomid_ros.session.recordings import Bags, Progress, Topics, read_fitted, silent
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Verification:
    """How well a model predicts a recording, and whether that is as required.

    Attributes:
        session: the robot and its model.
        rms: by channel, RMS of what the model leaves (``value``), of the noise, or where the file does not say that of
            what the model left of the data that it was fitted to (``floor``), and of what the URDF leaves (``urdf``);
            NaN where nothing is measured or known.
        doubts: why the model or the recording is not to be believed.
        outcomes: what was required, and whether it is so.
    """

    session: Session
    rms: Values
    doubts: Sequence[str]
    outcomes: Sequence[Outcome]

    @property
    def passed(self) -> bool:
        """Whether nothing casts doubt on it and all is as required."""
        return not self.doubts and all(outcome.passed for outcome in self.outcomes)


def verify(
    model: PathLike,
    validate: Paths,
    urdf: PathLike | None = None,
    *,
    require: Texts = (),
    config: Config | None = None,
    xacro_args: Texts = (),
    floating_base: bool = False,
    wrench: Texts = (),
    joint_topic: str = "joint_states",
    odom_topic: str = "odom",
    progress: Progress = silent,
) -> Verification:
    """Predict recordings with a model that was identified before, and see whether it does as required.

    ``geomid verify`` calls this; its options have the same names.

    Args:
        model: an estimate.json.
        validate: rosbag folders, or .mcap and .db3 files.
        urdf: path or text of the robot description that the model was identified from; None for the identified.urdf
            beside it, or else what is recorded on robot_description in the bags.
        require: what is required, as :mod:`~geomid_ros.plausibility.requirements` says.
        config: the node's parameter file (YAML), or parameters by their full names.
        xacro_args: arguments, as ``NAME:=VALUE``, of ``urdf``, if that is a .xacro file, which is run.
        floating_base: whether the base moves; its pose is read from ``odom_topic``.
        wrench: wrench sensors, as ``TOPIC:FRAME:ROLE[:AXES]``; ``ROLE`` is mounted or external.
        joint_topic: topic of the joint states.
        odom_topic: topic of the base's pose.
        progress: called with what is being done and the share of it, 0 to 1, that is done.

    Raises:
        InputError: a file, an argument, a requirement or the data cannot be used.
    """
    required = [Requirement.parse(text) for text in texts(require)]
    document = read_estimate(Path(model))
    parameters = configuration(config, model=model, floating_base=floating_base, wrench=wrench)
    if "cutoff" in document and "filter.cutoff" not in parameters.given:  # the floor is that of a band
        parameters = parameters.with_values({"filter.cutoff": _number(document["cutoff"])})
    recorded = Bags(fitted=bag_paths(validate), hold_out=0.0, topics=Topics(joint_topic, odom_topic))
    robot = description(urdf, recorded.fitted, model=model, xacro_args=xacro_args)
    relative = next((each for each in required if each.reference == "urdf"), None)
    if relative and urdf is None and Path(robot.source).parent == Path(model).parent:
        raise InputError(
            f"requirement '{relative.text}' compares with the URDF before, and {robot.source} is the identified one; "
            "name the former with --urdf"
        )
    session, samples = read_with_locked(
        lambda chosen: gap_session(robot.text, chosen, robot.source),
        parameters,
        lambda session: read_fitted(session, recorded, progress),
    )
    session.settled.extend(robot.notes)
    values = _values(session, samples, document)
    doubts = recording_verdict(session.findings).reasons
    return Verification(
        session=session,
        rms=values["rms"],
        doubts=[*filter(None, [session.loaded.doubt]), *doubts],
        outcomes=[outcome for requirement in required for outcome in requirement.checked(values)],
    )


def _values(session: Session, samples: Sequence[Samples], document: Mapping[str, Any]) -> dict[str, Values]:
    """The numbers of every quantity that may be required."""
    nominal, prior = session.nominal_parameters, session.prior
    found = nominal if prior is None else np.where(np.isnan(prior), nominal, prior)
    channels = [channel.name for channel in session.model.channels]
    floors = _entry(document, "floor") or _entry(_entry(document, "rms"), "train")
    left = rms_of_model(session, samples), session.rms(samples, nominal)
    errors = zip(channels, *(each.tolist() for each in left), strict=True)
    bodies = session.model.body_names
    masses = [[*each, sum(each)] for each in (_masses(found, bodies), _masses(nominal, bodies))]
    return {
        "rms": {name: {"value": own, "floor": _number(floors.get(name)), "urdf": urdf} for name, own, urdf in errors},
        "mass": {name: {"value": own, "urdf": urdf} for name, own, urdf in zip([*bodies, TOTAL], *masses, strict=True)},
        "from_data": {str(link["name"]): {"value": _number(link.get("from_data"))} for link in document["links"]},
    }


def _masses(parameters: FloatArray, bodies: Sequence[str]) -> list[float]:
    masses: list[float] = parameters[: 10 * len(bodies) : 10].tolist()
    return masses


def _entry(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """An object of a file, empty if it is none."""
    found = document.get(key)
    return found if isinstance(found, dict) else {}


def _number(value: object) -> float:
    """A number of a file, NaN if it is none."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
