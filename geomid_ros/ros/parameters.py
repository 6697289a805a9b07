"""The node's parameters: declared from the table in ``files.configuration``, checked by it."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from geomid_ros.session.configuration import PARAMETERS, Configuration, Parameter, find_parameter


def read_parameters(node: Node) -> Configuration:
    """The configuration of a node that declares what its overrides name.

    Declares every other parameter of the table with its default, and gives all their description and range. Raises
    InputError for unknown names and values out of range.
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
        read_only=True,
        dynamic_typing=True,  # an integer is accepted where a real number is meant; the table checks types
    )
    if parameter.minimum is not None and parameter.maximum is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)]
    return descriptor
