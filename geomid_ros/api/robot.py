"""From the user's options to robot description, recordings and configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import bags_in
from geomid_ros.files.models.urdf import SUFFIX, read_urdf
from geomid_ros.files.parameter_file import read_parameter_file
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.options import Options, named_once, numbers_in
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.options import (
    Config,
    DescriptionOptions,
    Gains,
    PathLike,
    Paths,
    RecordingOptions,
    RobotOptions,
    Texts,
    paths,
    texts,
)
from geomid_ros.session.recordings import Bags, Topics, read_with_locked, recorded_description
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import COMMANDS, IMU, ODOM

T = TypeVar("T")


def bag_paths(given: Paths) -> list[Path]:
    """List the bags; a folder of bags stands for all bags in it."""
    return [bag for path in paths(given) for bag in bags_in(path)]


def entries(argument: str, given: Texts) -> list[str]:
    """Return one text or several as the list for a parameter, in which an empty text would count as none.

    Raises:
        InputError: a text is empty; it names the ``argument``.
    """
    result = texts(given)
    if not all(result):
        raise InputError(f"{argument}: the text is empty; omit the argument")
    return result


def identified_urdf_path(model: PathLike) -> Path:
    """Path of the identified.urdf in the folder of an estimate.json."""
    return Path(model).parent / "identified.urdf"


class DescribedRobot(NamedTuple):
    """The ``text`` of a URDF, its ``source``, and ``notes`` on where it was found if the user named none."""

    text: str
    source: str
    notes: tuple[str, ...] = ()

    def read(
        self,
        make: Callable[[str, Configuration, str], Session],
        parameters: Configuration,
        read: Callable[[Session], T],
    ) -> tuple[Session, T]:
        """Return the session of this robot made by ``make``, and the result of ``read`` for it; see
        :func:`~geomid_ros.session.recordings.read_with_locked`."""
        session, data = read_with_locked(lambda values: make(self.text, values, self.source), parameters, read)
        session.review.settled.extend(self.notes)
        return session, data


def description(options: DescriptionOptions, bags: Sequence[Path], model: PathLike | None = None) -> DescribedRobot:
    """Return the robot description.

    Args:
        options: its path, or the text itself. Without it, the identified.urdf in the folder of ``model`` is used, or
            else the description recorded in the ``bags``. A .xacro file is run with its arguments.
        bags: recordings of the robot.
        model: an estimate.json to start from.

    Raises:
        InputError: there is none, or the file cannot be read.
    """
    urdf, arguments = options.urdf, texts(options.xacro_args)
    if isinstance(urdf, str) and urdf.lstrip().startswith("<"):
        return DescribedRobot(urdf, "robot description")
    if arguments and (urdf is None or Path(urdf).suffix != SUFFIX):
        raise InputError(f"arguments for xacro are given, and {urdf or 'no file'} is not a {SUFFIX} file")
    if urdf is not None:
        return DescribedRobot(read_urdf(Path(urdf), arguments), str(urdf))
    if model is not None and (identified := identified_urdf_path(model)).is_file():
        text, source = read_urdf(identified), str(identified)
    else:
        text, source = recorded_description(bags)
    return DescribedRobot(text, source, (f"no --urdf is given: using the description of {source}",))


def topics(options: RobotOptions) -> Topics:
    """Return the topics to read recordings from."""
    if options.imu is not None and options.odom_topic != ODOM:
        raise InputError("--odom-topic and --imu exclude each other: the IMU replaces the base pose; remove one")
    imu = IMU if options.imu is None else _imu(options.imu)[0]
    return Topics(options.joint_topic, options.odom_topic, imu, options.command or COMMANDS)


def _imu(text: str) -> tuple[str, str]:
    """Return topic and frame of an IMU."""
    topic, _, frame = text.partition(":")
    if not topic or not frame or ":" in frame:
        raise InputError(f"imu '{text}' is not of the form TOPIC:FRAME, e.g. /imu:imu_link")
    return topic, frame


def recordings(options: RecordingOptions, fitted: Paths) -> Bags:
    """Return the recordings to fit and to test on. Raises InputError: there is none, or one is given twice."""
    validate = bag_paths(options.validate)
    return Bags(fitted=bag_paths(fitted), validate=validate, hold_out=options.hold_out, topics=topics(options))


def configuration(options: DescriptionOptions, model: PathLike | None = None, **values: Any) -> Configuration:
    """Return the parameters of ``config`` combined with the other options.

    Args:
        options: ``config``, and the options that set parameters.
        model: an estimate.json to start from.
        values: further parameters by their full names.

    Raises:
        InputError: a parameter is unknown or has a wrong value.
    """
    overrides = _set_by(options) | _gains(options.gain) | values
    if model is not None:
        overrides["model"] = str(model)
    if isinstance(options, RobotOptions) and options.imu is not None:
        overrides["imu.frame"] = _imu(options.imu)[1]
    if isinstance(options, RobotOptions) and options.gains:
        overrides["command.gains"] = [gain for text in entries("gains", options.gains) for gain in _gains_of(text)]
    result = _base(options.config)
    if options.wrench:
        result = result.with_sensors([WrenchSensor.parse(text) for text in texts(options.wrench)])
    return result.with_values(Configuration(overrides, "options").given_values)


def _set_by(options: Options) -> dict[str, Any]:
    """Return the parameters set by those options that are given and declare one (``sets``)."""
    values: dict[str, Any] = {}
    for option in fields(options):
        value = getattr(options, option.name)
        if "sets" not in option.metadata or value is option.default:
            continue
        if str(option.type).startswith("Texts"):
            value = entries(option.name, value)
        values[option.metadata["sets"]] = str(value) if isinstance(value, Path) else value
    return values


def check_command_efforts(options: RobotOptions, parameters: Configuration) -> Configuration:
    """Return the ``parameters`` of a command that simulates nothing. Raises InputError for --command without gains."""
    if options.command is not None and not parameters.gains:
        raise InputError(
            f"--command {options.command} without --gains: here set-points serve as efforts, by the gains of their "
            "controllers; add --gains KP:KD, or leave --command out to use the reported efforts"
        )
    return parameters


def _base(config: Config | None) -> Configuration:
    if isinstance(config, Configuration):
        return config
    if config is None or isinstance(config, Mapping):
        return Configuration(config, "options" if config is None else "config")
    return Configuration.read(Path(config))


def _gains(given: Gains) -> dict[str, float]:
    """Return the parameters set by effort gains."""
    if isinstance(given, Mapping):
        given = [f"{joint}={factor}" for joint, factor in given.items()]
    pairs = [
        _gain(str(entry)) for entry in ([given] if isinstance(given, str) or not isinstance(given, Iterable) else given)
    ]
    factors = named_once("gain", pairs, "for each joint its own: {'JOINT': 2.0, ...}, --gain JOINT=2")
    return {f"joint.{joint}.effort_gain" if joint else "effort_gain": factor for joint, factor in factors.items()}


def _gain(text: str) -> tuple[str, float]:
    """Return the joint of ``[JOINT=]FACTOR``, empty for all joints, and its factor."""
    joint, _, factor = text.rpartition("=")
    match numbers_in(factor):
        case [number]:
            return joint, number
    raise InputError(f"gain: '{text}' is not of the form [JOINT=]FACTOR, e.g. -1 or joint3=0.5")


def _gains_of(text: str) -> list[str]:
    """Return the entries of ``gains``: the text itself, or, if it names a file, the parameters of a
    joint_trajectory_controller in that file. Raises InputError naming the file."""
    if not Path(text).is_file():
        return [text]
    file = read_parameter_file(Path(text))
    joints = [name[len("gains.") : -len(".p")] for name in file if name.startswith("gains.") and name.endswith(".p")]
    if not joints:
        raise InputError(f"{text}: expected gains.JOINT.p and .d, as a joint_trajectory_controller has them")
    return [f"{joint}={file[f'gains.{joint}.p']}:{file.get(f'gains.{joint}.d', 0.0)}" for joint in joints]
