"""The paper reproduced, beside other methods: tables on the screen, pictures and results.json in a folder."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the package's entry points do; small matrices gain nothing

import argparse
from collections.abc import Callable
from pathlib import Path

from benchmarks import (
    batches,
    choice,
    command_line,
    coverage,
    growth,
    human,
    intake,
    load,
    measured_arm,
    measured_gaps,
    one_row,
    payload,
    people,
    planar,
    posterior,
    scale,
    simulated_person,
    speed,
    streaming,
    warm,
)
from benchmarks.problem import DataAbsentError
from benchmarks.report import Report, chosen

EXPERIMENTS: dict[str, Callable[[Report], None]] = {
    "planar": planar.run,
    "one_row": one_row.run,
    "human": human.run,
    "person": simulated_person.run,
    "people": people.run,
    "coverage": coverage.run,
    "posterior": posterior.run,
    "arm": measured_arm.run,
    "gaps": measured_gaps.run,
    "speed": speed.run,
    "choice": choice.run,
    "command_line": command_line.run,
    "scale": scale.run,
    "growth": growth.run,
    "streaming": streaming.run,
    "warm": warm.run,
    "payload": payload.run,
    "load": load.run,
    "intake": intake.run,
    "batches": batches.run,
}


def main() -> None:
    """Run the chosen experiments, all unless named; those whose data are absent say so."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help=f"any of {', '.join(EXPERIMENTS)}")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder for results (%(default)s)")
    arguments = parser.parse_args()
    report = Report(arguments.out)
    for name in chosen(parser, arguments.experiments, EXPERIMENTS):
        try:
            EXPERIMENTS[name](report)
        except DataAbsentError as absent:
            report.say(f"{name}: skipped, {absent}\n")


if __name__ == "__main__":
    main()
