"""The node's subscriptions: every message is counted on its way in, and who publishes is looked at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

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

_MOST_AT_ONCE = 100  # messages of a topic, before others have their turn


@dataclass(frozen=True)
class _Input:
    """A topic that is listened to; ``several``: more than one publisher is as it should be."""

    name: str
    subscription: Subscription
    several: bool


class Inputs:
    """Subscribes, counts what is not taken, and tells of publishers that do not fit."""

    def __init__(self, node: Node, ledger: Ledger, on_failure: Callable[[str, Exception], None]) -> None:
        """``on_failure`` is told of exceptions."""
        self._node = node
        self._ledger = ledger
        self._on_failure = on_failure
        self._inputs: list[_Input] = []
        self._policies: dict[str, str] = {}  # that publishers were last incompatible in

    def listen(self, kind: type, name: str, take: Callable[[Any], str], several: bool = False) -> None:
        """Subscribe to data. ``take(message)`` gives the reason why it does not take a message, or nothing.

        While there is more than one publisher, unless ``several`` is as it should be, nobody knows which one to
        believe: nothing is taken. Raises InputError for a name that is none.
        """

        def take_or_drop(message: Any) -> None:
            try:
                reason = "several publishers" if self._ambiguous(entry) else take(message)
            except Exception as error:  # noqa: BLE001 the message has its end, whatever it is
                reason = f"{type(error).__name__} in a callback"
                self._on_failure(f"a message on {name} could not be taken", error)
            if reason:
                self._ledger.drop(name, reason)

        def take_what_waits(message: Any) -> None:
            # At once, as to wait for a message takes the executor ten times as long as to take it.
            take_or_drop(message)
            for _ in range(_MOST_AT_ONCE):
                with entry.subscription.handle:
                    taken = entry.subscription.handle.take_message(kind, False)
                if taken is None:
                    break
                take_or_drop(taken[0])

        # Best effort matches publishers of either kind; the depth carries a 1 kHz stream over pauses of Python.
        qos = QoSProfile(depth=2000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
        entry = _Input(name, self._subscribe(kind, name, take_what_waits, qos), several)
        self._inputs.append(entry)

    def hear(self, kind: type, name: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        """Subscribe to what is no data."""
        self._inputs.append(_Input(name, self._subscribe(kind, name, callback, qos), several=True))

    def _subscribe(self, kind: type, name: str, callback: Callable[[Any], None], qos: QoSProfile) -> Subscription:
        events = SubscriptionEventCallbacks(
            message_lost=partial(self._on_lost, name),
            incompatible_qos=partial(self._on_incompatible, name),
        )
        options = QoSOverridingOptions.with_default_policies()
        try:
            return self._node.create_subscription(
                kind, name, callback, qos, event_callbacks=events, qos_overriding_options=options
            )
        except NameValidationException as error:
            raise InputError(f"parameters: topic '{name}': {' '.join(str(error).split())}") from error

    def _on_lost(self, name: str, event: Any) -> None:
        self._ledger.lose(name, event.total_count_change)

    def _on_incompatible(self, name: str, event: Any) -> None:
        self._policies[name] = qos_policy_name_from_kind(event.last_policy_kind).lower()

    def _ambiguous(self, entry: _Input) -> bool:
        # Not the node's count: that one copies the graph, for every message.
        return not entry.several and entry.subscription.get_publisher_count() > 1

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with those who publish now."""
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
