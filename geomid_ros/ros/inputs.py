"""Inputs of the node: parameters, and subscriptions, which count every message and check the publishers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate, pairwise
from operator import attrgetter
from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu, JointState

from geomid_ros.errors import InputError
from geomid_ros.live.threads import MOST_AT_ONCE, Received
from geomid_ros.session.configuration import (
    AT_START,
    BY_NAME,
    Configuration,
    Parameter,
    Value,
    checked_values,
    find_parameter,
)
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM


def read_parameters(node: Node) -> Configuration:
    """Read the configuration from a node's parameters, as :func:`given_parameters`."""
    return Configuration(given_parameters(node, BY_NAME), "parameters")


def given_parameters(node: Node, table: Mapping[str, Parameter]) -> dict[str, Value]:
    """Return a node's parameters, of which only the given ones are declared.

    Declares every other parameter of the table with its default; sets the description and range of all.

    Raises:
        InputError: a name is unknown or a value out of range.
    """
    given = {name: node.get_parameter(name).value for name in node.get_parameters_by_prefix("")}
    values = checked_values(given, table)
    describe(node, values, table)
    for name, parameter in table.items():
        if name not in given and "*" not in name:
            node.declare_parameter(name, parameter.default, _descriptor(parameter))
    return values


def describe(node: Node, names: Iterable[str], table: Mapping[str, Parameter] = BY_NAME) -> None:
    """Set the description and range of declared parameters."""
    for name in names:
        node.set_descriptor(name, _descriptor(find_parameter(name, table)))


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=parameter.description,
        additional_constraints=f"may be set {parameter.change}",
        read_only=parameter.change == AT_START,
        dynamic_typing=True,  # accepts an integer for a real number; the table checks types
    )
    if parameter.minimum is not None and parameter.maximum is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)]
    return descriptor


_CLASSES = {kind.__name__: kind for kind in (WrenchStamped, Odometry, Imu, JointState)}


class RosTypes:
    """Deserialises messages with ROS where rosbags is not installed; see
    :func:`~geomid_ros.signals.messages.read_without_rosbags`."""

    def deserialize_cdr(self, data: bytes, kind: str) -> Any:
        """Return the message of this type in ``data``. Raises the errors of rclpy for invalid bytes."""
        return deserialize_message(data, _CLASSES[kind.rpartition("/")[2]])


# Best effort matches any publisher; the depth bridges pauses of Python at 1 kHz.
DATA = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS of subscriptions to data."""


class _Polled(CallbackGroup):
    """Callback group whose subscriptions the executor does not wait for, except for their events: waiting for a message
    takes the executor ten times as long as taking it."""

    def can_execute(self, entity: Any) -> bool:
        """True for anything but a subscription."""
        return not isinstance(entity, Subscription)

    def beginning_execution(self, entity: Any) -> bool:
        """True for anything but a subscription."""
        return self.can_execute(entity)

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


@dataclass(eq=False)
class _Input:
    """Subscribed topic.

    ``several``: it may have more than one publisher; ``kind``: class of its messages if they are polled; ``number``:
    the publisher's sequence number of the last message; ``latest``: time of its receipt [s]; ``policy``: QoS policy in
    which a publisher was last incompatible.
    """

    name: str
    several: bool
    kind: type | None
    subscription: Subscription = field(init=False)
    number: int | None = None
    latest: float = -math.inf
    policy: str = "quality of service"


class Inputs:
    """Subscribes to topics, counts lost and dropped messages, and reports unsuitable publishers."""

    def __init__(self, node: Node, ledger: Ledger) -> None:
        """
        Args:
            node: subscribes.
            ledger: counts lost and dropped messages.
        """
        self._node = node
        self._ledger = ledger
        self._inputs: list[_Input] = []
        self.names: dict[str, str] = {}
        """Resolved names of the topics that were subscribed to."""
        self.only_streams_commands = False
        """True if commands are subscribed to only to be streamed."""

    def subscribe_data(self, kind: type, name: str, several: bool = False) -> None:
        """Subscribe to data, which wait until :meth:`poll` polls them.

        Args:
            kind: class of the messages.
            name: of the topic.
            several: True if the topic may have more than one publisher. On any other topic, messages of several
                publishers are ambiguous, and all are dropped.

        Raises:
            InputError: the topic name is invalid.
        """
        self._subscribe(_Input(name, several, kind), kind, lambda _: None, DATA)

    def listen_as(self, configuration: Configuration) -> None:
        """Subscribe to the data that a configuration asks for. Raises InputError as :meth:`subscribe_data`."""
        self.subscribe_data(JointState, JOINT_STATES, several=configuration["merge_joint_states"])
        if configuration.gains:
            self.subscribe_data(JointState, COMMANDS)
        if configuration["imu.frame"]:
            self.subscribe_data(Imu, IMU)
        elif configuration.floating_base:
            self.subscribe_data(Odometry, ODOM)
        for sensor in configuration.sensors:
            self.subscribe_data(WrenchStamped, sensor.topic)

    def stream_commands(self, wanted: bool) -> None:
        """Subscribe to commands while they are ``wanted``, if nothing else needs them and other data are subscribed
        to."""
        wanted = wanted and any(entry.kind for entry in self._inputs)
        if wanted and not any(entry.name == COMMANDS for entry in self._inputs):
            self.subscribe_data(JointState, COMMANDS)
            self.only_streams_commands = True
        elif not wanted and self.only_streams_commands:
            self._unsubscribe({COMMANDS})

    def subscribe(self, kind: type, name: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        """Subscribe to a topic other than data."""
        self._subscribe(_Input(name, several=True, kind=None), kind, callback, qos)

    def close(self) -> None:
        """Unsubscribe from data."""
        self._unsubscribe({entry.name for entry in self._inputs if entry.kind})

    def _unsubscribe(self, topics: Collection[str]) -> None:
        for entry in self._inputs:
            if entry.name in topics:
                self._node.destroy_subscription(entry.subscription)
        self._inputs = [
            entry for entry in self._inputs if entry.name not in topics
        ]  # messages sent meanwhile are not lost
        self.only_streams_commands &= COMMANDS not in topics

    def poll(self, topic: str | None = None) -> list[Received]:
        """Poll the data of all topics, or of one. They are serialised, as many are decoded at once, and in their order
        of arrival. Messages of topics with too many publishers are dropped."""
        entries = [entry for entry in self._inputs if entry.kind and topic in (None, entry.name)]
        messages = [message for entry in entries for message in self._waiting(entry)]
        return sorted(messages, key=attrgetter("time"))

    def _waiting(self, entry: _Input) -> list[Received]:
        taken: list[tuple[bytes, dict[str, int]]] = []
        # The subscription's count, as the node's would copy the graph.
        ambiguous = not entry.several and entry.subscription.get_publisher_count() > 1
        now, wall_clock, handle = time.perf_counter(), time.time(), entry.subscription.handle
        with handle:
            while len(taken) < MOST_AT_ONCE and (message := handle.take_message(entry.kind, True)):
                taken.append(message)
        if not taken:
            return []
        self._count_missing(entry, [] if ambiguous else [info["publication_sequence_number"] for _, info in taken])
        if ambiguous:
            self._ledger.drop(entry.name, "several publishers", len(taken))
            return []
        # Messages without a time of receipt count as received now.
        behind = now - wall_clock
        receipt_times = (min(now, behind + 1e-9 * (info["received_timestamp"] or math.inf)) for _, info in taken)
        # In the order of the topic, even if the wall clock is set.
        _, *times = accumulate(receipt_times, max, initial=entry.latest)
        entry.latest = times[-1]
        return [Received(entry.name, data, at) for (data, _), at in zip(taken, times, strict=True)]

    def _subscribe(self, entry: _Input, kind: type, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        name, polled = entry.name, entry.kind is not None
        events = SubscriptionEventCallbacks(
            message_lost=partial(self._on_lost, entry), incompatible_qos=partial(self._on_incompatible, entry)
        )
        options = QoSOverridingOptions.with_default_policies()
        try:
            entry.subscription = self._node.create_subscription(
                kind,
                name,
                callback,
                qos,
                callback_group=_Polled() if polled else None,
                event_callbacks=events,
                qos_overriding_options=options,
                raw=polled,
            )
        except NameValidationException as error:
            raise InputError(f"parameters: topic '{name}': {' '.join(str(error).split())}") from error
        except (RuntimeError, AssertionError, AttributeError) as error:  # raised by rclpy for unexpected values
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"parameters: topic '{name}': its qos_overrides cannot be used ({reason})") from error
        self._inputs.append(entry)
        self.names[name] = entry.subscription.topic_name

    def _count_missing(self, entry: _Input, numbers: list[int]) -> None:
        """Count as lost the messages that a publisher sent between its last one and these with sequence ``numbers``.

        With several publishers the numbers cannot be attributed.
        """
        sequence = [*([] if entry.number is None else [entry.number]), *numbers]
        entry.number = numbers[-1] if numbers and not entry.several else None
        missing = sum(max(0, after - number - 1) for number, after in pairwise(sequence))
        if entry.number is not None and missing:
            self._ledger.lose(entry.name, missing)

    def _on_lost(self, entry: _Input, event: Any) -> None:
        # Sequence numbers are better: messages beyond the subscription's depth cause no event.
        if entry.number is None:
            self._ledger.lose(entry.name, event.total_count_change)

    def _on_incompatible(self, entry: _Input, event: Any) -> None:
        entry.policy = qos_policy_name_from_kind(event.last_policy_kind).lower()

    @property
    def problems(self) -> tuple[str, ...]:
        """Sentences on problems with the present publishers."""
        return tuple(problem for entry in self._inputs for problem in self._problems_of(entry))

    def _problems_of(self, entry: _Input) -> list[str]:
        problems, usable, topic = [], [], entry.subscription.topic_name
        for publisher in self._node.get_publishers_info_by_topic(topic):
            compatibility, reason = qos_check_compatible(publisher.qos_profile, entry.subscription.qos_profile)
            if compatibility != QoSCompatibility.ERROR:
                usable.append(publisher)
            else:
                name, why = _full_name(publisher), f"{entry.policy} ({reason.rstrip(';')})"
                problems.append(f"{topic}: no messages from {name}, incompatible QoS: {why}")
        if len(usable) > 1 and not entry.several:
            dropped = f"{topic} has {len(usable)} publishers; all its messages are dropped until one is left"
            problems.append(f"{dropped}: {', '.join(sorted(map(_full_name, usable)))}")
        return problems


def _full_name(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
