"""Hide effects, let ``geomid gap`` find them, and count: a confusion matrix, and figures beside their targets."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.blind.case import KINDS
from benchmarks.blind.figures import draw_matrix, figures, print_matrix
from benchmarks.blind.judging import Judgement, judge
from benchmarks.blind.realistic.bench import run_realistic
from benchmarks.blind.running import outcome


def main() -> None:
    """Run the cases that are not finished yet, and report on all."""
    arguments = _parsed()
    if arguments.realistic:
        run_realistic(arguments.seeds, arguments.out or Path("out/realistic"), arguments.jobs)
    else:
        _run_clean(arguments, arguments.out or Path("out/blind"))


def _run_clean(arguments: argparse.Namespace, out: Path) -> None:
    cases = [(kind, seed) for seed in arguments.seeds for kind in arguments.kinds]
    judged = []
    for number, document in enumerate(_outcomes(cases, out, arguments.jobs), 1):
        line, judgement = _told(document)
        print(f"[{number}/{len(cases)}] {line}", flush=True)
        judged += [judgement] if judgement else []
    judged.sort(key=lambda case: (case.kind, case.seed))
    if judged:
        _report(judged, out)


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind", description=__doc__)
    parser.add_argument(
        "--seeds",
        type=_seeds,
        default=range(10_000, 10_040),
        help="FIRST:LAST+1, FIRST:LAST+1:STEP (every 14th has the same single effect), or one (10000:10040; 0 to 999 "
        "to develop)",
    )
    parser.add_argument("--kinds", type=_kinds, default=KINDS, help=f"of {','.join(KINDS)} (all)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (%(default)s)")
    parser.add_argument("--out", type=Path, help="folder; finished cases are kept (out/blind, or out/realistic)")
    parser.add_argument(
        "--realistic",
        action="store_true",
        help="robots as robots are: each seed is one, recorded before and after a change; --kinds does not count",
    )
    return parser.parse_args()


def _seeds(text: str) -> Sequence[int]:
    numbers = [int(number) for number in text.split(":")]
    return range(*numbers) if len(numbers) > 1 else range(numbers[0], numbers[0] + 1)


def _kinds(text: str) -> Sequence[str]:
    kinds = text.split(",")
    for kind in kinds:
        if kind not in KINDS:
            raise argparse.ArgumentTypeError(f"no kind is called '{kind}'; there are {', '.join(KINDS)}")
    return kinds


def _outcomes(cases: Sequence[tuple[str, int]], out: Path, jobs: int) -> Iterator[dict[str, Any]]:
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(outcome, kind, seed, out) for kind, seed in cases]):
            yield future.result()


def _told(document: dict[str, Any]) -> tuple[str, Judgement | None]:
    """A line about a finished case, and the case if it can be judged."""
    case = document["case"]
    name = f"{case['seed']} {case['kind']}"
    for trouble in ("skipped", "error"):
        if trouble in document:
            return f"{name}: {trouble}: {document[trouble]}", None
    judgement = judge(document)
    hidden = ", ".join(f"{effect} {joint}" for effect, joint in judgement.truth) or "nothing"
    named = ", ".join(f"{effect} {joint} {confidence}" for effect, joint, confidence in judgement.named) or "nothing"
    wrong = " WRONG" if judgement.wrong else ""
    gaps = f"{judgement.before:.2f} {judgement.inertias_only:.2f} {judgement.after:.2f}"
    place = f"{judgement.robot}{' wrench' if judgement.wrench else ''} {judgement.simulator} {judgement.motion}"
    return (
        f"{name} ({place}): {hidden} -> {named}{wrong} | {judgement.verdict} | gap {gaps} | {judgement.seconds:.1f} s",
        judgement,
    )


def _report(judged: Sequence[Judgement], out: Path) -> None:
    table = figures(judged)
    single = [case for case in judged if len(case.truth) < 2]
    if single:
        print()
        print_matrix(single)
        draw_matrix(single, out / "matrix.png")
    print()
    print(f"{'':<62} {'value':>12} {'cases':>6}   {'must be':<18} aim")
    for figure in table:
        print(figure)
    results = {"figures": [asdict(figure) for figure in table], "cases": [asdict(case) for case in judged]}
    (out / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    print(f"\nWritten: {out / 'results.json'}{' and matrix.png' if single else ''}")


if __name__ == "__main__":
    main()
