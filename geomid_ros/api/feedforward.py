"""Feed-forward efforts for a trajectory, from an identified model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geomid_ros.api.robot import DescribedRobot, configuration, description, identified_urdf_path
from geomid_ros.control.feedforward import MotorEfforts, interpolation_errors, with_efforts
from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.trajectories import read_trajectory, save_trajectory, trajectory_in_bag
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.urdf_tree import parse
from geomid_ros.options import takes
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.options import FeedforwardOptions, FillOptions, PathLike
from geomid_ros.session.session import Session, predicting_session
from geomid_ros.types import FloatArray

_YAML = (".yaml", ".yml")
LONGEST = 600.0
"""Longest trajectory [s]."""


@dataclass(frozen=True, eq=False)
class Feedforward:
    """The ``trajectory`` with efforts in the unit of the robot's messages. The user's trajectory has ``given`` points.

    Attributes:
        session: the robot and its model.
        limits: effort limits of the URDF ``(joints,)`` in that unit; infinite where it has none.
        errors: largest error of linearly interpolated efforts ``(joints,)``, in that unit.
        notes: remarks on the efforts, in sentences.
    """

    trajectory: Trajectory
    given: int
    session: Session
    limits: FloatArray
    errors: FloatArray
    notes: tuple[str, ...]

    @property
    def largest(self) -> FloatArray:
        """Largest absolute effort of each joint ``(joints,)``."""
        return np.asarray(np.max(np.abs(self.trajectory.efforts), axis=0))

    @property
    def summary(self) -> str:
        """Duration, and number of points."""
        trajectory = self.trajectory
        return f"{trajectory.duration:g} s, {len(trajectory.times)} points ({self.given} were given)"

    def __repr__(self) -> str:
        """Notes, a heading, and the largest effort of each joint."""
        joints = zip(self.trajectory.joints, self.largest.tolist(), strict=True)
        lines = [f"  {joint}: at most {largest:.4g} N m (N)" for joint, largest in joints]
        return "\n".join([*self.notes, f"Trajectory with efforts: {self.summary}", *lines])

    def save(self, path: PathLike) -> Path:
        """Write the trajectory: YAML or CSV by the suffix, else a rosbag in a folder.

        Returns:
            The path.

        Raises:
            GeomidError: it cannot be written.
        """
        save_trajectory(Path(path), self.trajectory)
        return Path(path)


@takes(FeedforwardOptions)
def feedforward(options: FeedforwardOptions) -> Feedforward:
    """Fill in the efforts of a trajectory, for a controller that adds them to its feedback.

    ``geomid feedforward`` calls this; its options have the same names. Positions do not change. Points are added where
    linear interpolation of the efforts would be off by more than ``tolerance``.

    Raises:
        InputError: a file or an argument cannot be used; the trajectory is of another robot; a joint would need more
            effort than its limit; the model is doubtful.
    """
    given, source = options.trajectory, "the trajectory"
    if not isinstance(given, Trajectory):
        given, source = _read(Path(given), options.topic), str(given)
    file = None if options.model is None else EstimateFile.read(Path(options.model))
    session = robot_to_move(options, file)
    return fill_efforts(session, given, options.tolerance, source)


def fill_efforts(session: Session, given: Trajectory, tolerance: float, source: str) -> Feedforward:
    """Fill in efforts for a session of :func:`robot_to_move`; ``source`` names the trajectory. Raises InputError."""
    if given.duration > LONGEST:
        raise InputError(f"{source}: takes {given.duration:.4g} s, expected at most {LONGEST:g} s")
    efforts = MotorEfforts(session.model, session.known_parameters, session.effort_gains, given.joints, source)
    result = with_efforts(given, efforts, tolerance)
    _check_limits(result, efforts.limits, source)
    errors = np.max(interpolation_errors(result, efforts), axis=0)
    notes = tuple(filter(None, [session.loaded.warning, session.loaded.not_predicted]))
    return Feedforward(result, len(given.times), session, efforts.limits, errors, notes)


def _read(path: Path, topic: str | None) -> Trajectory:
    if path.suffix not in _YAML:
        return trajectory_in_bag(path, topic)
    if topic is not None:
        raise InputError(f"{path}: not a rosbag, but --topic is given")
    return read_trajectory(path)


def robot_to_move(
    options: FillOptions, file: EstimateFile | None, carried: Mapping[str, FloatArray] | None = None
) -> Session:
    """Return the robot with its model; without a ``file``, that of the URDF alone. ``carried``: inertias ``(10,)`` that
    its links carry. Raises InputError if there is none, it is doubtful and not forced, or has no such link."""
    if file is None and options.urdf is None:
        raise InputError("no robot is given: give a model (estimate.json), or a urdf for the URDF alone")
    parameters = configuration(options, candidates=[])
    if file is None:
        robot = description(options, [])
        return predicting_session(robot.text, parameters, robot.source)
    check_model(options, file)
    robot = description(replace(options, urdf=options.urdf or file.robot_description or None), [], file.source)
    parameters = _with_sensors_of(file, parameters, robot)
    loaded, inertias = LoadedModel.of(file), dict(file.inertias)
    for link, body in (carried or {}).items():
        if link not in inertias:
            raise InputError(f"{file.source}: no link '{link}', which carries a payload")
        inertias[link] = inertias[link] + body
    return predicting_session(robot.text, parameters, robot.source, replace(loaded, inertias=inertias))


def check_model(options: FillOptions, file: EstimateFile) -> None:
    """Refuse a model that is doubtful and not forced, has a floating base, or no robot description. Raises
    InputError."""
    if file.warning and not options.force:
        raise InputError(f"{file.warning}; to move a robot by it all the same, set force")
    if any(channel.channel.startswith("base/") for channel in file.channels):
        raise InputError(
            f"{file.source}: floating base: leg efforts depend on ground contact forces, which a trajectory does not "
            "contain"
        )
    if not (options.urdf or file.robot_description or identified_urdf_path(file.source).is_file()):
        raise InputError(f"{file.source}: identified.urdf is missing in the same folder; give the urdf")


def _with_sensors_of(file: EstimateFile, parameters: Configuration, robot: DescribedRobot) -> Configuration:
    """Add the mounted wrench sensors with which a model was identified: there, links that are fixed to each other are
    separate bodies. Nothing is read from them."""
    divided = {link.name for link in file.links} - {sensor.frame for sensor in parameters.sensors}
    joints = parse(robot.text, robot.source).joints
    frames = [joint.child for joint in joints if joint.type == "fixed" and joint.child in divided]
    return parameters.with_sensors(
        [*parameters.sensors, *(WrenchSensor(f"/{frame}", frame, "mounted") for frame in frames)]
    )


def _check_limits(trajectory: Trajectory, limits: FloatArray, source: str) -> None:
    ratio = np.abs(trajectory.efforts) / limits
    point, joint = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    if ratio[point, joint] > 1.0:
        raise InputError(
            f"{source}: joint '{trajectory.joints[joint]}' would need {abs(trajectory.efforts[point, joint]):.4g} at "
            f"{trajectory.times[point]:.3f} s, {100.0 * (ratio[point, joint] - 1.0):.0f} % more than its limit of "
            f"{limits[joint]:.4g}; make the motion slower"
        )
