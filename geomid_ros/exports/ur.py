"""Universal Robots: the payload of a controller.

``set_target_payload(m, cog, inertia)`` takes kg, the centre of gravity's offset from the tool mount in m, and Ixx, Iyy,
Izz, Ixy, Ixz, Iyz in kg m^2 about that centre in the axes of the tool flange, none of them beyond 133; it replaces
``set_payload(m, cog)`` (Script Manual of SW 10.6, ``set_target_payload``). The flange's axes are those of ``tool0`` in
the URDF, the controller's tool frame of all zeros (ur_description, ``ur_macro.xacro``). The ROS 2 driver hands the
service ``set_payload`` of its io_and_status_controller to these (ur_controllers, ``gpio_controller.cpp``). Its type
ur_msgs/srv/SetPayload had mass and centre alone, then got the inertia's entries (ur_msgs, pull request 43), and has a
geometry_msgs/Inertia from version 3 on (pull request 42).
"""

from __future__ import annotations

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.exports.inertial import Export
from geomid_ros.exports.text import commented, comments, inertia_entries, number, numbers

FLANGE = "tool0"
_LARGEST = 133.0  # [kg m^2]
_ORDER = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_CALL = "ros2 service call /io_and_status_controller/set_payload ur_msgs/srv/SetPayload"


def commands(export: Export) -> str:
    """URScript and service calls. Raises InputError for an inertia that the controller refuses."""
    entries = inertia_entries(export)
    if np.max(np.abs(list(entries.values()))) > _LARGEST:
        raise InputError(f"{export.title}: its inertia is beyond the {_LARGEST:g} kg m^2 that a UR's controller takes")
    mass, com = number(export.inertial.mass), numbers(export.inertial.com)
    inertia = numbers(entries[key] for key in _ORDER)
    centre = "{" + ", ".join(f"{axis}: {number(c)}" for axis, c in zip("xyz", export.inertial.com, strict=True)) + "}"
    named = ", ".join(f"{key}: {number(entries[key])}" for key in _ORDER)
    weight = f"mass: {mass}, center_of_gravity: {centre}"
    return (
        commented([*comments(export), "  A UR wants all that its flange carries: the tool and what it holds."], "#")
        + f"\n# URScript\nset_target_payload({mass}, [{com}], [{inertia}])\n"
        + f"# URScript of older software, without the inertia\nset_payload({mass}, [{com}])\n"
        + f"\n# ROS 2, ur_msgs 2 with inertia\n{_CALL} '{{{weight}, {named}}}'\n"
        + f"# ROS 2, ur_msgs 2 without inertia\n{_CALL} '{{{weight}}}'\n"
        + f"# ROS 2, ur_msgs 3\n{_CALL} '{{payload: {{m: {mass}, com: {centre}, {named}}}}}'\n"
    )
