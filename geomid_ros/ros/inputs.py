"""What the node takes in: its parameters, and by subscriptions every message, which it counts; who publishes them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
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
from rclpy.qos import (
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu, JointState

from geomid_ros.errors import InputError
from geomid_ros.live.inbox import MOST_AT_ONCE, Received
from geomid_ros.session.configuration import (
    AT_ANY_TIME,
    AT_START,
    PARAMETERS,
    Configuration,
    Parameter,
    find_parameter,
)
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM


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


_CLASSES = {kind.__name__: kind for kind in (WrenchStamped, Odometry, Imu, JointState)}


class RosTypes:
    """Reads serialised messages by ROS itself, where rosbags is not installed; see
    :func:`~geomid_ros.signals.decoding.read_without_rosbags`."""

    def deserialize_cdr(self, data: bytes, kind: str) -> Any:
        """The message of this type in ``data``. Raises what rclpy raises for bytes that are none."""
        return deserialize_message(data, _CLASSES[kind.rpartition("/")[2]])


class _Polled(CallbackGroup):
    """Subscriptions that the executor leaves alone, but for what happens to them: to wait for a message takes it ten
    times as long as to take it."""

    def can_execute(self, entity: Any) -> bool:
        """Whether it is anything but a subscription."""
        return not isinstance(entity, Subscription)

    def beginning_execution(self, entity: Any) -> bool:
        """The same."""
        return self.can_execute(entity)

    def ending_execution(self, entity: Any) -> None:
        """Nothing waits for it."""


@dataclass(frozen=True)
class _Input:
    """A subscribed topic; ``several``: it may have more than one publisher; ``kind`` of its messages, if they wait
    until they are looked for."""

    name: str
    subscription: Subscription
    several: bool
    kind: type | None = None


class Inputs:
    """Subscribes, counts messages that are not taken, and reports publishers that do not fit."""

    def __init__(self, node: Node, ledger: Ledger) -> None:
        """
        Args:
            node: subscribes.
            ledger: is told of messages that are not taken.
        """
        self._node = node
        self._ledger = ledger
        self._inputs: list[_Input] = []
        self._numbers: dict[str, int] = {}  # of the last messages, as the publishers count them
        self._latest: dict[str, float] = {}  # when the last messages came
        self._policies: dict[str, str] = {}  # in which publishers were last incompatible

    def listen(self, kind: type, name: str, several: bool = False) -> None:
        """Subscribe to data, which wait until :meth:`waiting` looks for them.

        Args:
            kind: class of the messages.
            name: of the topic.
            several: the topic may have more than one publisher. While another has, nobody knows which one to believe:
                nothing is taken.

        Raises:
            InputError: the name is none that a topic can have.
        """
        # Best effort matches publishers of either kind; the depth carries a 1 kHz stream over pauses of Python.
        qos = QoSProfile(depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
        subscription = self._subscribe(kind, name, lambda _: None, qos, _Polled())
        self._inputs.append(_Input(name, subscription, several, kind))

    def listen_as(self, configuration: Configuration) -> None:
        """Subscribe to the data that a configuration asks for. Raises InputError as :meth:`listen`."""
        self.listen(JointState, JOINT_STATES, several=configuration["merge_joint_states"])
        if configuration.gains:
            self.listen(JointState, COMMANDS)
        if configuration["imu.frame"]:
            self.listen(Imu, IMU)
        elif configuration.floating_base:
            self.listen(Odometry, ODOM)
        for sensor in configuration.sensors:
            self.listen(WrenchStamped, sensor.topic)

    def hear(self, kind: type, name: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        """Subscribe to anything but data."""
        subscription = self._subscribe(kind, name, callback, qos)
        self._inputs.append(_Input(name, subscription, several=True))

    def close(self) -> None:
        """Subscribe to data no more."""
        for entry in self._inputs:
            if entry.kind:
                self._node.destroy_subscription(entry.subscription)
        self._inputs = [entry for entry in self._inputs if not entry.kind]
        self._numbers.clear()  # what is sent meanwhile is not lost
        self._policies.clear()

    def waiting(self, topic: str | None = None) -> list[Received]:
        """The data that wait on all topics, or on one, serialised, as they are decoded many at once, in the order in
        which they came. Those of a topic with more publishers than it may have are dropped."""
        entries = [entry for entry in self._inputs if entry.kind and topic in (None, entry.name)]
        messages = [message for entry in entries for message in self._waiting(entry)]
        return sorted(messages, key=attrgetter("time"))

    def _waiting(self, entry: _Input) -> list[Received]:
        taken: list[tuple[bytes, dict[str, int]]] = []
        # Not the node's count, which would copy the graph.
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
        # Where it is not known when a message came, it has not waited.
        behind = now - wall_clock
        came = (min(now, behind + 1e-9 * (info["received_timestamp"] or math.inf)) for _, info in taken)
        # In the order of the topic, though the wall clock is set.
        _, *times = accumulate(came, max, initial=self._latest.get(entry.name, 0.0))
        self._latest[entry.name] = times[-1]
        return [Received(entry.name, data, at) for (data, _), at in zip(taken, times, strict=True)]

    def _subscribe(
        self, kind: type, name: str, callback: Callable[..., None], qos: QoSProfile, polled: _Polled | None = None
    ) -> Subscription:
        events = SubscriptionEventCallbacks(
            message_lost=partial(self._on_lost, name), incompatible_qos=partial(self._on_incompatible, name)
        )
        options = QoSOverridingOptions.with_default_policies()
        try:
            return self._node.create_subscription(
                kind,
                name,
                callback,
                qos,
                callback_group=polled,
                event_callbacks=events,
                qos_overriding_options=options,
                raw=polled is not None,
            )
        except NameValidationException as error:
            raise InputError(f"parameters: topic '{name}': {' '.join(str(error).split())}") from error
        except (RuntimeError, AssertionError, AttributeError) as error:  # as rclpy meets other values than it expects
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"parameters: topic '{name}': its qos_overrides cannot be used ({reason})") from error

    def _count_missing(self, entry: _Input, numbers: list[int]) -> None:
        """Count the messages as lost that one publisher sent between its last one and those with these ``numbers``.

        With several publishers nobody can tell whose numbers they are.
        """
        before = self._numbers.pop(entry.name, None)
        if numbers and not entry.several:
            self._numbers[entry.name] = numbers[-1]
            every = numbers if before is None else [before, *numbers]
            if missing := sum(max(0, after - number - 1) for number, after in pairwise(every)):
                self._ledger.lose(entry.name, missing)

    def _on_lost(self, name: str, event: Any) -> None:
        # Numbers tell more: messages that overrun the subscription's depth make no event.
        if name not in self._numbers:
            self._ledger.lose(name, event.total_count_change)

    def _on_incompatible(self, name: str, event: Any) -> None:
        self._policies[name] = qos_policy_name_from_kind(event.last_policy_kind).lower()

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with the present publishers."""
        return tuple(problem for entry in self._inputs for problem in self._problems_of(entry))

    def _problems_of(self, entry: _Input) -> list[str]:
        problems, heard = [], []
        for publisher in self._node.get_publishers_info_by_topic(entry.subscription.topic_name):
            compatibility, reason = qos_check_compatible(publisher.qos_profile, entry.subscription.qos_profile)
            if compatibility != QoSCompatibility.ERROR:
                heard.append(publisher)
            else:
                policy = self._policies.get(entry.name, "quality of service")
                who = _full_name(publisher)
                problems.append(
                    f"{entry.name}: no messages from {who}, incompatible QoS: {policy} ({reason.rstrip(';')})"
                )
        if len(heard) > 1 and not entry.several:
            names = ", ".join(sorted(map(_full_name, heard)))
            problems.append(
                f"{entry.name} has {len(heard)} publishers; all its messages are dropped until one is left: {names}"
            )
        return problems


def _full_name(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
