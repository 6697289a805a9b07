"""The one table of parameters.

The node declares them, the command line reads the same YAML file, and ``make docs`` writes the reference.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation.estimator import EstimatorSettings
from geomid_ros.estimation.identifier import BufferSettings
from geomid_ros.files.parameter_file import read_parameter_file
from geomid_ros.inference.prior import GAIN
from geomid_ros.model.channels import AXES, WrenchSensor
from geomid_ros.model.controller import gains_of
from geomid_ros.model.effects import DEFAULT_CANDIDATES, DEFAULT_EFFECTS, IdentifiedEffect, identified_effect
from geomid_ros.model.moving_base import Contact
from geomid_ros.model.weighed_masses import WeighedMass
from geomid_ros.options import named_once
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray

Value: TypeAlias = bool | int | float | str | list[str] | list[float]
T = TypeVar("T")


@dataclass(frozen=True)
class Parameter:
    """A parameter of the node.

    Attributes:
        name: full name; ``*`` in it stands for the name of a joint, a channel or a wrench sensor.
        default: its default; the type of the parameter is the default's.
        description: its effect, with its unit.
        minimum, maximum: the closed range of a number.
        choices: the values of a text; empty for any.
        defines_rows: True if rows depend on it: earlier rows remain valid only if all of these parameters are the same.
        change: when it may change in a running node: never if it names files, as others may be on the network.
    """

    name: str
    default: Value
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    defines_rows: bool = True
    change: str = "without rows"

    def checked(self, name: str, value: Any) -> Value:
        """Return a value of this parameter, whose full name is ``name``. Raises InputError if it does not fit."""
        if isinstance(self.default, list):
            return _checked_list(name, value, type(self.default[0]))
        checked: Value = _real(value) if isinstance(self.default, float) else _of_python(value)
        if type(checked) is not type(self.default):
            raise InputError(f"{name} is {checked!r}, expected {_KINDS[type(self.default)]}")
        if isinstance(checked, str) and self.choices and checked not in self.choices:
            raise unknown_name(f"value of {name}", checked, self.choices)
        low, high = self.minimum, self.maximum
        if isinstance(checked, float) and low is not None and high is not None and not low <= checked <= high:
            raise InputError(f"{name} is {checked:g}, expected a number from {low:g} to {high:g}")
        return checked


def _checked_list(name: str, value: Any, kind: type) -> list[Any]:
    value = _of_python(value)
    convert = _real if kind is float else _of_python
    entries: list[Any] = [convert(entry) for entry in (value if isinstance(value, list | tuple) else [value])]
    is_valid = all(isinstance(entry, kind) for entry in entries)
    if not is_valid or (kind is float and not np.all(np.isfinite(entries))):
        raise InputError(f"{name} is {value!r}, expected a list of {'finite numbers' if kind is float else 'texts'}")
    return [entry for entry in entries if entry != ""]


def _of_python(value: Any) -> Any:
    """Convert a scalar or an array of numpy to Python's types; return any other value unchanged."""
    return value.tolist() if hasattr(value, "tolist") else value


def _real(value: Any) -> Any:
    """Convert an integer to a real number, and others like :func:`_of_python`."""
    value = _of_python(value)
    return float(value) if type(value) is int and abs(value) < 2**63 else value


# ROS cannot tell the type of an empty list: one empty string stands for it.
_NONE = [""]
_SIDES = ("motor", "link")
_ALIKE = ("urdf", "none")
# Parameters that ROS gives every node; they are not checked here.
_OF_ROS = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..+")
_OF_SENSOR = ("topic", "frame", "frame_id", "role", "axes", "sign")  # each is wrench.*.KEY in the table
_not_of_rows = partial(Parameter, defines_rows=False)
AT_START, AT_ANY_TIME = "at the start", "at any time"
_at_start = partial(_not_of_rows, change=AT_START)
_at_any_time = partial(_not_of_rows, change=AT_ANY_TIME)
_KINDS = {bool: "true or false", float: "a number", str: "a text"}

PARAMETERS = (
    _at_start("robot_description", "", "URDF text; empty: taken from the topic robot_description"),
    _at_start("model", "", "estimate.json of an earlier run to start from instead of the URDF's inertias"),
    _at_start("prior", "", "population.json of the robot's type to start from instead of the URDF's inertias"),
    _not_of_rows(
        "alike",
        "urdf",
        "identical links of the URDF (legs, arms) have correlated errors; none: independent errors",
        choices=_ALIKE,
    ),
    Parameter("links", _NONE, "moving links to identify; empty: all with a mass"),
    _at_any_time("known", _NONE, "weighed masses, as LINK=MASS:STD, LINK+LINK=MASS:STD or total=MASS:STD [kg]"),
    Parameter("effects", list(DEFAULT_EFFECTS), "effects identified at every joint and wrench sensor"),
    Parameter("candidates", list(DEFAULT_CANDIDATES), "effects added where the data need them"),
    Parameter("floating_base", False, "the base moves; its pose is read from the topic odom"),
    Parameter(
        "imu.frame", "", "link of an IMU on the base; its messages come on the topic imu and replace odom; empty: none"
    ),
    Parameter(
        "contacts",
        _NONE,
        "feet on the ground, as FRAME or FRAME:RADIUS [m]; contact forces are computed from leg efforts",
    ),
    Parameter("locked_joints", _NONE, "joints of the URDF that never move and are in no message, assumed at zero"),
    Parameter("gravity", [0.0, 0.0, -9.81], "gravity in the base (world) frame [m/s^2]"),
    Parameter("wrenches", _NONE, "names of wrench sensors; each is described under wrench.NAME"),
    Parameter("wrench.*.topic", "", "topic of the sensor's geometry_msgs/WrenchStamped; empty: the sensor's name"),
    Parameter("wrench.*.frame", "", "frame of the wrench: a link, or for a force plate the world (odom)"),
    Parameter("wrench.*.frame_id", "", "frame_id of the messages, if it differs from this frame's name"),
    Parameter(
        "wrench.*.role", "mounted", "mounted (in the chain: measures all distal parts) or external (a known load)"
    ),
    Parameter("wrench.*.axes", list(AXES), "measured axes"),
    Parameter("wrench.*.sign", 1.0, "-1 if the sensor reports the reaction", -1.0, 1.0),
    Parameter(
        "command.gains",
        _NONE,
        "gains of motors without torque sensors, as KP:KD or JOINT=KP:KD; efforts are those of the set-points on "
        "joint_commands",
    ),
    Parameter("command.delay", 0.0, "time until a command acts [s]; the remaining delay is identified", -0.5, 0.5),
    Parameter("motors", _NONE, "joints in the order of the motors in Unitree's LowState and LowCmd"),
    Parameter("merge_joint_states", False, "joint_states has several publishers, each with some of the joints"),
    Parameter("effort_gain", 1.0, "factor from message efforts to N m (or N); negative reverses the sign", -1e6, 1e6),
    Parameter("joint.*.effort_gain", 1.0, "the same for one joint", -1e6, 1e6),
    Parameter(
        "effort_side",
        "motor",
        "where efforts are measured: motor (currents), or link (behind the gear)",
        choices=_SIDES,
    ),
    Parameter("joint.*.effort_side", "motor", "the same for one joint", choices=_SIDES),
    Parameter("filter.cutoff", 5.0, "cutoff of the zero-phase low-pass filter on all signals [Hz]", 0.05, 500.0),
    Parameter("filter.period", 0.0, "period of the time grid [s]; 0: that of the first joint messages", 0.0, 1.0),
    Parameter("filter.max_gap", 0.5, "a longer pause of a topic starts a new segment [s]", 0.001, 60.0),
    _at_any_time(
        "gamma", 0.0, "weight of the prior relative to the rows; 0: estimated from the data for each link", 0.0, 1e6
    ),
    _at_any_time(
        "objective", "residual", "objective: residual (Remark 3 of the paper) or geodesic (its equation (19))"
    ),
    _at_any_time("solver", "trust_region", "solver of the geodesic objective: trust_region or cyclic (the paper's)"),
    _at_any_time(
        "sigma.*", 1.0, "standard deviation of a channel's noise [N m, N], if known (else from residuals)", 1e-9, 1e9
    ),
    Parameter(
        "forgetting_time",
        0.0,
        "time in motion after which the weight of data falls to 1/e [s]; 0: no forgetting",
        0.0,
        1e6,
    ),
    _not_of_rows("still_speed", 1e-3, "speed below which a joint counts as standing still [rad/s, m/s]", 0.0, 10.0),
    _not_of_rows(
        "still_distance", 1e-2, "at standstill, smallest distance between two poses that are used [rad, m]", 0.0, 10.0
    ),
    _at_any_time("solve_period", 1.0, "shortest time between estimates [s]", 0.001, 3600.0),
    _not_of_rows(
        "gap.memory", 120.0, "length of the message memory for ~/find_gap and ~/payload [s]; 0: none", 0.0, 3600.0
    ),
    _not_of_rows("payload.frame", "", "flange whose payload is identified; empty: the last moving link"),
    _not_of_rows(
        "payload.gain", GAIN, "relative standard deviation of the common effort gain; 0: calibrated sensors", 0.0, 0.99
    ),
    _at_start("active", True, "use data from startup; otherwise wait for ~/start"),
    _at_start(
        "lifecycle",
        "none",
        "lifecycle node, which its manager configures and activates (managed), or which does so itself (autostart)",
        choices=("none", "managed", "autostart"),
    ),
    _at_start("checkpoint.folder", "", "folder for checkpoints, used by this node alone; empty: no checkpoints"),
    _at_start("checkpoint.period", 2.0, "time between checkpoints, about the data that a crash loses [s]", 0.1, 3600.0),
    _at_start("dashboard", False, "show the node on a local page, as geomid dashboard does"),
    _at_start("output_folder", "", "output folder of ~/save and of the shutdown; empty: the working directory"),
)
BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}


def naming(place: str, make: Callable[..., T], *arguments: Any) -> T:
    """Return ``make(*arguments)``; an InputError of it then names the ``place``: a source, or a key."""
    try:
        return make(*arguments)
    except InputError as error:
        raise InputError(f"{place}: {error}") from error


def find_parameter(name: str, table: Mapping[str, Parameter] = BY_NAME) -> Parameter:
    """Find the parameter of a full name. Raises InputError with the valid names for an unknown one."""
    if name in table:
        return table[name]
    first, _, rest = name.partition(".")
    for parameter in table.values():
        head, star, tail = parameter.name.partition(".*")
        if star and first == head and rest.endswith(tail) and len(rest) > len(tail):
            return parameter
    raise unknown_name("parameter", name, table)


def checked_values(given: Mapping[str, Any], table: Mapping[str, Parameter] = BY_NAME) -> dict[str, Value]:
    """Return values by full name, without those of ROS. Raises InputError for an unknown name or a wrong value."""
    own = {name: value for name, value in given.items() if not _OF_ROS.fullmatch(name)}
    return {name: find_parameter(name, table).checked(name, value) for name, value in own.items()}


class Configuration:
    """Checked parameters, and the settings of the lower layers that they define."""

    def __init__(self, values: Mapping[str, Any] | None = None, source: str = "parameters") -> None:
        """Check the values that do not depend on the robot.

        Args:
            values: parameters by full name; missing ones have their defaults. Parameters of ROS itself are ignored.
            source: their origin, for messages.

        Raises:
            InputError: a parameter is unknown or has a wrong value; ``source`` and the key are named.
        """
        self.source = source
        self._values = naming(source, checked_values, values or {})
        naming(source, self._check)
        _ = self.signals(()), self.estimator()

    def _check(self) -> None:
        _ = self.effects, self.candidates, self.sensors, self.contacts, self.gains, self.gravity, self.buffer

    @staticmethod
    def read(path: Path) -> Configuration:
        """Read a ROS parameter file (YAML). Raises InputError naming the file and the key."""
        return Configuration(read_parameter_file(path), str(path))

    def with_values(self, values: Mapping[str, Any]) -> Configuration:
        """Return a copy with these values replaced."""
        return Configuration({**self._values, **values}, self.source)

    def with_sensors(self, sensors: Sequence[WrenchSensor]) -> Configuration:
        """Return a copy with these wrench sensors instead of the present ones."""
        values = {name: value for name, value in self._values.items() if not name.startswith("wrench")}
        values["wrenches"] = names = [f"sensor{index}" for index in range(len(sensors))]
        for name, sensor in zip(names, sensors, strict=True):
            values |= {f"wrench.{name}.{key}": getattr(sensor, key) for key in _OF_SENSOR}
        return Configuration(values, self.source)

    @property
    def given_values(self) -> dict[str, Value]:
        """Values that were given, by full name."""
        return dict(self._values)

    def __getitem__(self, name: str) -> Any:
        """The value of a parameter."""
        default = find_parameter(name).default
        return self._values.get(name, [e for e in default if e != ""] if isinstance(default, list) else default)

    def _under(self, prefix: str, suffix: str = "") -> dict[str, Any]:
        """Values of all given ``prefix.NAME suffix``, by NAME."""
        head = prefix + "."
        return {
            name[len(head) : len(name) - len(suffix)]: value
            for name, value in self._values.items()
            if name.startswith(head) and name.endswith(suffix)
        }

    @property
    def row_parameters(self) -> dict[str, Value]:
        """Values, by full name, of parameters that define rows and their weights, without those of the model file."""
        single = {parameter.name for parameter in PARAMETERS if "*" not in parameter.name}
        names = sorted(single | self._values.keys())
        return {name: self[name] for name in names if find_parameter(name).defines_rows}

    @property
    def effects(self) -> list[IdentifiedEffect]:
        """Effects to identify everywhere, with the effects that they include."""
        parts = dict.fromkeys(part for effect in self._named("effects") for part in effect.parts)
        return [part for part in parts if isinstance(part, IdentifiedEffect)]

    @property
    def candidates(self) -> list[IdentifiedEffect]:
        """Effects to identify where the data need them; if there are any, also other shapes of :attr:`effects`."""
        keys = ("effects", "candidates") if self["candidates"] else ()
        trials = [trial for key in keys for effect in self._named(key) for trial in type(effect).coarse_grid()]
        return [effect for effect in trials if isinstance(effect, IdentifiedEffect) and effect not in self.effects]

    def _named(self, key: str) -> list[IdentifiedEffect]:
        return [naming(key, identified_effect, name) for name in dict.fromkeys(self[key])]

    @property
    def gravity(self) -> FloatArray:
        """Gravity ``(3,)`` in the base frame."""
        if len(self["gravity"]) != 3:
            raise InputError(f"gravity has {len(self['gravity'])} entries, expected 3")
        return np.array(self["gravity"])

    @property
    def floating_base(self) -> bool:
        """True if the base moves, as measured by its odometry or its IMU."""
        return bool(self["floating_base"] or self["imu.frame"])

    @property
    def contacts(self) -> list[Contact]:
        """Feet whose forces follow from their legs' efforts. Raises InputError if the base's motion is not measured."""
        if self["contacts"] and not self.floating_base:
            raise InputError("contacts need an IMU on the base (--imu TOPIC:FRAME, imu.frame) or its pose")
        return [*map(Contact.parse, self["contacts"])]

    @property
    def gains(self) -> dict[str, tuple[float, float]]:
        """Gains kp and kd by joint, those of all other joints under an empty name; none if efforts are measured."""
        texts = (entry.rpartition("=") for entry in self["command.gains"])
        pairs = ((joint, naming("command.gains", gains_of, text)) for joint, _, text in texts)
        return named_once("command.gains", pairs, "for each joint its own: JOINT=KP:KD")

    @property
    def sensors(self) -> list[WrenchSensor]:
        """Declared wrench sensors."""
        for name in {full.split(".")[1] for full in self._values if full.startswith("wrench.")}:
            if name not in self["wrenches"]:
                raise InputError(f"wrench.{name} is described but 'wrenches' does not list '{name}'")
        return [self._sensor(name) for name in self["wrenches"]]

    def _sensor(self, name: str) -> WrenchSensor:
        fields = {key: self[f"wrench.{name}.{key}"] for key in _OF_SENSOR}
        if not fields["frame"]:
            raise InputError(f"wrench.{name}.frame is not given")
        fields |= {"topic": fields["topic"] or name, "axes": tuple(fields["axes"])}
        return naming(f"wrench.{name}", partial(WrenchSensor, **fields))

    def behind_gear(self, joints: Sequence[str]) -> frozenset[str]:
        """Joints whose efforts are measured on the link side of the gear. Raises InputError for a side of a joint that
        is not one of the description's ``joints``."""
        sides = self._under("joint", ".effort_side")
        if unknown := sides.keys() - joints:
            raise InputError(f"{self.source}: {unknown_name('joint with an effort_side', min(unknown), joints)}")
        return frozenset(joint for joint in joints if sides.get(joint, self["effort_side"]) == "link")

    def signals(self, joints: Sequence[str]) -> SignalSettings:
        """Settings of the signal pipeline for a robot with these joints."""
        by_joint = self._under("joint", ".effort_gain")
        common = self["effort_gain"]
        gains = {joint: by_joint.get(joint, common) for joint in joints} | by_joint
        settings = partial(
            SignalSettings,
            cutoff=self["filter.cutoff"],
            period=self["filter.period"],
            max_gap=self["filter.max_gap"],
            effort_gain=gains if by_joint else common,
            merge=self["merge_joint_states"],
        )
        return naming(self.source, settings)

    def estimator(self, channels: Sequence[str] | None = None) -> EstimatorSettings:
        """Settings of the estimator for a model with these channels; ``sigma.*`` may have dots for their slashes. It is
        left out without channels."""
        sigma = {} if channels is None else self._under("sigma")
        by_name = {alias: name for name in channels or () for alias in (name, name.replace("/", "."))}
        if unknown := sigma.keys() - by_name.keys():
            raise InputError(f"{self.source}: sigma: {unknown_name('channel', min(unknown), channels or ())}")
        settings = partial(
            EstimatorSettings,
            self["gamma"] or None,
            {by_name[name]: value for name, value in sigma.items()} or None,
            self["objective"],
            self["solver"],
            known=tuple(naming(self.source, WeighedMass.parse, text) for text in self["known"]),
            cutoff=self["filter.cutoff"],
        )
        return naming(self.source, settings)

    @property
    def buffer(self) -> BufferSettings:
        """Settings of the row buffer."""
        return BufferSettings(self["still_speed"], self["still_distance"], self["forgetting_time"] or np.inf)
