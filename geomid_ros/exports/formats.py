"""Exports as text to paste: commands for robot controllers, and ``<inertial>`` elements of robot descriptions.

=======  ===============================================================================================================
ur       ``set_target_payload(m, cog, inertia)`` takes kg, the centre of gravity's offset from the tool mount in m, and
         Ixx, Iyy, Izz, Ixy, Ixz, Iyz in kg m^2 about that centre in the axes of the tool flange, none of them beyond
         133; it replaces ``set_payload(m, cog)`` (Script Manual of SW 10.6, ``set_target_payload``). The flange's axes
         are those of ``tool0`` in the URDF, the controller's tool frame of all zeros (ur_description,
         ``ur_macro.xacro``). The ROS 2 driver hands the service ``set_payload`` of its io_and_status_controller to
         these (ur_controllers, ``gpio_controller.cpp``). Its type ur_msgs/srv/SetPayload had mass and centre alone,
         then got the inertia's entries (ur_msgs, pull request 43), and has a geometry_msgs/Inertia from version 3 on
         (pull request 42).
franka   ``franka::Robot::setLoad`` takes kg, the translation from the flange to the load's centre of mass in m, and the
         inertia in kg m^2, column-major (libfranka, ``robot.h``), about the load's centre of mass (``robot_state.h``,
         ``I_load``). The controller adds it to the end effector that is configured in Desk, which setLoad does not
         change (``m_total``). The flange is ``link8`` of Franka's URDF. franka_msgs/srv/SetLoad has the same three
         fields; franka_ros2 offers it as ``/service_server/set_load``.
URDF     inertia about the centre of mass, in the axes of ``<origin>``, here those of the link (ROS wiki, urdf/XML/link)
SDF      the same with ``<pose>``; products of inertia are entries of the matrix, -m x y (SDFormat 1.10, inertial.sdf)
MJCF     ``fullinertia`` about ``pos`` in the body's axes: Ixx Iyy Izz Ixy Ixz Iyz (MuJoCo's XML reference,
         body/inertial)
=======  ===============================================================================================================
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.geometry.pseudo_inertia import INERTIA_NAMES
from geomid_ros.types import FloatArray

if TYPE_CHECKING:
    from geomid_ros.estimation.estimate import UncertainInertia

DIGITS = 9
"""Significant digits of numbers in a description."""
_DIAGONAL_FIRST = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")

_UR_LARGEST = 133.0  # [kg m^2]
_UR_CALL = "ros2 service call /io_and_status_controller/set_payload ur_msgs/srv/SetPayload"
_FRANKA_CALL = "ros2 service call /service_server/set_load franka_msgs/srv/SetLoad"
_FRANKA_NOTE = (
    "  The controller adds it to the end effector that is set in Desk (Settings, End Effector): set there what stays",
    "  mounted, and export only what comes beyond it.",
)


@dataclass(frozen=True, eq=False)
class Export:
    """An ``inertial`` in the axes and about the origin of the link ``frame``, with a ``title`` and ``notes`` for its
    user."""

    title: str
    frame: str
    inertial: UncertainInertia
    notes: tuple[str, ...] = ()


class PayloadFormat(NamedTuple):
    """Payload format of a controller: the suffix of the ``flange``'s name in the manufacturer's URDF, and the
    ``commands`` that set the payload."""

    flange: str
    commands: Callable[[Export], str]


def ur_commands(export: Export) -> str:
    """Return URScript and service calls. Raises InputError for an inertia that the controller refuses."""
    entries = _inertia_entries(export)
    if np.max(np.abs(list(entries.values()))) > _UR_LARGEST:
        raise InputError(
            f"{export.title}: its inertia is beyond the {_UR_LARGEST:g} kg m^2 that a UR's controller takes"
        )
    mass, com = number(export.inertial.mass), _numbers(export.inertial.com)
    inertia = _numbers(entries[key] for key in _DIAGONAL_FIRST)
    centre = "{" + ", ".join(f"{axis}: {number(c)}" for axis, c in zip("xyz", export.inertial.com, strict=True)) + "}"
    named = ", ".join(f"{key}: {number(entries[key])}" for key in _DIAGONAL_FIRST)
    weight = f"mass: {mass}, center_of_gravity: {centre}"
    return (
        _commented([*comments(export), "  On a UR, the payload is all that the flange carries, tool included."], "#")
        + f"\n# URScript\nset_target_payload({mass}, [{com}], [{inertia}])\n"
        + f"# URScript of older software, without the inertia\nset_payload({mass}, [{com}])\n"
        + f"\n# ROS 2, ur_msgs 2 with inertia\n{_UR_CALL} '{{{weight}, {named}}}'\n"
        + f"# ROS 2, ur_msgs 2 without inertia\n{_UR_CALL} '{{{weight}}}'\n"
        + f"# ROS 2, ur_msgs 3\n{_UR_CALL} '{{payload: {{m: {mass}, com: {centre}, {named}}}}}'\n"
    )


def franka_commands(export: Export) -> str:
    """Return C++ code and a service call."""
    mass, com = number(export.inertial.mass), _numbers(export.inertial.com)
    columns = _numbers(export.inertial.inertia.ravel(order="F"))
    request = f"{{mass: {mass}, center_of_mass: [{com}], load_inertia: [{columns}]}}"
    return (
        _commented([*comments(export), *_FRANKA_NOTE], "//")
        + f"\n// libfranka\nrobot.setLoad({mass}, {{{{{com}}}}}, {{{{{columns}}}}});\n"
        + f"\n# ROS 2\n{_FRANKA_CALL} '{request}'\n"
    )


CONTROLLERS = {"ur": PayloadFormat("tool0", ur_commands), "franka": PayloadFormat("link8", franka_commands)}
"""Formats of controllers that accept a payload, by the name of the reader."""
JSON = "json"
"""Name of the format with all sampled robots in one file, with links and effects as in ``estimate.json``."""


def urdf_inertial(export: Export) -> str:
    """``<inertial>`` of a URDF."""
    entries = " ".join(f'{key}="{number(value)}"' for key, value in _inertia_entries(export).items())
    return (
        f'<inertial>\n  <origin xyz="{_numbers(export.inertial.com, " ")}" rpy="0 0 0"/>\n'
        f'  <mass value="{number(export.inertial.mass)}"/>\n  <inertia {entries}/>\n</inertial>\n'
    )


def sdf_inertial(export: Export) -> str:
    """``<inertial>`` of an SDF, for Gazebo."""
    entries = "".join(f"<{key}>{number(value)}</{key}>" for key, value in _inertia_entries(export).items())
    return (
        f"<inertial>\n  <pose>{_numbers(export.inertial.com, ' ')} 0 0 0</pose>\n"
        f"  <mass>{number(export.inertial.mass)}</mass>\n  <inertia>{entries}</inertia>\n</inertial>\n"
    )


def mjcf_inertial(export: Export) -> str:
    """``<inertial>`` of an MJCF, for MuJoCo."""
    entries = _inertia_entries(export)
    full = _numbers((entries[key] for key in _DIAGONAL_FIRST), " ")
    position, mass = _numbers(export.inertial.com, " "), number(export.inertial.mass)
    return f'<inertial pos="{position}" mass="{mass}" fullinertia="{full}"/>\n'


def number(value: float) -> str:
    """Format a number without an exponent: YAML 1.1 reads ``1e-05`` as text, and URScript documents no exponents."""
    return str(np.format_float_positional(value, precision=DIGITS, fractional=False, trim="0"))


def _numbers(values: Iterable[float], between: str = ", ") -> str:
    return between.join(number(value) for value in values)


def _inertia_entries(export: Export) -> dict[str, float]:
    return dict(zip(INERTIA_NAMES, map(float, export.inertial.quantities[4:]), strict=True))


def comments(export: Export) -> list[str]:
    """Return the title, each number with its standard deviation, and the notes, one line each."""
    quantities, std = export.inertial.quantities, export.inertial.std
    return [
        export.title,
        f"  mass [kg]              {_with_std(quantities[:1], std[:1])}",
        f"  centre of mass [m]     {_with_std(quantities[1:4], std[1:4])}",
        f"  Ixx Iyy Izz [kg m^2]   {_with_std(quantities[[4, 6, 9]], std[[4, 6, 9]])}",
        f"  Ixy Ixz Iyz [kg m^2]   {_with_std(quantities[[5, 7, 8]], std[[5, 7, 8]])}",
        *(["  the uncertainty of these numbers is not known"] if not export.inertial.has_std else []),
        *(f"  {note}" for note in export.notes),
    ]


def _with_std(values: FloatArray, std: FloatArray) -> str:
    pairs = zip(values, std, strict=True)
    return ", ".join(f"{value:.5g} ± {sigma:.2g}" if np.isfinite(sigma) else f"{value:.5g}" for value, sigma in pairs)


def _commented(lines: Sequence[str], mark: str) -> str:
    """Return the lines as comments that begin with ``mark``."""
    return "".join(f"{mark} {_printable(line)}\n" for line in lines)


def xml_comment(lines: Sequence[str]) -> str:
    """Return the lines as one XML comment, which must not contain two consecutive hyphens."""
    return "<!-- " + "\n     ".join(re.sub("-(?=-)", "- ", _printable(line)) for line in lines) + " -->\n"


def _printable(line: str) -> str:
    """Replace unprintable characters: a line break in a name from a file must not end the comment."""
    return "".join(character if character.isprintable() else " " for character in line)
