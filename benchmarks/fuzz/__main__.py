"""``python -m benchmarks.fuzz --target urdf --inputs 100000``: try inputs, and say what failed."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks.fuzz.running import Outcome, run
from benchmarks.fuzz.table import TARGETS

_SHOWN = 5  # failures of a target on the screen


def main() -> None:
    """Run the targets one after the other; exit status 1 if anything failed."""
    arguments = _parsed()
    outcomes = {}
    for name in arguments.target or TARGETS:
        outcomes[name] = _with_bar(name, arguments.first, arguments.inputs)
        _print(name, outcomes[name])
    if arguments.out:
        arguments.out.write_text(json.dumps({name: vars(outcome) for name, outcome in outcomes.items()}, indent=2))
    sys.exit(any(outcome.failures for outcome in outcomes.values()))


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__)
    parser.add_argument("--target", action="append", choices=TARGETS, help="may be repeated (all)")
    parser.add_argument("--inputs", type=int, default=100_000, help="of each target (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first input (%(default)s)")
    parser.add_argument("--out", type=Path, help="file for results (JSON)")
    return parser.parse_args()


def _with_bar(name: str, first: int, inputs: int) -> Outcome:
    outcome = Outcome()
    bars = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*bars) as progress, tempfile.TemporaryDirectory(dir=_fast_folder()) as folder:
        task = progress.add_task(name, total=inputs)
        for done in run(name, first, first + inputs, Path(folder), outcome):
            progress.update(task, completed=done)
    return outcome


def _fast_folder() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # noqa: S108 a folder within


def _print(name: str, outcome: Outcome) -> None:
    counts = ", ".join(f"{count} {what}" for what, count in sorted(outcome.counts.items()))
    seconds, index = outcome.slowest
    print(
        f"{name}: {outcome.counts.total()} inputs ({counts}); {len(outcome.failures)} failures; "
        f"slowest {seconds:.3f} s (input {index}); memory {outcome.memory / 1e6:.0f} MB above the start",
        flush=True,
    )
    for index, failure in outcome.failures[:_SHOWN]:
        print(f"  input {index}: {failure}", flush=True)


if __name__ == "__main__":
    main()
