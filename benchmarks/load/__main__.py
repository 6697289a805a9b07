"""``python -m benchmarks.load arm --arm 600``: the node under load, as tables."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.load.experiment import SCENARIOS
from benchmarks.report import Report, chosen


def main() -> None:
    """Run the scenarios that are named, all unless named."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help=f"any of {', '.join(SCENARIOS)}")
    for name, scenario in SCENARIOS.items():
        unit = scenario.unit
        parser.add_argument(
            f"--{name}", type=float, default=scenario.amount, metavar=unit.upper(), help=f"{unit} (%(default)s)"
        )
    parser.add_argument("--out", type=Path, default=Path("out/load"), help="folder for results.json (%(default)s)")
    arguments = parser.parse_args()
    report = Report(arguments.out)
    for name in chosen(parser, arguments.scenarios, SCENARIOS):
        report.progress(f"load: {name}")
        SCENARIOS[name].measure(report, getattr(arguments, name))


if __name__ == "__main__":
    main()
