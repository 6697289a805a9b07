"""The node's gap alarm on realistic simulated robots: how often it is wrong, and how late it is right.

``python -m benchmarks.alarms [quiet|friction|payload ...] [--seeds 2]`` simulates and feeds the node's worker.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.alarms.cases import (
    AFTER,
    BEFORE,
    GROWS,
    MASS,
    PAYLOAD,
    RAMP,
    ROBOTS,
    SETTLED,
    WHATS,
    Outcome,
    cases,
    outcome,
)
from benchmarks.blind.case import robot_file
from benchmarks.report import Report, chosen
from geomid_ros.errors import InputError

_TARGET, _PICKED, _CLOSED = 10.0, 2.0, 5.0  # [s] to the alarm, to a payload's, and until that is closed
_EXACT = 0.05  # of a payload's mass
_ROW = tuple[str, str, str, str, str]


def main() -> None:
    """Run what is chosen, all unless named."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.alarms", description=__doc__)
    parser.add_argument("whats", nargs="*", metavar="WHAT", help=f"any of {', '.join(WHATS)}")
    parser.add_argument("--seeds", type=int, default=2, help="of each robot (%(default)s)")
    parser.add_argument("--first", type=int, default=1, help="seed (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder for results (%(default)s)")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    run(Report(arguments.out), list(chosen(parser, arguments.whats, WHATS)), seeds)


def run(report: Report, whats: Sequence[str], seeds: Sequence[int]) -> None:
    """The table of all robots that are installed."""
    found = []
    robots = [robot for robot in ROBOTS if _installed(report, robot)]
    todo = [case for what in whats for seed in seeds for robot in robots for case in cases(what, robot, seed)]
    columns = TextColumn("alarms"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    with Progress(*columns) as progress:
        for case in progress.track(todo):
            found.append(outcome(case))
            progress.console.print(_line(found[-1]), markup=False, highlight=False, soft_wrap=True)
            report.result("alarms", [asdict(each) for each in found])
    caption = (
        "Alarms: gaps that open, and payloads taken up, while nothing is changed, also after a payload is off; quiet "
        "are ten minutes of sines, "
        "aperiodic motion, motion from point to point, and stop and go; place are ten minutes of pick and place; "
        "watched: while it was known of all channels what is normal. Seconds from the change, one number for each "
        f"seed: friction of the joint grows by {100 * GROWS:g} % within {RAMP:g} s, and seconds count from the end of "
        f"that; a payload of {MASS:g} kg comes at once at the last link, and is off after {AFTER:g} s; its mass is "
        f"that of {SETTLED:g} s after the alarm. Both after {BEFORE:g} s; none: not within {AFTER:g} s. Gap: of the "
        "widest channel after the change, in times of the floor, median."
    )
    headings = ["", "found", "target", "met", "gap"]
    report.table("The node's gap alarm", headings, [*_quiet(found), *_delays(found)], caption)


def _installed(report: Report, robot: str) -> bool:
    try:
        robot_file(robot)
    except InputError as error:
        report.say(str(error))
        return False
    return True


def _line(found: Outcome) -> str:
    case = found.case
    alarms = ", ".join(f"{alarm.channel} at {alarm.time:.1f} s" for alarm in found.alarms) or "no alarm"
    where = " ".join(filter(None, (case.what, case.robot, str(case.seed), case.joint, case.kind)))
    return f"{where}: {alarms}; {found.floors:.2f} times the floor; speed {found.speed:.2f}{_said(found)}"


def _said(found: Outcome) -> str:
    if found.case.what != PAYLOAD:
        return ""
    return f"; mass {100.0 * found.mass:+.1f} %, since {found.since:+.1f} s, closed after {found.closed:.1f} s"


def _quiet(found: Sequence[Outcome]) -> Iterator[_ROW]:
    """A line for each robot: alarms while nothing is changed, in quiet cases, before changes and after payloads."""
    for (what, robot), own in groupby(sorted(found, key=_robot), _robot):
        outcomes = list(own)
        alarms = sum(len(each.false) for each in outcomes)
        minutes = sum(each.case.unchanged for each in outcomes) / 60.0
        watched = sum(each.watched for each in outcomes) / 60.0
        yield (
            f"{what}: {robot}",
            f"{alarms} alarms in {minutes:.1f} min, {watched:.1f} watched",
            "0",
            _met([alarms == 0]),
            "",
        )


def _robot(found: Outcome) -> tuple[str, str]:
    return found.case.what if found.case.change is None else "before and after changes", found.case.robot


def _delays(found: Sequence[Outcome]) -> Iterator[_ROW]:
    """A line for each change of each robot."""
    changed = [each for each in found if each.case.change is not None]
    for (what, robot, joint), own in groupby(sorted(changed, key=_place), _place):
        outcomes = list(own)
        target = _PICKED if what == PAYLOAD else _TARGET
        gap = ", ".join(f"{each.floors:.2f}" for each in outcomes)
        yield f"{what}: {robot} {joint}", *_seconds([each.seconds for each in outcomes], target), gap
        if what == PAYLOAD:
            masses = [each.mass for each in outcomes]
            errors = ", ".join(f"{100.0 * mass:+.1f} %" for mass in masses)
            met = _met([abs(mass) <= _EXACT for mass in masses])
            yield f"mass: {robot}", errors, f"{100.0 * _EXACT:g} %", met, ""
            yield f"put down: {robot}", *_seconds([each.closed for each in outcomes], _CLOSED), ""


def _seconds(found: Sequence[float], target: float) -> tuple[str, str, str]:
    text = ", ".join(f"{s:.1f} s" if np.isfinite(s) else "none" for s in found)
    return text, f"{target:g} s", _met([s <= target for s in found])


def _place(found: Outcome) -> tuple[str, str, str]:
    return found.case.what, found.case.robot, found.case.joint


def _met(each: Sequence[bool]) -> str:
    return f"{sum(each)} of {len(each)}"


if __name__ == "__main__":
    main()
