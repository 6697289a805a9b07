"""What `geomid` costs from start to end, beside a short script that does the least there is to do."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measuring import used_by
from benchmarks.problem import measured
from benchmarks.report import Report

_ROUNDS = 9
_GEOMID = ("-m", "geomid_ros")
_COMPLETION = {"_GEOMID_COMPLETE": "bash_complete", "COMP_WORDS": "geomid ", "COMP_CWORD": "1"}
_COMPLETE = (
    "-c",
    "import sys; sys.argv[0] = 'geomid'; from geomid_ros.commands import main; main()",
)


def run(report: Report) -> None:
    """Processor seconds of processes and their ratios."""
    report.progress("command_line: help")
    short = _in_turns(
        {
            "import click": ("-c", "import click"),
            "geomid --help": (*_GEOMID, "--help"),
            "geomid --version": (*_GEOMID, "--version"),
            "geomid unknown": (*_GEOMID, "unknown"),
            "geomid identify --help": (*_GEOMID, "identify", "--help"),
            "geomid identify": (*_GEOMID, "identify"),
            "completion of geomid": _COMPLETE,
        }
    )
    report.progress("command_line: identify")
    folder = measured("ur10_unisa_rosbag2")
    bag, urdf = str(folder / "ur10_exciting_trajectory"), str(folder / "ur10.urdf")
    with TemporaryDirectory() as out:
        naive = str(Path(__file__).with_name("naive.py"))
        identify = (*_GEOMID, "identify", bag, "--urdf", urdf, "--out", out)
        whole = _in_turns({"naive.py": (naive, bag, urdf), "geomid identify": identify})
    rows = [_line(name, short[name], "import click", short["import click"], "2.5") for name in short]
    rows.append(_line("geomid identify, UR10", whole["geomid identify"], "naive.py", whole["naive.py"], "2.1, aim 1.3"))
    caption = (
        f"Processor seconds of whole processes, best of {_ROUNDS} in turns. naive.py reads the bag with rosbags, "
        "filters with scipy, builds pinocchio's regressor and solves least squares; it checks and draws nothing."
    )
    report.table("The command line", ["", "s", "beside", "s", "ratio", "must be"], rows[1:], caption)
    report.result("command_line", {"short": short, "whole": whole})


def _line(name: str, ours: float, other: str, theirs: float, must: str) -> list[str]:
    return [name, f"{ours:.3f}", other, f"{theirs:.3f}", f"{ours / theirs:.2f}", must]


def _in_turns(commands: dict[str, Sequence[str]]) -> dict[str, float]:
    """The least processor seconds of each command of Python; every round runs all of them."""
    seconds = dict.fromkeys(commands, float("inf"))
    for _ in range(_ROUNDS):
        for name, arguments in commands.items():
            environment = os.environ | (_COMPLETION if arguments is _COMPLETE else {})
            seconds[name] = min(seconds[name], used_by(arguments, environment).processor)
    return seconds


if __name__ == "__main__":
    run(Report())
