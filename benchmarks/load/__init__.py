"""The real node under load: rates, losses, latencies, memory, leaks, and how it ends; everything over DDS."""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.report import Report

sys.path.append(str(Path(__file__).parents[2] / "test"))  # whose stages and processes are used here


def run(report: Report) -> None:
    """All scenarios, for shorter than ``python -m benchmarks.load`` would."""
    from benchmarks.load.experiment import SCENARIOS  # noqa: PLC0415 the other experiments need no ROS

    for name, scenario in SCENARIOS.items():
        report.progress(f"load: {name}")
        scenario.measure(report, scenario.short)
