"""A node that lives through one fault after the other, and a twin that is spared them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from files.recordings import TYPES, Recorded
from geometry_msgs.msg import InertiaStamped
from rclpy.publisher import Publisher
from signals.feeding import completed
from std_srvs.srv import Trigger

from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session

from .observer import BETWEEN_MESSAGES, MATCHING, latched, plenty
from .processes import Process
from .spoiling import later
from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages, staged
from .waiting import PATIENCE

SAME = 1e-9  # relative: with the bad messages, and without
BETWEEN_CASES = 100_000_000_000  # [ns] of the stamps
GOOD = messages()
BEFORE, AFTER = GOOD[300:600], GOOD[600:900]
NOTHING = "no usable rows: nothing was measured, or the robot never moved"
SOLVE_PERIOD = 0.8  # [s] solving takes most of a node's time: more often than once a case or two it need not
FLAT_WRIST = {f"wrench.wrist.{key}": value for key, value in WRIST["wrench"]["wrist"].items()}


class Twin:
    """What the node would know, had it received only what it is fed: the same code without ROS."""

    def __init__(self, **parameters: Any) -> None:
        values = {"wrenches": WRIST["wrenches"], **FLAT_WRIST, **NO_CHOICE, **parameters}
        self.session = Session(description("arm3"), Configuration(values), "arm3.urdf")

    def feed(self, items: Iterable[Recorded]) -> None:
        """Take messages."""
        for samples in self._completed(items):
            self.session.identifier.add(samples)

    def samples(self, items: Iterable[Recorded]) -> Samples:
        """The samples that messages complete, all together."""
        return Samples.concatenate(list(self._completed(items)))

    def _completed(self, items: Iterable[Recorded]) -> Iterator[Samples]:
        return completed(self.session.pipeline, (item.parsed for item in items))


class Rig:
    """A node with its twin: what is published, counted and said."""

    def __init__(self, stage: Stage, out: Path, node: Process) -> None:
        self.stage = stage
        self.node = node
        self.out = out
        self.name = "geomid"
        self.twin = Twin()
        self.sent: Counter[str] = Counter()  # messages by topic since the node began
        self.arrays: list[DiagnosticArray] = stage.observer.collect(DiagnosticArray, "/diagnostics")
        self.inertias: list[InertiaStamped] = stage.observer.collect(InertiaStamped, "/geomid/inertias", latched())
        self._cases = 0
        self.told_at = 0  # the place, among the arrays, of what was told last
        self._clients: dict[str, Any] = {}
        create = stage.observer.node.create_publisher
        self.publishers: dict[str, Publisher] = {topic: create(kind, topic, plenty()) for topic, kind in KINDS.items()}
        stage.observer.wait_for(
            lambda: all(publisher.get_subscription_count() for publisher in self.publishers.values()), "the node"
        )
        stage.observer.spin(MATCHING)

    def send(self, items: Iterable[Recorded], pause: float = BETWEEN_MESSAGES) -> None:
        """Publish messages in quick succession."""
        pace = self.stage.observer.pace()
        for item in items:
            self.publishers[item.topic].publish(bytes(TYPES.serialize_cdr(item.message, item.kind)))
            self.sent[item.topic] += 1
            pace.pause(pause)

    def shifted(self, items: Iterable[Recorded]) -> list[Recorded]:
        """Messages in the time of the present case."""
        return [later(item, self._cases * BETWEEN_CASES) for item in items]

    def begin(self) -> tuple[list[Recorded], list[Recorded]]:
        """Begin a case without rows; good messages for before and after the fault."""
        self._cases += 1
        assert self.trigger("reset") == (True, "all rows discarded")
        self.twin.session.identifier.reset()
        return self.shifted(BEFORE), self.shifted(AFTER)

    def feed(self, items: Sequence[Recorded]) -> None:
        """Good messages, for both."""
        self.send(items)
        self.twin.feed(items)

    def trigger(self, service: str) -> tuple[bool, str]:
        """What a service says."""
        answer = self.ask(service)
        self.stage.observer.wait_for(answer.done, f"an answer of {service}")
        return answer.result().success, answer.result().message

    def ask(self, service: str) -> Any:
        """The answer of a service, to be waited for."""
        if service not in self._clients:
            client = self.stage.observer.node.create_client(Trigger, f"/{self.name}/{service}")
            self.stage.observer.wait_for(client.service_is_ready, service)
            self._clients[service] = client
        return self._clients[service].call_async(Trigger.Request())

    def stream(self, array: DiagnosticArray, of: str = "stream") -> Any:
        """The stream's status, or that of a link; None where there is none."""
        return next((status for status in array.status if status.name == f"{self.name}: {of}"), None)

    def link_says(self, begin: int, link: str, level: bytes, part: str) -> None:
        """Wait for a link's status, of the arrays from ``begin`` on, with this level and ``part`` of a message."""
        self.wait_for(
            lambda: any(
                status and status.level == level and part in status.message
                for status in (self.stream(array, link) for array in self.arrays[begin:])
            ),
            f"'{part}' of {link} in diagnostics of level {level!r}",
        )

    def wait_for(self, look: Callable[[], Any], what: str) -> Any:
        """What ``look`` finds, as diagnostics come."""
        return self.stage.observer.wait_for(look, what, PATIENCE)

    def told(self, what: str, begin: int, look: Callable[[dict[str, str], Any], bool]) -> Any:
        """The stream's first status, of the arrays from ``begin`` on, that satisfies ``look``."""

        def find() -> Any:
            assert self.node.running, self.node.output
            for place, array in enumerate(self.arrays[begin:], begin):
                status = self.stream(array)
                if status is not None and look({pair.key: pair.value for pair in status.values}, status):
                    self.told_at = place
                    return status
            return None

        try:
            return self.wait_for(find, what)
        except AssertionError as error:
            last = [status for array in self.arrays[-3:] if (status := self.stream(array))]
            said = [(status.level, status.message) for status in last]
            values = {pair.key: pair.value for pair in last[-1].values} if last else {}
            raise AssertionError(
                f"{error}; sent {dict(self.sent)}, the last diagnostics said {said}, {values}"
            ) from None

    def settled(self, begin: int = 0) -> dict[str, str]:
        """The stream's values when all that was sent has come to its end; by then the ledger balances."""
        status = self.told("all messages in the ledger", begin, lambda values, _: self._all_counted(values))
        values = {pair.key: pair.value for pair in status.values}
        assert_balanced(values, self.sent)
        return values

    def _all_counted(self, values: dict[str, str]) -> bool:
        names = {"/joint_states": "joint_states"}
        return values["queue"] == "0" and all(
            values.get(f"{names.get(topic, topic)} received") == str(count) for topic, count in self.sent.items()
        )

    def names_at_once(self, begin: int, level: bytes | None, *parts: str) -> None:
        """The first diagnostics with all messages in the ledger, those before, or the next have ``parts``."""
        self.settled(begin)
        settled = self.told_at
        self.says(begin, level, *parts)
        assert self.told_at <= settled + 1

    def says(self, begin: int, level: bytes | None, *parts: str) -> None:
        """Wait until the stream's messages of this level, if one is given, have had ``parts``: not at once maybe, as
        diagnostics tell what is new."""
        places = []
        for part in parts:
            self.told(
                f"'{part}' in diagnostics of level {level!r}",
                begin,
                lambda _, status, part=part: level in (None, status.level) and part in status.message,
            )
            places.append(self.told_at)
        self.told_at = max(places)

    def published(self) -> Any:
        """What the node has saved and published, once it has all the rows that the twin has."""
        document = self._up_to_date()
        masses = [link["mass"] for link in document["links"]]
        self.stage.observer.wait_for(
            lambda: [message.inertia.m for message in self.inertias[-len(masses) :]] == masses, "what was saved"
        )
        return document

    def assert_same_as_twin(self) -> None:
        """The estimate, once all messages have come, is that of a run without the bad ones; it is published."""
        if not self.twin.session.identifier.rows:
            assert self.saved() is None
            return
        links, estimate = self.published()["links"], self.twin.session.identifier.solve()
        for ours, theirs in zip(links, estimate.links, strict=True):
            assert ours["name"] == theirs.name
            assert ours["mass"] == pytest.approx(theirs.mass, rel=SAME)
            for key, value in (("com", theirs.com), ("inertia", theirs.inertia)):
                assert np.linalg.norm(np.subtract(ours[key], value)) <= SAME * np.linalg.norm(value), key

    def _up_to_date(self) -> Any:
        """What is saved, once it has the twin's rows."""
        rows = self.twin.session.identifier.rows

        def find() -> Any:
            document = self.saved()
            saved = document["rows"]["accepted"] if document else 0
            assert saved <= rows
            return document if saved == rows else None

        return self.wait_for(find, f"an estimate of {rows} rows")

    def saved(self) -> Any:
        """What is saved now; None where there are no rows."""
        success, message = self.stage.observer.trigger(f"/{self.name}/save")
        if success:
            return json.loads((self.out / "estimate.json").read_text())
        assert message == NOTHING, message
        return None


def assert_balanced(values: dict[str, str], sent: Counter[str]) -> None:
    """``received = accepted + sum(rejected by reason) + sum(dropped by reason)``, and rows likewise."""
    for topic in sent:
        name = topic.removeprefix("/") if topic == "/joint_states" else topic
        refused = sum(
            int(value) for key, value in values.items() if key.startswith((f"{name} rejected: ", f"{name} dropped: "))
        )
        assert int(values[f"{name} received"]) == int(values[f"{name} accepted"]) + refused
    rejected = sum(int(value) for key, value in values.items() if key.startswith("rows rejected: "))
    assert int(values["rows made"]) == int(values["rows"]) + rejected


@contextmanager
def rigged(folder: Path, module: str = "geomid_ros.ros.main", fresh: bool = False, **parameters: Any) -> Iterator[Rig]:
    """A node of the small arm with its wrist sensor, and its twin."""
    with staged(folder) as stage:
        out = folder / "out"
        values = {"robot_description": description("arm3"), "solve_period": SOLVE_PERIOD, "output_folder": str(out)}
        node = stage.node({**WRIST, **NO_CHOICE, **values, **parameters}, module=module, fresh=fresh)
        yield Rig(stage, out, node)


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
