"""From messages to rows, as the node takes them: processor time for a message by how many are taken at once."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator

import numpy as np

from benchmarks.report import Report
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import Decoder, Raw
from geomid_ros.types import FloatArray

_TICKS = (1, 2, 5, 20)  # taken at once, of two messages each
_RATES = {100.0: 30.0, 1000.0: 8.0}  # [Hz]: seconds
_PARTS = 15  # of a run, of which the cheapest counts
_PERIOD = 8.0  # [s] of the motion
_ORIGIN = 10**18  # [ns]


def run(report: Report) -> None:
    """A row for each rate, in microseconds."""
    from benchmarks.load.robots import robots  # noqa: PLC0415 the other experiments need no ROS

    robot = robots()["arm7"]
    flat = {f"wrench.{name}.{key}": v for name, s in robot.parameters["wrench"].items() for key, v in s.items()}
    costs: dict[str, list[float]] = {}
    for rate, seconds in _RATES.items():
        messages = robot.messages(rate, _PERIOD)
        costs[f"{rate:g} Hz"] = []
        for ticks in _TICKS:
            report.progress(f"batches: {rate:g} Hz, {ticks} at once")
            session = Session(robot.urdf, Configuration({"wrenches": list(robot.frames), **flat}), robot.name)
            costs[f"{rate:g} Hz"].append(_cost(session, list(_batches(messages, rate, seconds, ticks))))
    rows = [[rate, *(f"{1e6 * cost:.0f}" for cost in found)] for rate, found in costs.items()]
    headings = ["us per message", *(f"{ticks} instants at once" for ticks in _TICKS)]
    caption = f"Processor time, the cheapest of {_PARTS} parts of a run. Each instant: joint states and a wrench."
    report.table("From messages to rows by the size of batches, arm of 7 joints", headings, rows, caption)
    report.result("batches", costs)


def _batches(messages: dict[str, FloatArray], rate: float, seconds: float, ticks: int) -> Iterator[list[Raw]]:
    from benchmarks.load.robots import STAMP  # noqa: PLC0415 as above

    for first in range(0, round(rate * seconds), ticks):
        batch: list[Raw] = []
        for tick in range(first, first + ticks):
            stamp = struct.pack("<iI", *divmod(_ORIGIN + round(tick * 1e9 / rate), 10**9))
            for topic, rows in messages.items():
                data = rows[tick % len(rows)].tobytes()
                batch.append((topic, data[:STAMP] + stamp + data[STAMP + 8 :]))
        yield batch


def _cost(session: Session, batches: list[list[Raw]]) -> float:
    """Seconds for a message."""
    decoder, costs = Decoder(), []
    for part in np.array_split(np.arange(len(batches)), _PARTS):
        begin = time.process_time()
        for index in part:
            session.pipeline.push(decoder.blocks(batches[index], _refuse))
            samples = session.pipeline.collect()
            if samples is not None:
                session.identifier.add(samples)
        costs.append((time.process_time() - begin) / sum(len(batches[index]) for index in part))
    return min(costs[1:])


def _refuse(place: int, why: str) -> None:
    raise RuntimeError(f"message {place}: {why}")


if __name__ == "__main__":
    run(Report())
