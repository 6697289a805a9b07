"""The scenarios, each with its table."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.load.cycles import lives, services
from benchmarks.load.day import day
from benchmarks.load.endings import endings
from benchmarks.load.kills import kills
from benchmarks.load.overload import overload
from benchmarks.load.robots import robots
from benchmarks.load.steady import steady
from benchmarks.load.watched import QUANTILES, Account
from benchmarks.report import Report

_KILLS = 50
_QUANTILES = {"p50": 0.5, "p99": 0.99}
_COUNTS = ["sent", "received", "accepted", "lost", "unaccounted", "rejected or dropped"]


def _counts(outcome: Any) -> list[str]:
    account: Account = outcome.account
    refused = ", ".join(f"{reason}: {count}" for reason, count in account.refused.items()) or "0"
    numbers = outcome.sent, account.received, account.accepted, account.lost, outcome.unaccounted
    return [*map(str, numbers), refused]


def _machine() -> str:
    return f"Load average in the end {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores."


def _arm(report: Report, seconds: float) -> None:
    _steady(report, "arm", "arm7", {"solve_period": 0.001}, seconds)


def _calm(report: Report, seconds: float) -> None:
    _steady(report, "calm", "arm7", {}, seconds, 100.0)


def _plain(report: Report, seconds: float) -> None:
    _steady(report, "plain", "arm7", {}, seconds)


def _body(report: Report, seconds: float) -> None:
    _steady(report, "body", "body30", {}, seconds)


def _stream(report: Report, seconds: float) -> None:
    """Predictions of every message, beside what is identified from them."""
    outcome = steady(robots()["arm7"], {}, seconds, 1000.0, streamed=True)
    headings = ["", *_COUNTS, "streamed", *(f"{q} [ms]" for q in _QUANTILES), "us per message"]
    ages = [f"{np.quantile(outcome.streamed, share):.2f}" for share in _QUANTILES.values()]
    row = ["arm7", *_counts(outcome), str(len(outcome.streamed)), *ages, f"{outcome.microseconds:.0f}"]
    caption = "Ages of predictions when they arrive; processor time of the node alone. "
    report.table(f"Streamed efforts, {seconds:g} s at 1 kHz", headings, [row], caption + _machine())
    report.result("stream", {"received": outcome.account.received, "ages": ages, "us": outcome.microseconds})


def _steady(
    report: Report, name: str, robot: str, parameters: dict[str, Any], seconds: float, rate: float = 1000.0
) -> None:
    outcome = steady(robots()[robot], parameters, seconds, rate)
    headings = ["", *_COUNTS, *(f"{q} [ms]" for q in QUANTILES), "longest queue", "solves", "MB start, full, end"]
    row = [
        robot,
        *_counts(outcome),
        *(f"{outcome.latency[q]:.2f}" for q in QUANTILES),
        str(outcome.longest_queue),
        str(outcome.solves),
        ", ".join(f"{memory:.0f}" for memory in outcome.memory),
    ]
    caption = (
        f"{parameters or 'Default parameters'}. From receipt to row: the highest that any diagnostics after the first "
        "tenth told, each of the last 10,000 instants; the filter's fixed lag is not in it. The node and the "
        f"process that solves for it took {100.0 * outcome.processor:.0f} % of a core, and the memory; the node alone "
        f"{outcome.microseconds:.0f} us of processor time for a message; "
        f"the publisher was at most {outcome.latest:.0f} ms late. "
    )
    report.table(f"{seconds:g} s at {rate:g} Hz", headings, [row], caption + _machine())
    report.result(name, asdict(outcome) | {"unaccounted": outcome.unaccounted})


def _overload(report: Report, seconds: float) -> None:
    outcome = overload(robots()["arm7"], seconds)
    headings = ["carried [Hz]", "offered [Hz]", "achieved [Hz]", *_COUNTS, "latest [s]", "recovery [s]"]
    rates = [f"{rate:.0f}" for rate in (outcome.carried, outcome.offered, outcome.achieved)]
    row = [*rates, *_counts(outcome), f"{outcome.latest:.2f}", f"{outcome.recovery:.2f}"]
    caption = (
        "Rates of joint states, and of as many wrenches. Recovery: from when the load is normal (1 kHz) again until "
        "for a second no prediction is more than 0.1 s late. "
    )
    report.table(f"Four times what it can carry, for {seconds:g} s", headings, [row], caption + _machine())
    report.result("overload", asdict(outcome) | {"unaccounted": outcome.unaccounted})


def _kills(report: Report, seconds: float) -> None:
    outcome = kills(robots()["arm7"], seconds, _KILLS)
    headings = ["kills", *_COUNTS, "seconds to the next estimate: median, longest"]
    pauses = f"{statistics.median(outcome.pauses):.1f}, {max(outcome.pauses):.1f}"
    report.table(
        f"The solving process is killed within {seconds:g} s",
        headings,
        [[str(outcome.kills), *_counts(outcome), pauses]],
        "7 joints and a wrench at 1 kHz, default parameters. " + _machine(),
    )
    report.result("kills", asdict(outcome) | {"unaccounted": outcome.unaccounted})


def _day(report: Report, hours: float) -> None:
    outcome = day(
        robots()["arm7"], hours, lambda hour, memory: report.progress(f"load: day: {hour} h, {memory:.1f} MB")
    )
    headings = ["wall clock [s]", *_COUNTS, "solves", "MB start, 1 h, most, end", "growth after 1 h [MB]"]
    memory = outcome.memory[0], outcome.memory[1], max(outcome.memory), outcome.memory[-1]
    row = [f"{outcome.seconds:.0f}", *_counts(outcome), str(outcome.solves)]
    row += [", ".join(f"{value:.0f}" for value in memory), f"{outcome.growth:+.1f}"]
    caption = (
        "The real node over DDS; the stamps are 80 ms apart and run as fast as the node follows. "
        "Diagnostics and solves go by the wall clock. Memory: of the node and the process that solves for it. "
    )
    report.table(f"{hours:g} h of stamps", headings, [row], caption + _machine())
    report.result("day", asdict(outcome) | {"unaccounted": outcome.unaccounted, "growth": outcome.growth})


def _cycles(report: Report, count: float) -> None:
    robot = robots()["arm7"]
    outcomes = [services(robot, round(count)), lives(robot, round(count))]
    headings = ["", "cycles", "MB", "threads", "file descriptors"]
    rows = [
        [o.what, str(o.count), *(f"{a:.0f} to {b:.0f}" for a, b in zip(o.early, o.late, strict=True))] for o in outcomes
    ]
    report.table("Cycles", headings, rows, "After a tenth of the cycles, and after all. " + _machine())
    report.result("cycles", [asdict(outcome) for outcome in outcomes])


def _endings(report: Report, times: float) -> None:
    outcomes = []
    for _ in range(round(times)):
        for ending in endings(robots()["arm7"]):
            outcomes.append(ending)
            report.progress(f"load: {ending}")
    saved = {True: "yes", False: "NO", None: "nothing to save"}
    rows = [[o.state, o.signal, f"{o.seconds:.2f}", str(o.status), saved[o.saved]] for o in outcomes]
    caption = "Saved: the last masses published are those in estimate.json. " + _machine()
    report.table("The end", ["state", "signal", "exit [s]", "status", "saved"], rows, caption)
    report.result("endings", [asdict(outcome) for outcome in outcomes])


@dataclass(frozen=True)
class Scenario:
    """What is measured and printed, for how much by default, of what ``unit``, and when there is little time."""

    measure: Callable[[Report, float], None]
    amount: float
    unit: str
    short: float


SCENARIOS = {
    "arm": Scenario(_arm, 600.0, "seconds", 60.0),
    "plain": Scenario(_plain, 300.0, "seconds", 60.0),
    "calm": Scenario(_calm, 300.0, "seconds", 60.0),
    "body": Scenario(_body, 300.0, "seconds", 60.0),
    "stream": Scenario(_stream, 60.0, "seconds", 30.0),
    "overload": Scenario(_overload, 10.0, "seconds", 5.0),
    "kills": Scenario(_kills, 600.0, "seconds", 300.0),
    "day": Scenario(_day, 24.0, "hours", 2.0),
    "cycles": Scenario(_cycles, 200.0, "cycles", 20.0),
    "endings": Scenario(_endings, 1.0, "times", 1.0),
}
