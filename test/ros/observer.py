"""Somebody who listens, publishes and calls services, in the test's own process."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any, Self, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from files.recordings import TYPES, Recorded
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from geomid_ros.live.saving import SLOW

from .waiting import PATIENCE

T = TypeVar("T")
SETTLING = 1.0  # [s] in which what is new in a graph is discovered
MATCHING = 1.0  # [s] a subscriber knows of a publisher a little later than the publisher of it
BETWEEN_MESSAGES = 0.75e-3  # [s]
TOGETHER = 20  # messages


def latched(depth: int = 1000) -> QoSProfile:
    """What is published once and kept for those who come late."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)


def plenty() -> QoSProfile:
    return QoSProfile(depth=10_000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)


class Pace:
    """Lets time pass between messages: so much more as those who are to take them wait for a processor."""

    def __init__(self, waited: Callable[[], float]) -> None:
        """``waited``: how long they have so far [s]."""
        self._waited = waited
        self._before = waited()
        self._count = 0

    def pause(self, seconds: float = BETWEEN_MESSAGES) -> None:
        """After every message."""
        time.sleep(seconds)
        self._count += 1
        if self._count % TOGETHER == 0:
            now = self._waited()
            time.sleep(max(0.0, now - self._before))
            self._before = now


LATE = "takes more than"
"""What `~/save` says where an estimate of all rows takes so long that the last one is saved."""


class Observer:
    """A node in a context and executor of its own."""

    def __init__(self, domain: int, waited: Callable[[], float]) -> None:
        """``waited``: see :class:`Pace`."""
        self._waited = waited
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("observer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Publisher] = {}
        self._diagnostics: list[DiagnosticArray] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def spin(self, seconds: float) -> None:
        """Let messages come for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def wait_for(self, look: Callable[[], T], what: str, patience: float = PATIENCE) -> T:
        """What ``look`` finds, as soon as it finds something."""
        end = time.monotonic() + patience
        while time.monotonic() < end:
            if found := look():
                return found
            self._executor.spin_once(timeout_sec=0.02)
        raise AssertionError(f"waited {patience:g} s in vain for {what}")

    def settled(self, look: Callable[[], T]) -> T:
        """What ``look`` finds in the graph once it finds the same again :data:`SETTLING` later; a node is discovered in
        pieces, its name after what it offers."""

        def found() -> tuple[T] | None:
            try:
                first = look()
                self.spin(SETTLING)
                return (first,) if look() == first else None
            except NodeNameNonExistentError:
                return None

        return self.wait_for(found, "a graph in which nothing more is discovered")[0]

    def collect(self, kind: type, topic: str, qos: QoSProfile | None = None) -> list[Any]:
        """A list that grows by every message on a topic from now on."""
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, qos or plenty())
        return messages

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """The answer of a service."""
        client = self.node.create_client(kind, service)
        self.wait_for(client.service_is_ready, f"service {service}")
        answer = client.call_async(request)
        self.wait_for(answer.done, f"an answer of {service}")
        self.node.destroy_client(client)
        return answer.result()

    def trigger(self, service: str) -> tuple[bool, str]:
        """Whether a service succeeded, and what it said; asked again while a busy machine makes it or its disk late."""
        end = time.monotonic() + 5.0 * PATIENCE
        response = self.call(Trigger, service, Trigger.Request())
        while (LATE in response.message or SLOW in response.message) and time.monotonic() < end:
            response = self.call(Trigger, service, Trigger.Request())
        return response.success, response.message

    def publish(
        self, messages: Iterable[Recorded], kinds: dict[str, Any], namespace: str = "", *, heard: bool = True
    ) -> None:
        """Publish recorded messages in quick succession, once everybody is there who is to hear them; or, unless they
        are to be ``heard``, nobody.

        ``kinds`` are the classes of the topics' messages; topics that it does not have are left out.
        """
        for topic, kind in kinds.items():
            if namespace + topic not in self._publishers:
                self._publishers[namespace + topic] = self.node.create_publisher(kind, namespace + topic, plenty())
        chosen = [self._publishers[namespace + topic] for topic in kinds]
        self.wait_for(
            lambda: all(bool(p.get_subscription_count()) == heard for p in chosen), f"subscribers of {', '.join(kinds)}"
        )
        self.spin(MATCHING)
        pace = self.pace()
        for item in messages:
            if item.topic in kinds:
                self._publishers[namespace + item.topic].publish(bytes(TYPES.serialize_cdr(item.message, item.kind)))
                pace.pause()

    def pace(self) -> Pace:
        """For messages in quick succession."""
        return Pace(self._waited)

    def diagnostics(self, look: Callable[[dict[str, str], Any], bool], what: str, node: str = "geomid") -> Any:
        """The first diagnostics of a node from now on whose stream's values and status satisfy ``look``."""
        if self._diagnostics is None:
            self._diagnostics = self.collect(DiagnosticArray, "/diagnostics")
        self._diagnostics.clear()
        last: list[Any] = [None]

        def find() -> Any:
            for array in self._diagnostics or ():
                for status in array.status:
                    if status.name == f"{node}: stream":
                        last[0] = status
                        if look({pair.key: pair.value for pair in status.values}, status):
                            return array
            return None

        try:
            return self.wait_for(find, what)
        except AssertionError as error:
            raise AssertionError(f"{error}; the last diagnostics were {last[0]}") from None
