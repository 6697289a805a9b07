"""All seeds of the realistic bench: a line for each situation of a case, and the table."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.blind.realistic.figures import figures
from benchmarks.blind.realistic.judging import RealisticJudgement, judge
from benchmarks.blind.realistic.running import SITUATIONS, outcome


def run_realistic(seeds: Sequence[int], out: Path, jobs: int) -> None:
    """Run the seeds that are not finished yet, and report on all."""
    judged = []
    columns = TextColumn("robots"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    with Progress(*columns) as progress:
        task = progress.add_task("robots", total=len(seeds))
        for document in _outcomes(seeds, out, jobs):
            for line, judgement in _told(document):
                progress.console.print(line, markup=False, highlight=False, soft_wrap=True)
                judged += [judgement] if judgement else []
            progress.advance(task)
    judged.sort(key=lambda case: (case.seed, case.situation))
    if judged:
        _report(judged, out)


def _outcomes(seeds: Sequence[int], out: Path, jobs: int) -> Iterator[dict[str, Any]]:
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(outcome, seed, out) for seed in seeds]):
            yield future.result()


def _told(document: dict[str, Any]) -> Iterator[tuple[str, RealisticJudgement | None]]:
    """A line for each situation of a case, and what can be judged."""
    if "error" in document:
        yield f"{document['seed']}: error: {document['error']}", None
        return
    for situation in SITUATIONS:
        if "error" in document[situation]:
            yield f"{document['seed']} {situation}: error: {document[situation]['error']}", None
        else:
            case = judge(document, situation)
            yield _line(case), case


def _line(case: RealisticJudgement) -> str:
    sure = [f"{effect} {joint}" for effect, joint, confidence in case.named if confidence == "confident"]
    verdict = "first" if case.first else "right" if case.right else "listed" if case.listed else "missed"
    wrong = "".join(f" WRONG {effect} {joint}" for effect, joint in case.wrong)
    late = " WRONG DELAY" if case.false_delay else ""
    return (
        f"{case.seed} {case.situation} ({case.robot}): {' '.join(case.hidden)}, shows {case.shown:.1f} -> {verdict}"
        f"{wrong}{late}; sure: {', '.join(sure) or 'nothing'}, others: {len(case.named) - len(sure)} | {case.verdict}"
        f" | after {case.after:.2f}, simulated {case.resimulated:.2f} | {case.seconds:.0f} s"
    )


def _report(judged: Sequence[RealisticJudgement], out: Path) -> None:
    table = figures(judged)
    print(f"\n{'':<62} {'value':>12} {'cases':>6}   {'must be':<18} aim")
    for figure in table:
        print(figure)
    results = {"figures": [asdict(figure) for figure in table], "cases": [asdict(case) for case in judged]}
    (out / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    print(f"\nWritten: {out / 'results.json'}")
