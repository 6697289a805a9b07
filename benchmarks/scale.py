"""How time and memory grow with rows and with links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.measuring import best_of, exponent, in_fresh_process, resident
from benchmarks.peers import method
from benchmarks.problem import Problem, Rows
from benchmarks.report import Report
from benchmarks.simulated_person import simulated_person
from geomid_ros.estimation.rows import PAPER

_METHODS = ("trust_region (19)", "trust_region (19), rows compressed", "residual (Remark 3)")
_INSTANTS = (1_000, 10_000, 100_000)  # three rows each
_PEOPLE = (1, 2, 4)  # of 16 links each
_REPEATS, _ENOUGH = 3, 5.0
_WARM_UP = 300  # rows that make the compiled code load


@dataclass(frozen=True)
class _Cost:
    """``seconds`` of a fit and the ``growth`` of memory during it [MB]."""

    method: str
    rows: int
    links: int
    seconds: float
    growth: float


def run(report: Report) -> None:
    """Two tables and a picture: rows at 16 links, links at 3,000 rows."""
    by_rows = _costs(report, [(instants, 1) for instants in _INSTANTS])
    by_links = _costs(report, [(_INSTANTS[0], people) for people in _PEOPLE])
    _table(report, "Scale: rows, at 16 links", by_rows, "rows", lambda cost: cost.rows)
    _table(report, "Scale: links, at 3,000 rows", by_links, "links", lambda cost: cost.links)
    report.picture("scale", _draw(by_rows, by_links))
    report.result("scale", {"rows": [asdict(c) for c in by_rows], "links": [asdict(c) for c in by_links]})


def _costs(report: Report, sizes: Sequence[tuple[int, int]]) -> list[_Cost]:
    costs = []
    for instants, people in sizes:
        report.progress(f"scale: {3 * instants} rows, {people} x 16 links")
        costs += [in_fresh_process(_measure, name, instants, people) for name in _METHODS]
    return costs


def _measure(name: str, instants: int, people: int) -> _Cost:
    problem = crowd(simulated_person(instants, held_out=1), people)
    fit = method(name).fit
    fit(problem.with_train(problem.train.select(np.arange(_WARM_UP))), PAPER)
    before = resident("VmRSS")
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak so far is forgotten
    fit(problem, PAPER)
    growth = resident("VmHWM") - before
    seconds = best_of(lambda: fit(problem, PAPER), _REPEATS, _ENOUGH)
    return _Cost(name, len(problem.train), problem.manifold.links, seconds, growth)


def crowd(person: Problem, people: int) -> Problem:
    """So many people on one plate, which measures the sum of their loads: each moves as ``person`` does, but later."""
    rows = person.train
    later = [np.roll(np.arange(len(rows)), len(rows) // people // 3 * 3 * k) for k in range(people)]
    together = Rows(
        np.hstack([rows.coefficients[order] for order in later]),
        np.sum([rows.targets[order] for order in later], axis=0),
        np.sqrt(people) * rows.sigmas,
        rows.channel,
        rows.instant,
    )
    manifold = replace(person.manifold, links=people * person.manifold.links)
    return replace(person, manifold=manifold, prior=np.tile(person.prior, people), train=together, truth=None)


def _table(report: Report, title: str, costs: list[_Cost], what: str, size: Callable[[_Cost], int]) -> None:
    sizes = sorted({size(cost) for cost in costs})
    headings = ["", *(f"{n:,} {what}: s, MB" for n in sizes), "exponents: time, memory"]
    lines = []
    for name in _METHODS:
        own = [cost for cost in costs if cost.method == name]
        shown = [f"{cost.seconds:.3g}, {cost.growth:.0f}" for cost in own]
        exponents = [exponent([size(c) for c in own], [getattr(c, of) for c in own]) for of in ("seconds", "growth")]
        lines.append([name, *shown, ", ".join(f"{e:.2f}" for e in exponents)])
    caption = (
        "Memory: what a fit adds to the process that holds the rows. Exponents: of the least-squares power law. "
        "gamma 1e-2. Time of the compressed ones includes the compression."
    )
    report.table(title, headings, lines, caption)


def _draw(by_rows: list[_Cost], by_links: list[_Cost]) -> Figure:
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharey="row")
    for column, (costs, what) in enumerate(((by_rows, "rows"), (by_links, "links"))):
        for row, (of, unit) in enumerate((("seconds", "time [s]"), ("growth", "memory [MB]"))):
            _panel(panels[row, column], costs, what, of)
            panels[row, column].set(xlabel=what, ylabel=unit)
    panels[0, 0].set_title("3,000 to 300,000 rows, 16 links")
    panels[0, 1].set_title("3,000 rows, 16 to 64 links")
    return figure


def _panel(panel: Axes, costs: list[_Cost], what: str, of: str) -> None:
    for name in _METHODS:
        own = [cost for cost in costs if cost.method == name]
        sizes, values = [getattr(c, what) for c in own], [getattr(c, of) for c in own]
        panel.loglog(sizes, values, "o-", label=f"{name}: exponent {exponent(sizes, values):.2f}")
    panel.grid(which="both", alpha=0.2)
    panel.legend(fontsize=8)
