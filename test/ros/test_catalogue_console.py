"""What the log says to those who do not watch the diagnostics; and names that must not reach anybody as they are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from files.recordings import BAGS

from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.live.status import Status
from geomid_ros.ros import diagnostics as module
from geomid_ros.ros.diagnostics import AGAIN, Console, StatusEvents
from geomid_ros.signals.ledger import Account

from .rig import GOOD, rigged
from .spoiling import in_frame
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
    node = stage.node(WRIST)
    none = r"no robot description yet on /robot_description \(start robot_state_publisher, or set"
    stage.observer.wait_for(lambda: said(node, "WARN", none), "a description")
    described = {**NO_CHOICE, "robot_description": description("arm3"), "solve_period": 0.2}
    other = stage.node({**WRIST, **described}, "-r", "__ns:=/other", name="other/geomid")
    silent = r"no messages on /other/joint_states, /wrench \(does the driver run\?"
    stage.observer.wait_for(lambda: said(other, "WARN", silent), "messages")
    remapped = stage.node(described, "-r", "__ns:=/third", "-r", "joint_states:=/joint_states", name="third/geomid")
    stage.spin_while(stage.play(BAGS / "arm3", 1.0))
    stage.observer.wait_for(lambda: "first estimate, from" in remapped.output, "the first estimate")
    assert said(remapped, "INFO", r"\]: /joint_states: receiving \d+ messages/s\n")
    assert said(remapped, "INFO", r"\]: identifying 3 links")


def test_108_104_all_messages_refused_is_said_on_the_console(tmp_path: Path) -> None:
    """With what to do about it; and names from outside are one printable line, there and in the diagnostics."""
    with rigged(tmp_path) as rig:
        bad = [item.changed(name=[WICKED, "joint2", "joint3"]) for item in GOOD[:1200] if item.topic == "/joint_states"]
        for begin in range(0, 600, 150):
            rig.send(bad[begin : begin + 150], pause=0.01)
        lacking = r"joint_states rejected: joint 'joint1' is missing: if nobody publishes"
        rig.stage.observer.wait_for(lambda: said(rig.node, "(WARN|ERROR)", lacking), "what all messages lack")
        assert rig.node.output.count("joint 'joint1' is missing") <= 2, "once, not with every message"
        assert rig.settled()["joint_states accepted"] == "0"
        begin = len(rig.arrays)
        names = [WICKED, WICKED, "joint3"]
        rig.send(in_frame(i, WICKED) if i.topic == "/wrench" else i.changed(name=names) for i in GOOD[600:1000])
        rig.says(begin, None, f"joint '{SHOWN}' is named twice", f"frame '{SHOWN}' is not the declared 'wrist_ft'")
        for status in (status for array in rig.arrays for status in array.status):
            values = [text for pair in status.values for text in (pair.key, pair.value)]
            assert all(text.isprintable() for text in (status.name, status.message, *values)), status
        assert all(line.isprintable() for line in rig.node.output.splitlines())
        assert not re.search("^INFO all is well", rig.node.output, re.MULTILINE)
        before, after = rig.begin()
        rig.feed(before + after)
        rig.assert_same_as_twin()
