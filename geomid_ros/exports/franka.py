"""Franka: the load beyond the end effector.

``franka::Robot::setLoad`` takes kg, the translation from the flange to the load's centre of mass in m, and the inertia
in kg m^2, column-major (libfranka, ``robot.h``), about the load's centre of mass (``robot_state.h``, ``I_load``). The
controller adds it to the end effector that is configured in Desk, which setLoad does not change (``m_total``). The
flange is ``link8`` of Franka's URDF. franka_msgs/srv/SetLoad has the same three fields; franka_ros2 offers it as
``/service_server/set_load``.
"""

from __future__ import annotations

from geomid_ros.exports.inertial import Export
from geomid_ros.exports.text import commented, comments, number, numbers

FLANGE = "link8"
_CALL = "ros2 service call /service_server/set_load franka_msgs/srv/SetLoad"
_NOTE = (
    "  The controller adds it to the end effector that is set in Desk (Settings, End Effector): set there what stays",
    "  mounted, and export only what comes beyond it.",
)


def commands(export: Export) -> str:
    """C++ and a service call."""
    mass, com = number(export.inertial.mass), numbers(export.inertial.com)
    columns = numbers(export.inertial.inertia.ravel(order="F"))
    request = f"{{mass: {mass}, center_of_mass: [{com}], load_inertia: [{columns}]}}"
    return (
        commented([*comments(export), *_NOTE], "//")
        + f"\n// libfranka\nrobot.setLoad({mass}, {{{{{com}}}}}, {{{{{columns}}}}});\n"
        + f"\n# ROS 2\n{_CALL} '{request}'\n"
    )
