"""The node's parameters: declared from the table, checked by it, and what may change of them."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from geomid_ros.session.configuration import (
    AT_ANY_TIME,
    AT_START,
    PARAMETERS,
    Configuration,
    Parameter,
    find_parameter,
)


def read_parameters(node: Node) -> Configuration:
    """The configuration by a node's parameters, of which it has declared only those that were set.

    Declares every other parameter of the table with its default, and gives all their description and range.

    Raises:
        InputError: a name is unknown or a value out of range.
    """
    given: dict[str, Any] = {name: node.get_parameter(name).value for name in node.get_parameters_by_prefix("")}
    configuration = Configuration(given, "parameters")
    for name in configuration.given:
        node.set_descriptor(name, _descriptor(find_parameter(name)))
    for parameter in PARAMETERS:
        if parameter.name not in given and "*" not in parameter.name:
            node.declare_parameter(parameter.name, parameter.default, _descriptor(parameter))
    return configuration


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=parameter.description,
        additional_constraints=f"may be set {parameter.change}",
        read_only=parameter.change == AT_START,
        dynamic_typing=True,  # an integer is accepted where a real number is meant; the table checks types
    )
    if parameter.minimum is not None and parameter.maximum is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)]
    return descriptor


def changed_names(before: Configuration, after: Configuration) -> list[str]:
    """The names whose values differ, of those that were given ``after``."""
    return [name for name, value in after.given.items() if value != before[name]]


def depends_on_rows(name: str) -> bool:
    """Whether a parameter may change only while there are no rows."""
    return find_parameter(name).change != AT_ANY_TIME
