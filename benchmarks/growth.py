"""How ``geomid gap`` grows with the length and the rate of a recording."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measuring import exponent, in_fresh_process, used_by
from benchmarks.report import Report

_RATE, _FAST = 100, 1000  # [Hz]
_CASES = ((30, _RATE), (120, _RATE), (600, _RATE), (30, _FAST))  # seconds, and messages per second
_MUST = {_CASES[0]: "2.5", _CASES[-1]: "4"}


@dataclass(frozen=True)
class _Cost:
    """Processor ``time`` [s] and ``peak`` of memory [MB] for so many ``seconds`` at a ``rate`` [Hz]."""

    seconds: int
    rate: int
    time: float
    peak: float


def run(report: Report) -> None:
    """A table: whole processes, and how they grow."""
    with TemporaryDirectory() as folder:
        costs = [_cost(report, Path(folder), seconds, rate) for seconds, rate in _CASES]
    rows = [
        [f"{c.seconds} s at {c.rate} Hz", f"{c.time:.1f}", _MUST.get((c.seconds, c.rate), ""), f"{c.peak:.0f}"]
        for c in costs
    ]
    slow = [cost for cost in costs if cost.rate == _RATE]
    seconds = [cost.seconds for cost in slow]
    each = (slow[-1].peak - slow[0].peak) / (seconds[-1] - seconds[0])
    grown = [exponent(seconds, [cost.time for cost in slow]), exponent(seconds, [cost.peak for cost in slow])]
    rows.append([f"exponents, {seconds[0]} to {seconds[-1]} s", f"{grown[0]:.2f}", "1", f"{grown[1]:.2f}"])
    caption = (
        "Whole processes: arm7, simulated, with friction, rotor inertia and offsets at every joint. "
        f"A second more at {_RATE} Hz takes {each:.2f} MB (must be: .3)."
    )
    report.table("Growth of geomid gap", ["", "processor s", "must be", "peak [MB]"], rows, caption)
    report.result("growth", {"costs": [asdict(cost) for cost in costs], "MB per second": each, "exponents": grown})


def _cost(report: Report, folder: Path, seconds: int, rate: int) -> _Cost:
    report.progress(f"growth: {seconds} s at {rate} Hz")
    bag = str(folder / f"{seconds}s_{rate}Hz")
    simulate = ("simulate", bag, "--robot", "arm7", "--duration", str(seconds), "--rate", str(rate))
    gap = ("gap", bag, "--out", str(folder / "gap"))
    _, used = (in_fresh_process(used_by, ("-m", "geomid_ros", *each), may_fail=False) for each in (simulate, gap))
    return _Cost(seconds, rate, used.processor, used.peak)


if __name__ == "__main__":
    run(Report())
