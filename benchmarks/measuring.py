"""Time and memory of a method, each in a process of its own."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import ParamSpec, TypeVar

import numpy as np

from benchmarks.problem import Problem
from geomid_ros.types import FloatArray

P = ParamSpec("P")
T = TypeVar("T")
_REPEATS = 7
_ENOUGH = 10.0  # seconds of repetitions


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a method found, the ``seconds`` of its fastest run and of its first, and the process's ``peak`` of memory
    with its ``growth`` during the fit [MB]."""

    parameters: FloatArray
    seconds: float
    first_seconds: float
    peak: float
    growth: float


def measure(problem: Problem, method: str, weight: float) -> Measurement:
    """Fit ``problem`` in a fresh process."""
    return in_fresh_process(_measure, problem, method, weight)


def in_fresh_process(function: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T:
    """The result of a function of a module, called in a new process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments, **keywords).result()


def best_of(action: Callable[[], object], repeats: int = _REPEATS, enough: float = _ENOUGH) -> float:
    """Seconds of the fastest of several runs; fewer if they take ``enough`` seconds."""
    best, begin = float("inf"), time.perf_counter()
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        now = time.perf_counter()
        best = min(best, now - start)
        if now - begin > enough:
            break
    return best


def _measure(problem: Problem, name: str, weight: float) -> Measurement:
    from benchmarks import peers  # noqa: PLC0415 what else is measured needs no peers

    fit = peers.method(name).fit
    before = resident("VmRSS")
    begin = time.perf_counter()
    parameters = fit(problem, weight)
    first = time.perf_counter() - begin
    seconds = first if first > _ENOUGH else min(first, best_of(lambda: fit(problem, weight)))
    peak = resident("VmHWM")
    return Measurement(parameters, seconds, first, peak, peak - before)


@dataclass(frozen=True)
class Used:
    """Time on the ``processor`` [s] and ``peak`` of memory [MB] of a whole process."""

    processor: float
    peak: float


def used_by(arguments: Sequence[str], environment: Mapping[str, str] = os.environ, *, may_fail: bool = True) -> Used:
    """What a process of Python with these arguments takes, which says what it likes to nobody.

    Its peak is not below what the calling process holds. One that must not fail may not exit with an error's status.
    """
    actions = [(os.POSIX_SPAWN_OPEN, end, os.devnull, os.O_WRONLY, 0) for end in (1, 2)]
    process = os.posix_spawn(sys.executable, [sys.executable, *arguments], environment, file_actions=actions)
    _, status, used = os.wait4(process, 0)
    if status and not may_fail:
        raise RuntimeError(f"python {' '.join(arguments)}: exit status {os.waitstatus_to_exitcode(status)}")
    return Used(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Of the least-squares power law of costs over sizes."""
    return float(np.polyfit(np.log(sizes), np.log(np.maximum(costs, 1e-3)), 1)[0])


def processor_seconds(process: int) -> float:
    """Time that a process has had on the processor."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def family(process: int) -> list[int]:
    """A process and those that it has started."""
    threads = Path(f"/proc/{process}/task").glob("*/children")
    children = [child for thread in threads for child in thread.read_text(encoding="ascii").split()]
    return [process, *(member for child in children for member in family(int(child)))]


def proportional(process: int) -> float:
    """Resident memory of a process in MB, of which pages shared by several processes count for each in part."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii").splitlines()
    (line,) = (line for line in lines if line.startswith("Pss:"))
    return int(line.split()[1]) / 1024.0


def resident(field: str, process: int | str = "self") -> float:
    """Resident memory of a process in MB (``VmHWM`` is its peak; getrusage's is inherited from the parent)."""
    lines = Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines()
    (line,) = (line for line in lines if line.startswith(field + ":"))
    return int(line.split()[1]) / 1024.0
