"""The paper reproduced, beside other methods: tables on the screen, pictures and results.json in a folder."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path

from benchmarks.problem import DataAbsentError
from benchmarks.report import FOLDER, Report, chosen

EXPERIMENTS = {
    "planar": "planar",
    "one_row": "one_row",
    "human": "human",
    "person": "simulated_person",
    "people": "people",
    "coverage": "coverage",
    "posterior": "posterior",
    "arm": "measured_arm",
    "gaps": "measured_gaps",
    "speed": "speed",
    "choice": "choice",
    "command_line": "command_line",
    "scale": "scale",
    "growth": "growth",
    "streaming": "streaming",
    "warm": "warm",
    "payload": "payload",
    "load": "load",
    "intake": "intake",
    "batches": "batches",
}
"""Modules of the experiments, by their names."""


def main() -> None:
    """Run the chosen experiments, all unless named; those whose data are absent say so."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help=f"any of {', '.join(EXPERIMENTS)}")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder for results (%(default)s)")
    arguments = parser.parse_args()
    report = Report(arguments.out)
    for name in chosen(parser, arguments.experiments, EXPERIMENTS):
        try:
            import_module(f"benchmarks.{EXPERIMENTS[name]}").run(report)
        except DataAbsentError as absent:
            report.say(f"{name}: skipped, {absent}\n")
        except ModuleNotFoundError as absent:
            parser.exit(2, f"{name}: needs {absent.name}: pip install --requirement requirements-bench.txt\n")


if __name__ == "__main__":
    main()
