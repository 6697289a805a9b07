"""What the log says to those who do not watch the diagnostics; and names that must not reach anybody as they are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from files.recordings import BAGS
from std_msgs.msg import String

from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.live.status import Status
from geomid_ros.ros import diagnostics as module
from geomid_ros.ros.diagnostics import AGAIN, Console, StatusEvents
from geomid_ros.signals.ledger import Account

from .observer import latched
from .stage import NO_CHOICE, WRIST, Stage, description

WICKED = "\x1b[31mjoint1\nINFO all is well\u202e"
SHOWN = r"\x1b[31mjoint1\nINFO all is well\u202e"
LATE = "a late message"


class Lines:
    """A log that remembers."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []
        self.info, self.warning, self.error = (self._taken(level) for level in ("info", "warning", "error"))

    def _taken(self, level: str) -> Any:
        return lambda message, /: self.lines.append((level, message))


# Errors, warnings and one-off events of each second, and what is logged of them.
Second = tuple[Sequence[str], Sequence[str]] | tuple[Sequence[str], Sequence[str], set[str]]
COMPLAINTS: dict[str, tuple[list[Second], list[tuple[str, str]]]] = {
    "what lasts": (
        [([], [f"joint_states rejected: {second} messages"]) for second in range(301)],
        [("warning", f"joint_states rejected: {1 + k * int(AGAIN)} messages") for k in range(300 // int(AGAIN))],
    ),
    "what is gone again": ([([], [LATE] if second % 3 == 0 else []) for second in range(20)], []),
    "the end of what was said": (
        [([], warnings) for warnings in (["a"], ["a", "b"], ["1 c"], ["2 c", "a"], [], ["d"], [], [])],
        [("warning", "a"), ("warning", "2 c"), ("info", "no longer: a; 2 c")],
    ),
    "what is said at once": (
        [(["b"], [], {"b"}), ([], ["a", "b"], {"a"}), ([], ["b"]), ([], ["b"]), ([], ["b"])],
        [("error", "b"), ("warning", "a")],
    ),
    "errors and warnings": (2 * [(["a", "c"], ["b"])], [("error", "a; c"), ("warning", "b")]),
    "what cannot be printed": (2 * [([], [WICKED])], [("warning", SHOWN)]),
}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [5.0]
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


@pytest.mark.parametrize("case", COMPLAINTS)
def test_what_lasts_is_said_once_a_minute(case: str, clock: list[float]) -> None:
    """And its end, once; what comes and goes is not. Remarks on one message are said at once."""
    seconds, said = COMPLAINTS[case]
    console = Console(log := Lines())
    for second in seconds:
        console.log_complaints(*second)
        clock[0] += 1.0
    assert log.lines == said


def test_the_same_news_are_said_once_a_minute(clock: list[float]) -> None:
    """Sentences that differ in what was measured are the same; joints that differ in a number are others."""
    console = Console(log := Lines())
    lines = [f"'{joint}' is {delay} s late" for joint in ("joint4", "joint5") for delay in (2, 0.31, 1e-05)]
    for _ in range(301):
        console.log_events(lines)
        clock[0] += 1.0
    assert log.lines == [("info", line) for line in lines[::3]] * (1 + 300 // int(AGAIN))


def test_it_remembers_no_more_than_so_much(clock: list[float]) -> None:
    console = Console(Lines())
    for number in range(1000):
        console.log_events([f"joint '{''.join(chr(97 + int(digit)) for digit in str(number))}' is missing"])
        clock[0] += 1.0
    assert len(console._logged) <= 200


def status(received: int, told: dict[str, bool] | None = None, accepted: int | None = None) -> Status:
    """After so many messages, with an estimate of these links, and whether their masses are told."""
    estimate: Any = told and SimpleNamespace(
        rows_accepted=7,
        links=[
            SimpleNamespace(name=name, mass=2.0, std_mass=0.01, identified=QUANTITIES if known else ())
            for name, known in told.items()
        ],
    )
    good = received if accepted is None else accepted
    account = Account(accepted=good, rejected=Counter({"for a reason": received - good}))
    return Status(active=True, accounts={"joint_states": account}, estimate=estimate)


COMING = ["joint_states: receiving 100 messages/s"]
UNKNOWN = ["first estimate, from 7 rows; no mass is individually identifiable yet"]
EVENTS: dict[str, list[tuple[Status, list[str]]]] = {
    "data that come, in their second second": [
        (status(count), COMING if count in (160, 400) else []) for count in (0, 60, 160, 260, 260, 300, 400)
    ],
    "messages that are all refused": [(status(count, accepted=0), []) for count in (0, 60, 160, 260)],
    "the first estimate and every link that becomes known": [
        (status(0), []),
        (
            status(0, {"a": False, "b": True, "c": False}),
            ["first estimate, from 7 rows; identified: b 2.000 ± 0.010 kg; not identified yet: a, c"],
        ),
        (status(0, {"a": False, "b": True, "c": False}), []),
        (status(0, {"a": True, "b": False, "c": True}), ["identified: a 2.000 ± 0.010 kg, c 2.000 ± 0.010 kg"]),
        (status(0, {"a": True, "b": True, "c": True}), []),
    ],
    "a reset": [(status(0, {"a": False}), UNKNOWN), (status(0), []), (status(0, {"a": False}), UNKNOWN)],
}


@pytest.mark.parametrize("case", EVENTS)
def test_what_is_new_is_said_once(case: str) -> None:
    news = StatusEvents()
    assert [[*news.since(second)] for second, _ in EVENTS[case]] == [said for _, said in EVENTS[case]]


def said(process: Any, level: str, words: str) -> bool:
    return re.search(rf"\[{level}\].*{words}", process.output) is not None


def test_108_the_console_says_what_is_waited_for(stage: Stage) -> None:
    """A description; data. And what comes then, and what is found."""
    arguments = ("-r", "__ns:=/other", "-r", "joint_states:=/joint_states")
    node = stage.node({**WRIST, **NO_CHOICE, "solve_period": 0.2}, *arguments, name="other/geomid")
    none = r"no robot description yet on /other/robot_description \(start robot_state_publisher, or set"
    stage.observer.wait_for(lambda: said(node, "WARN", none), "a description")
    talker = stage.observer.node.create_publisher(String, "/other/robot_description", latched(1))
    talker.publish(String(data=description("arm3")))
    silent = r"no messages on /joint_states, /wrench \(does the driver run\?"
    stage.observer.wait_for(lambda: said(node, "WARN", silent), "messages")
    stage.spin_while(stage.play(BAGS / "arm3", 2.0, "--topic", "/wrench"))
    stage.observer.wait_for(lambda: "first estimate, from" in node.output, "the first estimate")
    assert said(node, "INFO", r"\]: /joint_states: receiving \d+ messages/s\n")
    assert said(node, "INFO", r"\]: identifying 4 links")
