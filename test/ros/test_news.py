"""What the console says of how the node gets on."""

from __future__ import annotations

import re
from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest
from files.recordings import BAGS

from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.live.status import Status
from geomid_ros.ros import console as module
from geomid_ros.ros.console import AGAIN, Console, StatusEvents
from geomid_ros.signals.ledger import Account

from .stage import NO_CHOICE, Stage, description
from .test_catalogue_console import Lines


def link(name: str, mass: float, told: bool) -> Any:
    return SimpleNamespace(name=name, mass=mass, std_mass=0.01, identified=QUANTITIES if told else ())


def status(received: int, told: dict[str, bool] | None = None, accepted: int | None = None) -> Status:
    """After so many messages, with an estimate of these links, and whether their masses are told."""
    estimate: Any = told and SimpleNamespace(
        rows_accepted=7, links=[link(name, 2.0, known) for name, known in told.items()]
    )
    good = received if accepted is None else accepted
    account = Account(accepted=good, rejected=Counter({"for a reason": received - good}))
    return Status(active=True, accounts={"joint_states": account}, estimate=estimate)


def said(*seconds: Status) -> list[list[str]]:
    news = StatusEvents()
    return [[*news.since(second)] for second in seconds]


def test_data_that_come_are_said_once_in_their_second_second() -> None:
    counts = (0, 60, 160, 260, 260, 300, 400)
    assert said(*(status(count) for count in counts)) == [
        [],
        [],
        ["joint_states: receiving 100 messages/s"],
        [],
        [],
        [],
        ["joint_states: receiving 100 messages/s"],
    ]


def test_messages_that_are_all_refused_do_not_come() -> None:
    assert said(*(status(count, accepted=0) for count in (0, 60, 160, 260))) == [[]] * 4


def test_the_first_estimate_and_every_link_that_becomes_known_are_said_once() -> None:
    seconds = [
        status(0),
        status(0, {"a": False, "b": True, "c": False}),
        status(0, {"a": False, "b": True, "c": False}),
        status(0, {"a": True, "b": False, "c": True}),
        status(0, {"a": True, "b": True, "c": True}),
    ]
    assert said(*seconds) == [
        [],
        ["first estimate, from 7 rows; identified: b 2.000 ± 0.010 kg; not identified yet: a, c"],
        [],
        ["identified: a 2.000 ± 0.010 kg, c 2.000 ± 0.010 kg"],
        [],
    ]


def test_after_a_reset_there_is_a_first_estimate_again() -> None:
    first = ["first estimate, from 7 rows; no mass is individually identifiable yet"]
    nothing, some = status(0), status(0, {"a": False})
    assert said(some, nothing, some) == [first, [], first]


def test_the_same_news_are_said_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now, log = [5.0], Lines()
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    console = Console(log)
    for second in range(301):
        console.log_events([f"joint_states: receiving {second} messages/s"])
        now[0] += 1.0
    assert [line for line, _ in log.lines] == ["info"] * (1 + 300 // int(AGAIN))


def test_a_node_says_what_comes_and_what_it_has_found(stage: Stage) -> None:
    node = stage.node({**NO_CHOICE, "robot_description": description("arm3"), "solve_period": 0.2})
    stage.spin_while(stage.play(BAGS / "arm3", 1.0))
    stage.observer.wait_for(lambda: "first estimate, from" in node.output, "the first estimate")
    lines = re.findall(r"\[INFO\] \S+ \[geomid\]: (.*)", node.output)
    assert any(re.fullmatch(r"/joint_states: receiving \d+ messages/s", line) for line in lines)
    assert lines[0].startswith("identifying 3 links")
