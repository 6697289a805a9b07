"""From messages of a bag to samples, beside reading its bytes: an arm of 7 joints at 1 kHz, a wrench per message."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measuring import in_fresh_process, resident
from benchmarks.report import Report
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.session.session import Session
from geomid_ros.simulation.description import WRIST_FRAME
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate

_URDF = Path(__file__).parents[1] / "bags" / "arm7.urdf"
_RATE = 1000.0  # Hz
_SHORT, _LONG = 10.0, 40.0  # seconds of recording
_ROUNDS = 5
_WRENCH = {"wrenches": ["wrist"], "wrench.wrist.topic": "/wrench", "wrench.wrist.frame": WRIST_FRAME}
_TOPICS = Topics("joint_states", "odom")


@dataclass(frozen=True)
class _Cost:
    """Of a recording: its ``messages``, the processor ``seconds`` to read their bytes and to make samples of them, and
    the ``growth`` of memory [MB] while the samples are made and passed on."""

    messages: int
    raw_seconds: float
    sample_seconds: float
    growth: float


def run(report: Report) -> None:
    """Time per message and its ratio, memory for recordings of two lengths."""
    with TemporaryDirectory() as folder:
        costs = []
        for seconds in (_SHORT, _LONG):
            report.progress(f"intake: {seconds:g} s at {_RATE:g} Hz")
            bag = Path(folder) / f"{seconds:g}"
            simulate(bag, SimulationOptions(robot="arm7", duration=seconds, rate=_RATE, wrench_frame=WRIST_FRAME))
            costs.append(in_fresh_process(_measure, bag))
    headings = ["messages", "bytes [us per message]", "samples [us per message]", "ratio", "growth of memory [MB]"]
    rows = [
        [
            f"{cost.messages:,}",
            f"{1e6 * cost.raw_seconds / cost.messages:.1f}",
            f"{1e6 * cost.sample_seconds / cost.messages:.1f}",
            f"{cost.sample_seconds / cost.raw_seconds:.2f}",
            f"{cost.growth:.1f}",
        ]
        for cost in costs
    ]
    caption = (
        f"Processor seconds, best of {_ROUNDS} runs in turns. The ratio must be at most 4, aim 2; memory must not grow "
        "with the recording."
    )
    report.table("Intake: bag to samples, arm of 7 joints at 1 kHz with a wrench sensor", headings, rows, caption)
    report.result("intake", [asdict(cost) for cost in costs])


def _measure(path: Path) -> _Cost:
    session = Session(read_urdf(_URDF), Configuration({**_WRENCH, "wrench.wrist.role": "mounted"}), _URDF.name)
    before = resident("VmHWM")
    sample_seconds = _processor_seconds(lambda: _make_samples(session, path))
    growth = resident("VmHWM") - before
    raw_seconds = _processor_seconds(lambda: _read_bytes(path))
    for _ in range(_ROUNDS):
        raw_seconds = min(raw_seconds, _processor_seconds(lambda: _read_bytes(path)))
        sample_seconds = min(sample_seconds, _processor_seconds(lambda: _make_samples(session, path)))
    with Bag(path) as bag:
        messages = bag.count(["/joint_states", "/wrench"])
    return _Cost(messages, raw_seconds, sample_seconds, growth)


def _processor_seconds(action: Callable[[], object]) -> float:
    begin = time.process_time()
    action()
    return time.process_time() - begin


def _read_bytes(path: Path) -> None:
    with Bag(path) as bag:
        for _ in bag.raw_messages(["/joint_states", "/wrench"]):
            pass


def _make_samples(session: Session, path: Path) -> None:
    with Bag(path) as bag:
        for _ in read_samples(bag, session, session.new_pipeline(), _TOPICS):
            pass


if __name__ == "__main__":
    run(Report())
