"""The node's subscriptions: take and count every message, and check who publishes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

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
from rclpy.subscription import Subscription

from geomid_ros.errors import InputError
from geomid_ros.signals.ledger import Ledger

_MOST_AT_ONCE = 1000  # messages of a topic, before others have their turn


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
    """A subscribed topic; ``several``: it may have more than one publisher."""

    name: str
    subscription: Subscription
    several: bool
    take_waiting: Callable[[], None]


class Inputs:
    """Subscribes, counts messages that are not taken, and reports publishers that do not fit."""

    def __init__(self, node: Node, ledger: Ledger, on_failure: Callable[[str, Exception], None]) -> None:
        """
        Args:
            node: subscribes.
            ledger: is told of messages that are not taken.
            on_failure: ``on_failure(what, error)`` is told of exceptions.
        """
        self._node = node
        self._ledger = ledger
        self._on_failure = on_failure
        self._inputs: list[_Input] = []
        self._numbers: dict[str, int] = {}  # of the last messages, as the publishers count them
        self._policies: dict[str, str] = {}  # in which publishers were last incompatible

    def listen(self, kind: type, name: str, take: Callable[[str, bytes], str], several: bool = False) -> None:
        """Subscribe to data, of which only the bytes are taken: they are decoded many at once.

        While there is more than one publisher, nobody knows which one to believe: nothing is taken.

        Args:
            kind: class of the messages.
            name: of the topic.
            take: takes topic and bytes of a message, and gives the reason if it does not, else nothing.
            several: the topic may have more than one publisher.

        Raises:
            InputError: the name is none that a topic can have.
        """

        def take_or_drop(data: bytes, info: dict[str, Any]) -> None:
            # Not the node's count, which would copy the graph for every message.
            ambiguous = not entry.several and entry.subscription.get_publisher_count() > 1
            self._count_missing(entry, None if ambiguous else info["publication_sequence_number"])
            if ambiguous:
                self._ledger.drop(name, "several publishers")
                return
            try:
                reason = take(name, data)
            except Exception as error:  # noqa: BLE001 the message must be counted, whatever happens
                reason = f"{type(error).__name__} in a callback"
                self._on_failure(f"a message on {name} could not be taken", error)
            if reason:
                self._ledger.drop(name, reason)

        def take_waiting() -> None:
            for _ in range(_MOST_AT_ONCE):
                with entry.subscription.handle:
                    taken = entry.subscription.handle.take_message(kind, True)
                if taken is None:
                    break
                take_or_drop(*taken)

        # Best effort matches publishers of either kind; the depth carries a 1 kHz stream over pauses of Python.
        qos = QoSProfile(depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
        entry = _Input(name, self._subscribe(kind, name, take_or_drop, qos, _Polled()), several, take_waiting)
        self._inputs.append(entry)

    def hear(self, kind: type, name: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        """Subscribe to anything but data."""
        subscription = self._subscribe(kind, name, callback, qos)
        self._inputs.append(_Input(name, subscription, several=True, take_waiting=lambda: None))

    def take_waiting(self) -> None:
        """Take the data that wait on all topics."""
        for entry in self._inputs:
            entry.take_waiting()

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

    def _count_missing(self, entry: _Input, number: int | None) -> None:
        """Count the messages as lost that one publisher sent between its last one and the one with this ``number``.

        With several publishers nobody can tell whose number it is.
        """
        before = self._numbers.pop(entry.name, None)
        if number is not None and not entry.several:
            self._numbers[entry.name] = number
            if before is not None and number > before + 1:
                self._ledger.lose(entry.name, number - before - 1)

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
                    f"{entry.name}: nothing comes from {who}, which differs in QoS: {policy} ({reason.rstrip(';')})"
                )
        if len(heard) > 1 and not entry.several:
            names = ", ".join(sorted(map(_full_name, heard)))
            problems.append(f"{entry.name} has {len(heard)} publishers, nothing is taken until one is left: {names}")
        return problems


def _full_name(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
