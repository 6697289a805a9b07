"""``python -m benchmarks.excite``: designed motions on five robots."""

from __future__ import annotations

import time
from argparse import ArgumentParser
from pathlib import Path

import numpy as np

from benchmarks.excite.independent import Limits, Simulated
from benchmarks.excite.learned import after_poor_data, against_random
from benchmarks.excite.robots import ROBOTS, description, task, wish
from benchmarks.excite.settled import settled
from benchmarks.report import Report, chosen
from geomid_ros.files.trajectories import write_yaml
from geomid_ros.session.excitation import Excitation, design

SECONDS = 10.0


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", help="all unless named")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only", choices=("safety", "learning", "poor", "settle"))
    parser.add_argument("--out", type=Path, default=Path("out/excite"))
    options = parser.parse_args()
    report = Report(options.out)
    robots = chosen(parser, options.robots, ROBOTS)
    if options.only in (None, "safety"):
        _safety(report, list(robots), options.seeds, options.out)
    if options.only in (None, "learning"):
        against_random(report, list(robots), SECONDS, options.seeds)
    if options.only in (None, "poor"):
        after_poor_data(report, list(robots), SECONDS, options.seeds)
    if options.only in (None, "settle"):
        settled(report, SECONDS, options.out)


def _safety(report: Report, robots: list[str], seeds: int, folder: Path) -> None:
    """Violations at 1 kHz, and the time of designs."""
    rows, results = [], {}
    for robot in robots:
        found, seconds = [], []
        for seed in range(seeds):
            report.progress(f"{robot}: seed {seed}")
            asked = wish(robot, SECONDS, seed)
            begin = time.process_time()
            designed = design(task(robot, asked), asked)
            seconds.append(time.process_time() - begin)
            found.append(_violations(robot, designed, folder / "trajectory.yaml"))
        total = {kind: sum(own[kind] for own in found) for kind in found[0]}
        results[robot] = total | {"processor seconds": float(np.mean(seconds)), "motions": len(found)}
        report.result("safety", results)
        rows.append([robot, *map(str, total.values()), f"{np.mean(seconds):.1f}", f"{max(seconds):.1f}"])
    headings = ["robot", *(kind for kind in found[0]), "design [s]", "longest"]
    report.table(f"Instants in violation at 1 kHz, {seeds} motions of {SECONDS:g} s each", headings, rows)


def _violations(robot: str, designed: Excitation, path: Path) -> dict[str, int]:
    write_yaml(path, designed.trajectory)
    feasibility = designed.task.feasibility
    own = feasibility.limits
    clearances: dict[frozenset[str], float] = {}
    pairs = feasibility.collision.pairs if feasibility.collision else ()
    for pair, asked in zip(pairs, feasibility.clearances.tolist(), strict=True):
        names = frozenset((pair.first, pair.second))
        clearances[names] = min(asked, clearances.get(names, np.inf))
    limits = Limits(own.position, own.velocity, own.acceleration, own.jerk, own.effort, clearances)
    return Simulated(description(robot), feasibility.names).violations(path, limits)


if __name__ == "__main__":
    main()
