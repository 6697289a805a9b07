"""A process that tries inputs under limits: time and memory of each, and the process may die of any.

``python -m benchmarks.fuzz.worker TARGET FIRST END FOLDER`` writes one line of JSON for each input that fails, and one
of counts now and then. The file ``FOLDER/at`` always has the number of the input that is being tried.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.fuzz.table import made
from benchmarks.fuzz.target import Target, numbers
from geomid_ros.errors import GeomidError

SECONDS = 2.0
"""Of the processor, that an input may take."""

MEMORY = 1 << 30
"""Bytes that an input may take beyond what the process has before."""

_REPORT_EVERY = 500


class _TooLongError(BaseException):
    """Not an Exception, lest somebody catch it."""


def _stop(_number: int, _frame: FrameType | None) -> None:
    raise _TooLongError


def _try(target: Target, name: str, index: int) -> tuple[str, float]:
    """What became of an input (``refused``, ``accepted`` or a traceback), and its time [s]."""
    begin = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        target.attempt(numbers(name, index))
        result = "accepted"
    except GeomidError:
        result = "refused"
    except _TooLongError:
        result = f"took more than {SECONDS} s: {traceback.format_exc(limit=-6)}"
    except Exception:  # noqa: BLE001 that is what is looked for
        result = traceback.format_exc(limit=-6)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return result, time.process_time() - begin


def _memory(field: str) -> int:
    """A field of this process's status [bytes]."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(field + ":")]
    return 1024 * int(line.split()[1])


def main() -> None:
    """Try the inputs from FIRST to before END."""
    name, first, end, folder = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
    target = made(name, folder)
    signal.signal(signal.SIGPROF, _stop)
    size = _memory("VmSize") + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    before = _memory("VmHWM")
    counts: Counter[str] = Counter()
    slowest = (0.0, first)
    with (folder / "at").open("wb", buffering=0) as at:
        for index in range(first, end):
            os.pwrite(at.fileno(), f"{index:12d}".encode(), 0)
            result, seconds = _try(target, name, index)
            slowest = max(slowest, (seconds, index))
            counts[result if result in ("accepted", "refused") else "failed"] += 1
            if result not in ("accepted", "refused"):
                _tell(index=index, failure=result)
            if (index - first) % _REPORT_EVERY == _REPORT_EVERY - 1 or index == end - 1:
                _tell(counts=counts, slowest=slowest, memory=_memory("VmHWM") - before)
                counts.clear()


def _tell(**fields: Any) -> None:
    print(json.dumps(fields), flush=True)


if __name__ == "__main__":
    main()
