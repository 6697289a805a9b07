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
from benchmarks.problem import Problem
from benchmarks.report import Report
from benchmarks.simulated_person import simulated_person
from geomid_ros.estimation.paper_estimator import PAPER
from geomid_ros.geometry.pseudo_inertia import SIZE

_METHODS = ("trust_region (19)", "trust_region (19), rows compressed", "residual (Remark 3)")
_INSTANTS = (334, 3_334, 33_334, 333_334)  # three rows each
_FEW, _LINKS = 1_000, (7, 16, 32, 64)  # instants at which so many links are compared; a person has 16
_REPEATS, _ENOUGH = 3, 5.0
_WARM_UP = 300  # rows that make the compiled code load
_LEAST = {"seconds": 0.0, "growth": 1.0}  # [s], [MB] that can be told from nothing


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
    by_rows = _costs(report, [(instants, 16) for instants in _INSTANTS])
    by_links = _costs(report, [(_FEW, links) for links in _LINKS])
    _table(report, "Scale: rows, at 16 links", by_rows, "rows", lambda cost: cost.rows)
    _table(report, "Scale: links, at 3,000 rows", by_links, "links", lambda cost: cost.links)
    report.picture("scale", _draw(by_rows, by_links))
    report.result("scale", {"rows": [asdict(c) for c in by_rows], "links": [asdict(c) for c in by_links]})


def _costs(report: Report, sizes: Sequence[tuple[int, int]]) -> list[_Cost]:
    costs = []
    for instants, links in sizes:
        report.progress(f"scale: {3 * instants} rows, {links} links")
        costs += [in_fresh_process(_measure, name, instants, links) for name in _METHODS]
    return costs


def _measure(name: str, instants: int, links: int) -> _Cost:
    problem = of_links(simulated_person(instants, held_out=1), links)
    fit = method(name).fit
    fit(problem.with_train(problem.train.select(np.arange(_WARM_UP))), PAPER)
    before = resident("VmRSS")
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak so far is forgotten
    fit(problem, PAPER)
    growth = resident("VmHWM") - before
    seconds = best_of(lambda: fit(problem, PAPER), _REPEATS, _ENOUGH)
    return _Cost(name, len(problem.train), problem.manifold.links, seconds, growth)


def of_links(person: Problem, links: int) -> Problem:
    """The problem with fewer links, or with those of several people.

    Of fewer, the first are unknown, and of the others the plate's loads are known. Several people stand on one plate,
    which measures the sum of their loads: each moves as ``person`` does, but later. Rows and priors only: no truth.

    Raises:
        ValueError: More links that are no multiple of a person's.
    """
    own = person.manifold.links
    if links < own:
        return _in_part(person, links)
    if links % own:
        raise ValueError(f"{links} links are no multiple of the {own} of a person")
    return _crowd(person, links // own)


def _in_part(person: Problem, links: int) -> Problem:
    if person.truth is None:
        raise ValueError(f"{person.name}: only of a known truth are some links' loads known")
    rows, columns = person.train, links * SIZE
    loads = rows.targets - rows.coefficients[:, columns:] @ person.truth[columns:]
    part = replace(rows, coefficients=np.ascontiguousarray(rows.coefficients[:, :columns]), targets=loads)
    manifold = replace(person.manifold, links=links)
    return replace(person, manifold=manifold, prior=person.prior[:columns], train=part, truth=None)


def _crowd(person: Problem, people: int) -> Problem:
    rows = person.train
    later = [np.roll(np.arange(len(rows)), len(rows) // people // 3 * 3 * k) for k in range(people)]
    together = replace(
        rows,
        coefficients=np.hstack([rows.coefficients[order] for order in later]),
        targets=np.sum([rows.targets[order] for order in later], axis=0),
        sigmas=np.sqrt(people) * rows.sigmas,
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
        exponents = [exponent([size(cost) for cost in own], _told(own, of)) for of in ("seconds", "growth")]
        lines.append([name, *shown, ", ".join(f"{e:.2f}" for e in exponents)])
    caption = (
        "Memory: what a fit adds to the process that holds the rows. Exponents: of the least-squares power law, in "
        "which less than 1 MB counts as that. "
        "gamma 1e-2. Time of the compressed ones includes the compression."
    )
    report.table(title, headings, lines, caption)


def _told(costs: list[_Cost], of: str) -> list[float]:
    """Times or growths of memory, as far as they can be told from nothing."""
    return [max(getattr(cost, of), _LEAST[of]) for cost in costs]


def _draw(by_rows: list[_Cost], by_links: list[_Cost]) -> Figure:
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharey="row")
    for column, (costs, what) in enumerate(((by_rows, "rows"), (by_links, "links"))):
        for row, (of, unit) in enumerate((("seconds", "time [s]"), ("growth", "memory [MB]"))):
            _panel(panels[row, column], costs, what, of)
            panels[row, column].set(xlabel=what, ylabel=unit)
    panels[0, 0].set_title("rows, at 16 links")
    panels[0, 1].set_title("links, at 3,000 rows")
    return figure


def _panel(panel: Axes, costs: list[_Cost], what: str, of: str) -> None:
    for name in _METHODS:
        own = [cost for cost in costs if cost.method == name]
        sizes, values = [getattr(c, what) for c in own], _told(own, of)
        panel.loglog(sizes, values, "o-", label=f"{name}: exponent {exponent(sizes, values):.2f}")
    panel.grid(which="both", alpha=0.2)
    panel.legend(fontsize=8)


if __name__ == "__main__":
    run(Report())
