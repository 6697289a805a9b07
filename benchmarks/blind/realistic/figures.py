"""The realistic bench's figures beside their targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import median

from benchmarks.blind.figures import Line, reliability
from benchmarks.blind.realistic.judging import RealisticJudgement, Size

_TITLES = {"model": "with --model", "urdf": "URDF alone"}


def figures(cases: Sequence[RealisticJudgement]) -> list[Line]:
    """The lines of the table."""
    model, urdf = ([case for case in cases if case.situation == situation] for situation in _TITLES)
    shown = [case for case in urdf if case.counted]
    return [
        _share("with --model: the change named first and confident", model, lambda case: case.first, ">= 65 %", "85 %"),
        _share("with --model: right and confident", model, lambda case: case.right),
        _share("with --model: listed", model, lambda case: case.listed),
        _share("URDF alone: right and confident", shown, lambda case: case.right, ">= 65 %", "85 %"),
        _share("URDF alone: listed", shown, lambda case: case.listed, ">= 85 %"),
        _share("URDF alone: not told from inertias (not counted above)", urdf, lambda case: not case.counted),
        *(line for situation in _TITLES for line in _trouble(situation, cases)),
        *_of_sizes("confident sizes of the change", [s for case in cases for s in case.sizes if _is_change(case, s)]),
        *_of_sizes("all confident sizes", [size for case in cases for size in case.sizes]),
        *reliability([pair for case in cases for pair in case.probabilities]),
        *(line for situation in _TITLES for line in _left(situation, cases)),
    ]


def _is_change(case: RealisticJudgement, size: Size) -> bool:
    return (size.effect, size.joint) == case.hidden


def _trouble(situation: str, cases: Sequence[RealisticJudgement]) -> list[Line]:
    those, title = [case for case in cases if case.situation == situation], _TITLES[situation]
    wrong = float(sum(len(case.wrong) for case in those))
    late = float(sum(case.false_delay for case in those))
    return [
        Line(f"{title}: wrong confident names", wrong, "", len(those), "0", ""),
        Line(f"{title}: a delay more than 2 ms off named", late, "", len(those), "0", ""),
    ]


def _of_sizes(what: str, sizes: Sequence[Size]) -> list[Line]:
    off = 100.0 * median(size.off for size in sizes) if sizes else math.nan
    beyond = 100.0 * sum(size.sigmas > 3.0 for size in sizes) / len(sizes) if sizes else math.nan
    return [
        Line(f"{what}: error, median", off, "%", len(sizes), "<= 2 %", ""),
        Line(f"{what}: beyond 3 standard deviations", beyond, "%", len(sizes), "<= 2 %", ""),
    ]


def _left(situation: str, cases: Sequence[RealisticJudgement]) -> list[Line]:
    those, title = [case for case in cases if case.situation == situation], _TITLES[situation]
    return [
        _statistic(f"{title}: simulated again after, median", those, _resimulated, median, "<= 2.5", "1.5"),
        _statistic(f"{title}: simulated again after, largest", those, _resimulated, max, "<= 8"),
        _statistic(f"{title}: worst channel after, median", those, lambda case: case.after, median),
        _statistic(f"{title}: seconds per run, median", those, lambda case: case.seconds, median),
    ]


def _resimulated(case: RealisticJudgement) -> float:
    return case.resimulated


def _share(
    what: str,
    cases: Sequence[RealisticJudgement],
    holds: Callable[[RealisticJudgement], bool],
    must: str = "",
    aim: str = "",
) -> Line:
    value = 100.0 * sum(map(holds, cases)) / len(cases) if cases else math.nan
    return Line(what, value, "%", len(cases), must, aim)


def _statistic(
    what: str,
    cases: Sequence[RealisticJudgement],
    quantity: Callable[[RealisticJudgement], float],
    summary: Callable[[list[float]], float],
    must: str = "",
    aim: str = "",
) -> Line:
    values = [value for value in map(quantity, cases) if math.isfinite(value)]
    return Line(what, summary(values) if values else math.nan, "", len(values), must, aim)
