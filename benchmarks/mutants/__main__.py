"""``python -m benchmarks.mutants --count 60``: plant faults in the package, and see which of them the tests notice.

The faults are drawn with the commit's hash as seed, among those of the usual operators. Only what is committed counts.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from benchmarks.mutants.operators import Mutant, mutants
from benchmarks.mutants.running import copied, is_killed
from benchmarks.mutants.selection import Selection

_ROOT = Path(__file__).parents[2]
_ROOMS = ("checks", "gap", "live", "monitoring", "signals")
_PROCESSES = 2
_LONGEST = 200.0  # [s] of tests for one fault


def main() -> None:
    """Draw, try and list the faults."""
    arguments = _parsed()
    with tempfile.TemporaryDirectory() as folder:
        copies = [copied(_ROOT, Path(folder) / str(number)) for number in range(_PROCESSES)]
        selection = Selection.make(copies[0], [f"test/{room}" for room in arguments.room])
        drawn = _drawn(copies[0], arguments.room, arguments.seed, arguments.count)
        print(f"{len(drawn)} faults, seed {arguments.seed}", flush=True)
        killed = _tried(copies, selection, drawn)
    print(f"killed: {sum(killed)} of {len(drawn)}, {sum(killed) / len(drawn):.0%}")


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="of faults (%(default)s)")
    parser.add_argument("--seed", default=_commit(), help="of the draw (the commit)")
    parser.add_argument("--room", action="append", choices=_ROOMS, help="may be repeated (all)")
    arguments = parser.parse_args()
    arguments.room = arguments.room or _ROOMS
    return arguments


def _commit() -> str:
    command = ["git", "-C", str(_ROOT), "rev-parse", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()  # noqa: S603 ours


def _drawn(root: Path, rooms: list[str], seed: str, count: int) -> list[Mutant]:
    """Faults at different places, in the order of files and lines."""
    paths = sorted(path for room in rooms for path in (root / "geomid_ros" / room).rglob("*.py"))
    places = [place for path in paths for place in mutants(str(path.relative_to(root)), path.read_text("utf-8"))]
    chance = random.Random(seed)  # noqa: S311 no secret
    return sorted(chance.choice(place) for place in chance.sample(places, min(count, len(places))))


def _tried(copies: list[Path], selection: Selection, drawn: list[Mutant]) -> list[bool]:
    """Whether each fault was noticed; says so of each."""
    free: SimpleQueue[Path] = SimpleQueue()
    for root in copies:
        free.put(root)

    def attempt(mutant: Mutant) -> bool:
        root, tests = free.get(), selection.tests(mutant, _LONGEST)
        killed = bool(tests) and is_killed(root, mutant, tests, sum(selection.seconds[test] for test in tests))
        free.put(root)
        change = f"{' '.join(mutant.old.split())}  ->  {' '.join(mutant.new.split())}"
        fate = "killed" if killed else "LIVED "
        print(f"{fate} {mutant.path}:{mutant.line}: {change} ({len(tests)} tests)", flush=True)
        return killed

    with ThreadPoolExecutor(len(copies)) as pool:
        return list(pool.map(attempt, drawn))


if __name__ == "__main__":
    main()
