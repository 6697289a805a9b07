"""The bench's figures beside their targets, and the confusion matrix."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median

import numpy as np
from matplotlib.figure import Figure

from benchmarks.blind.case import KINDS, LIBRARY, OUTSIDE
from benchmarks.blind.judging import Judgement
from geomid_ros.types import IntArray

NOTHING, NOT_SURE, OTHER_JOINT, UNEXPLAINED = "nothing", "tentative", "other joint", "unexplained"
# Effect, unit, what it must be, what it should be.
_PARAMETERS = (
    (("viscous_friction", "coulomb_friction", "stribeck_friction", "load_friction"), "%", 1.0, 0.5),
    (("rotor_inertia",), "%", 2.0, 1.0),
    (("payload",), "% of mass", 3.0, 1.5),
    (("spring", "joint_elasticity"), "% of stiffness", 10.0, 5.0),
    (("effort_delay",), "ms", 0.5, 0.25),
    (("gravity_tilt",), "degrees", 0.1, 0.05),
)


@dataclass(frozen=True)
class Line:
    """A line of the table: a ``value`` from ``count`` cases, and what it ``must`` be and should be (``aim``)."""

    what: str
    value: float
    unit: str
    count: int
    must: str
    aim: str

    def __str__(self) -> str:
        shown = "-" if math.isnan(self.value) else f"{self.value:.3g} {self.unit}".strip()
        return f"{self.what:<62} {shown:>12} {self.count:>6}   {self.must:<18} {self.aim}"


_PROBABILITIES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.01)


def figures(cases: Sequence[Judgement]) -> list[Line]:
    """The lines of the table."""
    single, double, none, outside, large = ([case for case in cases if case.kind == kind] for kind in KINDS)
    visible, large_visible, outside_visible = ([c for c in each if c.visible] for each in (single, large, outside))
    fitted = [case for case in (*single, *double, *none) if "backlash" not in dict(case.truth)]
    return [
        _share("effect and joint right and confident, single, visible", visible, _all_right, ">= 92 %", ">= 98 %"),
        _share("the right one listed at all, single, visible", visible, _all_listed, ">= 97 %", "100 %"),
        _share("effect and joint right and confident, single, all", single, _all_right, "", ""),
        _share("not visible (gap below 1.15 x floor), single", single, lambda case: not case.visible, "", ""),
        _share("both right and confident, double", double, _all_right, "", ""),
        _share("wrong confident name, single", single, _wrong, "<= 2 %", "0"),
        _share("wrong confident name, double", double, _wrong, "<= 3 %", "0"),
        _share("named anything, no effect", none, lambda case: bool(case.named), "0", "0"),
        _share("something unexplained, no effect", none, lambda case: case.verdict != "no gap", "", ""),
        _share("flagged on the right joint, outside, visible", outside_visible, _flagged, ">= 95 %", "100 %"),
        _share("flagged on the right joint, outside, all", outside, _flagged, "", ""),
        _share("wrong confident name, outside", outside, _wrong, "", ""),
        _share("wrong confident name, large inertial errors", large, _wrong, "<= 5 %", "0"),
        _share("right and confident, large inertial errors, visible", large_visible, _all_right, "", ""),
        _statistic("held-out gap of the worst channel after, median", fitted, _after, median, "<= 1.1", "1.03"),
        _statistic("held-out gap of the worst channel after, largest", fitted, _after, max, "<= 1.2", ""),
        _channels("held-out gap of every channel after, median", fitted, median),
        _channels("held-out gap of every channel after, standard deviation", fitted, np.std),
        _statistic("simulated again after, median", fitted, lambda case: case.resimulated, median, "<= 1.5", "1.1"),
        _statistic("simulated again after, largest", fitted, lambda case: case.resimulated, max, "<= 1.5", ""),
        _statistic("seconds per run, median", cases, lambda case: case.seconds, median, "<= 10", "<= 3"),
        _statistic("processor seconds per run, median", cases, lambda case: case.processor_seconds, median, "", ""),
        *reliability([pair for case in cases for pair in case.probabilities]),
        *_parameter_figures(cases),
    ]


def reliability(pairs: Sequence[tuple[float, bool]]) -> list[Line]:
    """For each range of stated probabilities, the share of names that are true, beside the mean of what was stated."""
    lines = []
    for low, high in pairwise(_PROBABILITIES):
        own = [(stated, true) for stated, true in pairs if low <= stated < high]
        share = 100.0 * sum(true for _, true in own) / len(own) if own else math.nan
        stated = f"stated {100.0 * fmean(stated for stated, _ in own):.1f} %" if own else ""
        what = f"names of probability {low:g} to {min(high, 1.0):g} that are true"
        lines.append(Line(what, share, "%", len(own), stated, ""))
    return lines


def _all_right(case: Judgement) -> bool:
    return len(case.right) == len(case.truth)


def _all_listed(case: Judgement) -> bool:
    return len(case.listed) == len(case.truth)


def _flagged(case: Judgement) -> bool:
    return case.flagged


def _wrong(case: Judgement) -> bool:
    return bool(case.wrong)


def _after(case: Judgement) -> float:
    return case.after


def _share(what: str, cases: Sequence[Judgement], holds: Callable[[Judgement], bool], must: str, aim: str) -> Line:
    value = 100.0 * sum(map(holds, cases)) / len(cases) if cases else math.nan
    return Line(what, value, "%", len(cases), must, aim)


def _statistic(
    what: str,
    cases: Sequence[Judgement],
    quantity: Callable[[Judgement], float],
    summary: Callable[[list[float]], float],
    must: str,
    aim: str,
) -> Line:
    values = [value for value in map(quantity, cases) if math.isfinite(value)]
    return Line(what, summary(values) if values else math.nan, "", len(values), must, aim)


def _channels(what: str, cases: Sequence[Judgement], summary: Callable[[list[float]], float]) -> Line:
    values = [value for case in cases for value in case.channels]
    return Line(what, float(summary(values)) if values else math.nan, "", len(values), "", "")


def _parameter_figures(cases: Sequence[Judgement]) -> Iterable[Line]:
    targets = {effect: (unit, must, aim) for effects, unit, must, aim in _PARAMETERS for effect in effects}
    names = sorted({name for case in cases for name in case.errors})
    for name in names:
        unit, must, aim = targets.get(name, ("%", math.nan, math.nan))
        values = [case.errors[name] for case in cases if name in case.errors]
        wanted = ("", "") if math.isnan(must) else (f"<= {must:g}", f"<= {aim:g}")
        yield Line(f"parameter error, median: {name}", median(values), unit, len(values), *wanted)


def confusion(
    cases: Iterable[Judgement],
) -> tuple[list[str], list[str], IntArray]:
    """True effects, names given, and how often, ``(true, named)``, over cases of at most one hidden effect."""
    counts = Counter(
        (case.truth[0][0] if case.truth else NOTHING, _answer(case)) for case in cases if case.kind != "double"
    )
    rows = [effect for effect in (*LIBRARY, *OUTSIDE, NOTHING) if any(true == effect for true, _ in counts)]
    columns = [*LIBRARY, OTHER_JOINT, NOT_SURE, UNEXPLAINED, NOTHING]
    return rows, columns, np.array([[counts[row, column] for column in columns] for row in rows], dtype=np.int64)


def _answer(case: Judgement) -> str:
    """The first confident name that is wrong, else the right one, else what was said instead of a name."""
    confident = [(effect, joint) for effect, joint, confidence in case.named if confidence == "confident"]
    for effect, joint in [*case.wrong, *confident]:
        right_effect = effect in dict(case.truth)
        return OTHER_JOINT if right_effect and (effect, joint) not in case.truth else effect
    if case.verdict == "unexplained" or (case.flagged and not case.named):
        return UNEXPLAINED
    return NOT_SURE if case.named else NOTHING


def print_matrix(cases: Sequence[Judgement]) -> None:
    """The confusion matrix on the screen, its columns numbered."""
    rows, columns, counts = confusion(cases)
    print("true effect x named effect (confident names; columns below)")
    print(" " * 20 + "".join(f"{index:>4}" for index in range(1, len(columns) + 1)))
    for row, line in zip(rows, counts.tolist(), strict=True):
        print(f"{row:<20}" + "".join(f"{count or '.':>4}" for count in line))
    print("  ".join(f"{index} {name}" for index, name in enumerate(columns, 1)))


def draw_matrix(cases: Sequence[Judgement], path: Path) -> None:
    """The confusion matrix as a picture."""
    rows, columns, counts = confusion(cases)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure = Figure(figsize=(0.45 * len(columns) + 3.0, 0.4 * len(rows) + 2.5), layout="constrained")
    axes = figure.subplots()
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0)
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right")
    axes.set_yticks(range(len(rows)), rows)
    axes.set(xlabel="named, confidently", ylabel="hidden")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            color = "white" if shares[row, column] > 0.5 else "black"
            axes.text(column, row, str(count), ha="center", va="center", color=color)
    figure.savefig(path, dpi=130)
