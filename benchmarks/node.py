"""The node under load: 1 kHz joint states of seven joints while its worker solves without pause.

The node and the player run as processes of their own, on real DDS. What is told of the node comes from its own
diagnostics; time of the processor and memory come from the system.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.measuring import processor_seconds, resident
from benchmarks.report import Report
from geomid_ros.files.bags import Bag
from geomid_ros.files.configuration import Configuration
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.robots import robot_description
from geomid_ros.simulation.simulate import simulate

_ROBOT = "arm7"
_SECONDS = 60.0
_RATE = 1000.0  # Hz
_TOPIC = "joint_states"
_RECEIVED, _ACCEPTED = f"{_TOPIC} received", f"{_TOPIC} accepted"
_REFUSED = (f"{_TOPIC} rejected: ", "dropped: ")
_QUANTILES = ("p50", "p99", "max")
_LOADS: dict[str, dict[str, Any]] = {
    "defaults: a solve every second": {},
    "solving without pause": {"solve_period": 0.001},
    # So many instants (142 a second) that new ones wait whenever a solve has ended.
    "without pause, cutoff 18 Hz": {"solve_period": 0.001, "filter.cutoff": 18.0},
}


@dataclass(frozen=True)
class _Outcome:
    """What one run showed: messages ``sent`` and what became of them, rows, solves, the ``quantiles`` of the time from
    receipt to row [ms], the share of one core that the node took, its peak of memory [MB], the machine's load."""

    sent: int
    received: int
    accepted: int
    rejected: dict[str, int]
    rows: int
    solves: int
    quantiles: dict[str, float]
    processor: float
    memory: float
    load: float


def run(report: Report) -> None:
    """One line of the table for each load."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "bag"
        report.progress("node: simulating the recording")
        simulate(recording, SimulationOptions(robot=_ROBOT, duration=_SECONDS, rate=_RATE))
        urdf = Path(folder) / "robot.urdf"
        urdf.write_text(robot_description(_ROBOT), encoding="utf-8")
        outcomes = {}
        for name, parameters in _LOADS.items():
            report.progress(f"node: {name}")
            outcomes[name] = _played(recording, urdf, Configuration(parameters), Path(folder) / "out")
    caption = (
        "From receipt to row: from a message's callback until the instants that it completed are rows in the buffer; "
        "the filter's fixed lag is not in it. p99 must be at most 10 ms, aim 1 ms. Processor: the node's share of one "
        f"core, of the {os.cpu_count()} that node, player, watcher and whatever else runs here share."
    )
    headings = ["", "sent", "received", "accepted", "rejected", "rows", "solves/s"]
    headings += [*(f"{q} [ms]" for q in _QUANTILES), "processor", "peak MB", "load average"]
    rows = [_line(name, outcome) for name, outcome in outcomes.items()]
    report.table(f"The node: {_RATE:g} Hz, 7 joints, {_SECONDS:g} s", headings, rows, caption)
    report.result("node", {name: asdict(outcome) for name, outcome in outcomes.items()})


def _line(name: str, outcome: _Outcome) -> list[str]:
    return [
        name,
        str(outcome.sent),
        str(outcome.received),
        str(outcome.accepted),
        ", ".join(f"{reason}: {count}" for reason, count in outcome.rejected.items()) or "0",
        str(outcome.rows),
        f"{outcome.solves / _SECONDS:.1f}",
        *(f"{outcome.quantiles[q]:.2f}" for q in _QUANTILES),
        f"{100.0 * outcome.processor:.0f} %",
        f"{outcome.memory:.0f}",
        f"{outcome.load:.1f}",
    ]


def _played(recording: Path, urdf: Path, configuration: Configuration, out: Path) -> _Outcome:
    """Play the recording into a node with this configuration."""
    from geomid_ros.ros.live_run import LiveRun  # noqa: PLC0415 the other experiments need no ROS

    with Bag(recording) as bag:
        sent = bag.count([f"/{_TOPIC}"])
    with LiveRun(recording, urdf, configuration, out, 1.0) as live:
        begin, used = time.monotonic(), processor_seconds(live.node_process)
        processor = 0.0
        for _ in live.watch():
            if _RECEIVED not in live.diagnostics:
                begin, used = time.monotonic(), processor_seconds(live.node_process)
            else:
                processor = (processor_seconds(live.node_process) - used) / (time.monotonic() - begin)
        memory = resident("VmHWM", live.node_process)
        told = live.diagnostics
    return _Outcome(
        sent,
        int(told[_RECEIVED]),
        int(told[_ACCEPTED]),
        {key: int(value) for key, value in told.items() if key.startswith(_REFUSED)},
        int(told["rows"]),
        int(told["solves"]),
        {q: float(told[f"receipt to row {q} [ms]"]) for q in _QUANTILES},
        processor,
        memory,
        os.getloadavg()[0],
    )
