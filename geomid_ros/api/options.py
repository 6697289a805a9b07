"""What a user may say: files, texts, and the options that functions and commands share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypedDict

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import bags_in
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.xacro import SUFFIX, urdf_of_xacro
from geomid_ros.files.parameter_file import read_parameter_file
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.imu import Imu
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, Topics, recorded_description
from geomid_ros.signals.messages import COMMANDS, IMU, ODOM

PathLike: TypeAlias = str | Path
"""The path of a file or a folder."""
Paths: TypeAlias = PathLike | Sequence[PathLike]
"""One path or several."""
Texts: TypeAlias = str | Sequence[str]
"""One text or several."""
Config: TypeAlias = PathLike | Mapping[str, Any] | Configuration
"""A parameter file (YAML), or parameters by their full names, as in ``{"filter.cutoff": 8.0}``."""


def _gains_of(text: str) -> list[str]:
    """The entries of ``gains`` that a text is, or that the parameters of a joint_trajectory_controller are in the file
    of this name. Raises InputError naming the file."""
    if not Path(text).is_file():
        return [text]
    said = read_parameter_file(Path(text))
    joints = [name[len("gains.") : -len(".p")] for name in said if name.startswith("gains.") and name.endswith(".p")]
    if not joints:
        raise InputError(f"{text}: expected gains.JOINT.p and .d, as a joint_trajectory_controller has them")
    return [f"{joint}={said[f'gains.{joint}.p']}:{said.get(f'gains.{joint}.d', 0.0)}" for joint in joints]


def paths(given: Paths) -> list[Path]:
    """One path or several, as a list."""
    return [Path(path) for path in ([given] if isinstance(given, str | Path) else given)]


def bag_paths(given: Paths) -> list[Path]:
    """Bags, as a list; for a folder of bags, those in it."""
    return [bag for path in paths(given) for bag in bags_in(path)]


def texts(given: Texts) -> list[str]:
    """One text or several, as a list."""
    return [given] if isinstance(given, str) else list(given)


def entries(argument: str, given: Texts) -> list[str]:
    """One text or several, as the list that is given for a parameter, where an empty text would pass for none.

    Raises:
        InputError: a text is empty; it names the ``argument``.
    """
    result = texts(given)
    if not all(result):
        raise InputError(f"{argument}: the text is empty; omit the argument")
    return result


def beside(model: PathLike) -> Path:
    """The description that is written with an estimate.json."""
    return Path(model).parent / "identified.urdf"


class DescribedRobot(NamedTuple):
    """The ``text`` of a URDF, its ``source``, and ``notes`` on where it was found if nobody named it."""

    text: str
    source: str
    notes: tuple[str, ...] = ()


def description(
    urdf: PathLike | None, bags: Sequence[Path], *, model: PathLike | None = None, xacro_args: Texts = ()
) -> DescribedRobot:
    """The robot description.

    Args:
        urdf: path of the file, or the text itself; None for the identified.urdf beside ``model``, or else what is
            recorded in the ``bags``.
        bags: of the robot.
        model: an estimate.json to start from.
        xacro_args: arguments, as ``NAME:=VALUE``, if ``urdf`` is the path of a .xacro file, which is then run.

    Raises:
        InputError: there is none, or the file cannot be read.
    """
    if isinstance(urdf, str) and urdf.lstrip().startswith("<"):
        return DescribedRobot(urdf, "robot description")
    if urdf is not None and Path(urdf).suffix == SUFFIX:
        return DescribedRobot(urdf_of_xacro(Path(urdf), texts(xacro_args)), str(urdf))
    if xacro_args:
        raise InputError(f"arguments for xacro are given, and {urdf or 'no file'} is not a {SUFFIX} file")
    if urdf is not None:
        return DescribedRobot(read_urdf(Path(urdf)), str(urdf))
    if model is not None and (own := beside(model)).is_file():
        text, source = read_urdf(own), str(own)
    else:
        text, source = recorded_description(bags)
    return DescribedRobot(text, source, (f"no --urdf is given: using the description of {source}",))


Gains: TypeAlias = float | str | Sequence[float | str] | Mapping[str, float]
"""A factor of all joints' efforts, ``[JOINT=]FACTOR`` as on the command line, several of them, or factors by joint."""


class RobotKeywords(TypedDict, total=False):
    """Keyword arguments that make :class:`RobotOptions`, where they are explained."""

    config: Config | None
    xacro_args: Texts
    cutoff: float | None
    gravity: Sequence[float] | None
    gain: Gains
    lock: Texts | None
    merge: bool
    wrench: Texts
    joint_topic: str
    floating_base: bool
    odom_topic: str
    imu: str | None
    contacts: Texts | None
    alike: str | None
    command: str | None
    gains: Texts


class RecordingKeywords(RobotKeywords, total=False):
    """Keyword arguments that make :class:`RecordingOptions`, where they are explained."""

    model: PathLike | None
    hold_out: float | None
    validate: Paths


@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """Which robot it is, what is measured on it, and how that is read.

    Functions of ``geomid_ros`` take them as keyword arguments; commands of ``geomid`` have options of the same names.
    They win over ``config``.

    Attributes:
        urdf: path of the robot description (URDF or .xacro), or its text; None for the identified.urdf beside a model
            that is given, or else for the description in the bags.
        config: the node's parameter file (YAML), or parameters by their full names.
        xacro_args: arguments, as ``NAME:=VALUE``, of a .xacro file, which is run.
        cutoff: cutoff frequency of the low-pass on all signals [Hz].
        gravity: gravity ``(3,)`` in the base frame [m/s^2].
        gain: factors from the messages' efforts to N m (or N), see :data:`Gains`.
        lock: joints that stand at zero.
        merge: whether several publishers send the joint states, each some of the joints.
        wrench: wrench sensors, as ``TOPIC:FRAME:ROLE[:AXES]``; ``ROLE`` is mounted or external.
        joint_topic: topic of the joint states.
        floating_base: whether the base moves; its pose is read from ``odom_topic``.
        odom_topic: topic of the base's pose.
        imu: an IMU on the base in place of its pose, as ``TOPIC:FRAME``.
        contacts: feet on the ground, as ``FRAME`` or ``FRAME:RADIUS`` [m], whose forces the legs' efforts tell.
        alike: ``urdf`` if links that are alike in it (legs, arms) err mostly alike, ``none`` if each errs by itself.
        command: topic of the joints' set-points (JointState), as efforts their feed-forward; what is held out is
            simulated under them. Without gains efforts are measured.
        gains: of the joints' controllers, whose efforts are those of the set-points, as ``KP:KD`` or ``JOINT=KP:KD``
            [N m/rad, N m s/rad], or the parameter file of a joint_trajectory_controller.
    """

    urdf: PathLike | None = None
    config: Config | None = None
    xacro_args: Texts = ()
    cutoff: float | None = None
    gravity: Sequence[float] | None = None
    gain: Gains = ()
    lock: Texts | None = None
    merge: bool = False
    wrench: Texts = ()
    joint_topic: str = "joint_states"
    floating_base: bool = False
    odom_topic: str = ODOM
    imu: str | None = None
    contacts: Texts | None = None
    alike: str | None = None
    command: str | None = None
    gains: Texts = ()

    @property
    def topics(self) -> Topics:
        """The topics that recordings are read from."""
        if self.imu is not None and self.odom_topic != ODOM:
            raise InputError("--odom-topic beside --imu: an IMU is in place of the base's pose; leave one of them out")
        imu = IMU if self.imu is None else Imu.parse(self.imu).topic
        return Topics(self.joint_topic, self.odom_topic, imu, self.command or COMMANDS)

    def description(self, bags: Sequence[Path], model: PathLike | None = None) -> DescribedRobot:
        """The robot description, see :func:`~geomid_ros.api.options.description`."""
        return description(self.urdf, bags, model=model, xacro_args=self.xacro_args)

    def configuration(self, model: PathLike | None = None, **values: Any) -> Configuration:
        """The parameters of ``config`` with what the other options say.

        Args:
            model: an estimate.json to start from.
            values: further parameters by their full names.

        Raises:
            InputError: a parameter is unknown or has a wrong value.
        """
        own = {
            "model": None if model is None else str(model),
            "filter.cutoff": self.cutoff,
            "gravity": None if self.gravity is None else list(self.gravity),
            "locked_joints": entries("lock", self.lock or ()) or None,
            "merge_joint_states": self.merge or None,
            "floating_base": self.floating_base or None,
            "imu.frame": None if self.imu is None else Imu.parse(self.imu).frame,
            "alike": self.alike,
            "command.gains": [own for text in entries("gains", self.gains) for own in _gains_of(text)] or None,
            "contacts": entries("contacts", self.contacts or ()) or None,
        }
        said = {name: value for name, value in own.items() if value is not None}
        result = _base(self.config)
        if self.wrench:
            result = result.with_sensors([WrenchSensor.parse(text) for text in texts(self.wrench)])
        return result.with_values(Configuration(said | _gains(self.gain) | values, "options").given)

    def efforts_of_command(self, parameters: Configuration) -> Configuration:
        """The ``parameters`` where nothing is simulated. Raises InputError for set-points that would not be read."""
        if self.command is not None and not parameters.gains:
            raise InputError(
                f"--command {self.command} without --gains: here set-points serve as efforts, by the gains of their "
                "controllers; add --gains KP:KD, or leave --command out to use the reported efforts"
            )
        return parameters


@dataclass(frozen=True, kw_only=True)
class RecordingOptions(RobotOptions):
    """The same, and where to start from and what to judge on.

    Attributes:
        model: an estimate.json to start from.
        hold_out: share of each bag's time, at the end, to judge on; None for 0.3, with ``validate`` 0.
        validate: bags to judge on.
    """

    model: PathLike | None = None
    hold_out: float | None = None
    validate: Paths = ()

    def bags(self, fitted: Paths) -> Bags:
        """The recordings to fit and to judge on.

        Raises:
            InputError: there is none, or one is given twice.
        """
        return Bags(
            fitted=bag_paths(fitted),
            validate=bag_paths(self.validate),
            hold_out=self.hold_out,
            topics=self.topics,
        )


def _base(config: Config | None) -> Configuration:
    if isinstance(config, Configuration):
        return config
    if config is None or isinstance(config, Mapping):
        return Configuration(config, "options" if config is None else "config")
    return Configuration.read(Path(config))


def _gains(given: Gains) -> dict[str, float]:
    """The parameters that factors set."""
    if isinstance(given, Mapping):
        return {f"joint.{joint}.effort_gain": float(factor) for joint, factor in given.items()}
    return dict(_gain(str(entry)) for entry in ([given] if isinstance(given, float | int | str) else given))


def _gain(text: str) -> tuple[str, float]:
    """The parameter that ``[JOINT=]FACTOR`` sets, and its value."""
    joint, _, factor = text.rpartition("=")
    try:
        return (f"joint.{joint}.effort_gain" if joint else "effort_gain"), float(factor)
    except ValueError as error:
        raise InputError(f"gain: '{text}' is not of the form [JOINT=]FACTOR, e.g. -1 or joint3=0.5") from error
