"""What a process holds of the system."""

from __future__ import annotations

from pathlib import Path

from benchmarks.measuring import resident


def holdings(process: int | str) -> tuple[float, int, int]:
    """Resident memory [MB], threads, file descriptors."""
    folder = Path("/proc") / str(process)
    return resident("VmRSS", process), *(len(list((folder / part).iterdir())) for part in ("task", "fd"))
