"""Honest uncertainty: how often the intervals hold the truth, what `from_data` says, and the choice of gamma."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from benchmarks.report import Report
from benchmarks.simulated_arm import FRESH, MOTIONS, Arm, Run, arm, identified, noise, truth
from geomid_ros.estimation.estimate import QUANTITIES, Estimate
from geomid_ros.estimation.paper_estimator import PAPER
from geomid_ros.geometry.pseudo_inertia import quantities_of
from geomid_ros.types import FloatArray

FIRST_SEED = 1000
RUNS = 200  # of each kind of noise; half of them with priors of uneven quality
COMPARED = 30  # of each kind of noise, for gamma
LEVEL = 0.95
EXCITED = 0.75  # the data took away so much of the prior's variance: half of the standard deviation
_GROUPS = {"mass": slice(0, 1), "centre of mass": slice(1, 4), "inertia": slice(4, 10)}
_NOISES = {"white": False, "correlated": True}
_DURATIONS = (7.5, 30.0, 120.0)
_RESTING = 3
_PROCESSES = 2


@dataclass(frozen=True)
class Interval:
    """One interval of one run: the error in standard deviations, of a quantity of a ``group`` that was ``excited`` by
    its own estimate's saying."""

    run: Run
    group: str
    excited: bool
    error: float


def run(report: Report) -> None:
    """Tables of coverage, of from_data and of gamma; the picture of calibration."""
    runs = [
        Run(seed, correlated, seed % 2 == 1)
        for correlated in _NOISES.values()
        for seed in range(FIRST_SEED, FIRST_SEED + RUNS)
    ]
    report.progress(f"coverage: {len(runs)} simulated recordings of a seven-joint arm")
    intervals: list[Interval] = []
    with ProcessPoolExecutor(_PROCESSES, mp_context=get_context("spawn")) as pool:
        for found in pool.map(intervals_of_run, runs, chunksize=10):
            intervals += found
    _report_coverage(report, intervals)
    _draw_calibration(report, intervals)
    _report_from_data(report)
    _report_gamma(report)


def intervals_of_run(run: Run) -> list[Interval]:
    """All intervals of a run."""
    where, true, targets = _recorded(run)
    return intervals_of(where, identified(where, targets), true, run)


def _recorded(run: Run) -> tuple[Arm, FloatArray, FloatArray]:
    where = arm(run.seed // 2 % MOTIONS)
    true = truth(where, run)
    return where, true, where.coefficients @ true + noise(where, run)


def intervals_of(where: Arm, found: Estimate, true: FloatArray, run: Run) -> list[Interval]:
    """An estimate's intervals against the true parameters ``(D,)``."""
    first = len(where.model.nominal_inertias)
    expected = quantities_of(true[:first].reshape(-1, 10))
    intervals = []
    for link, values in zip(found.links, expected, strict=True):
        errors = (link.quantities - values) / link.std
        told = [quantity not in link.cannot_tell for quantity in QUANTITIES]
        for group, place in _GROUPS.items():
            pairs = zip(told[place], errors[place], strict=True)
            intervals += [Interval(run, group, excited, float(error)) for excited, error in pairs]
    for effect, value in zip(found.effects, true[first:], strict=True):
        error = (effect.value - float(value)) / effect.std
        intervals.append(Interval(run, effect.name, effect.from_data > EXCITED, error))
    return intervals


def coverage(intervals: Iterable[Interval], level: float = LEVEL) -> tuple[float, float, int]:
    """Share of the intervals at ``level`` that hold the truth, its standard error, and how many there are.

    Intervals of one run depend on each other: the standard error is that of a ratio of sums over runs.
    """
    bound = norm.ppf(0.5 + 0.5 * level)
    hits: dict[Run, list[bool]] = defaultdict(list)
    for interval in intervals:
        hits[interval.run].append(abs(interval.error) < bound)
    count = sum(map(len, hits.values()))
    if not count:
        return np.nan, np.nan, 0
    share = sum(map(sum, hits.values())) / count
    excess = [sum(each) - share * len(each) for each in hits.values()]
    return share, float(np.linalg.norm(excess)) / count, count


def _is_of(group: str, interval: Interval) -> bool:
    return interval.group == group


def _report_coverage(report: Report, intervals: Sequence[Interval]) -> None:
    groups = list(dict.fromkeys(interval.group for interval in intervals))
    selections: dict[str, Callable[[Interval], bool]] = {
        **{group: partial(_is_of, group) for group in groups},
        "links": lambda i: i.group in _GROUPS,
        "effects": lambda i: i.group not in _GROUPS,
        "all": lambda _: True,
        "all, priors equally good": lambda i: not i.run.uneven,
        "all, priors of uneven quality": lambda i: i.run.uneven,
    }
    rows, results = [], {}
    for name, chosen in selections.items():
        cells = []
        for noise_name, correlated in _NOISES.items():
            for excited in (True, False):
                part = [i for i in intervals if chosen(i) and i.run.correlated == correlated and i.excited == excited]
                share, error, count = coverage(part)
                cells.append(f"{100 * share:.1f} ± {100 * error:.1f} of {count}" if count else "")
                results[f"{name}, {noise_name}, {'excited' if excited else 'not excited'}"] = (share, error, count)
        rows.append([name, *cells])
    headings = ["", *(f"{name}: {what}" for name in _NOISES for what in ("excited", "not excited"))]
    caption = (
        f"Percent of {100 * LEVEL:.0f} % intervals that hold the truth, {RUNS} runs of each kind of noise, ± one "
        "standard error over runs. Excited: its standard deviation is at most half of the prior's, by its own account."
    )
    report.table("Coverage", headings, rows, caption)
    report.result("coverage", results)


def _draw_calibration(report: Report, intervals: Sequence[Interval]) -> None:
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    levels = np.linspace(0.05, 0.99, 40)
    for axes, (name, correlated) in zip(figure.subplots(1, 2, sharey=True), _NOISES.items(), strict=True):
        axes.plot([0, 100], [0, 100], color="0.7", lw=1.0)
        for group in dict.fromkeys(interval.group for interval in intervals):
            part = [i for i in intervals if i.group == group and i.excited and i.run.correlated == correlated]
            actual = [coverage(part, level)[0] for level in levels]
            axes.plot(100 * levels, 100 * np.array(actual), label=f"{group.replace('_', ' ')} ({len(part)})", lw=1.2)
        axes.set(title=f"{name} noise", xlabel="claimed [%]", aspect="equal")
        axes.legend(fontsize=7, frameon=False)
    figure.axes[0].set_ylabel("intervals that hold the truth [%]")
    report.picture("coverage", figure)


def _report_from_data(report: Report) -> None:
    """With more of the same: what the motion shows goes to 1, what it cannot show stays at 0."""
    rows = []
    for seconds in _DURATIONS:
        where = arm(0, seconds, _RESTING)
        one = Run(FIRST_SEED, False, False)
        found = identified(where, where.coefficients @ truth(where, one) + noise(where, one))
        resting = where.model.robot.joint_names[_RESTING]
        still = [e.from_data for e in found.effects if e.joint == resting and e.name != "effort_offset"]
        moving = [e.from_data for e in found.effects if e.joint != resting]
        first, *_, last = found.links
        rows.append(
            [f"{seconds:g} s", *(f"{v:.3f}" for v in (min(moving), max(still), first.from_data, last.from_data))]
        )
    headings = ["", "moving joints' effects: least", "resting joint's: most", "first link", "last link"]
    report.table("from_data, one joint at rest", headings, rows, "Inertias that joint torques cannot show stay at 0.")
    report.result("from_data", rows)


def _report_gamma(report: Report) -> None:
    rows = []
    for name, correlated in _NOISES.items():
        found: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
        chosen: list[float] = []
        for seed in range(FIRST_SEED, FIRST_SEED + COMPARED):
            one = Run(seed, correlated, False)
            where, true, targets = _recorded(one)
            for label, gamma in (("held-out blocks", None), ("paper, 1e-2", PAPER)):
                solved = identified(where, targets, gamma)
                found[label].append(_errors(where, solved, true, one))
                chosen += [solved.gamma] if gamma is None else []
        for label, errors in found.items():
            rows.append([f"{name}: {label}", *(f"{value:.4f}" for value in np.mean(errors, axis=0))])
        rows[-2].append(f"{np.median(chosen):.0e}")
    headings = ["", "links to truth", "effects", "held-out RMS / noise", "median gamma"]
    caption = (
        f"Means over {COMPARED} runs. Links: geodesic distance per link, most of it where no torque can tell. Effects: "
        "mean relative error. Held-out RMS: on another motion with noise of its own; 1 is the best there is."
    )
    report.table("gamma", headings, rows, caption)
    report.result("gamma", rows)


def _errors(where: Arm, found: Estimate, true: FloatArray, run: Run) -> tuple[float, float, float]:
    model = where.model
    manifold = model.manifold(np.ones(len(model.coefficients) - model.positives))
    away = manifold.log(manifold.point(found.parameters), manifold.point(true))
    effects = np.abs(found.parameters / true - 1.0)[manifold.inertial.stop :]
    fresh = arm(FRESH)
    residuals = fresh.coefficients @ (found.parameters - true) - noise(
        fresh, Run(run.seed + RUNS, run.correlated, False)
    )
    links = np.linalg.norm(away[manifold.inertial].reshape(-1, 10), axis=1)
    return float(np.mean(links)), float(np.mean(effects)), float(np.sqrt(np.mean((residuals / fresh.noise) ** 2)))


if __name__ == "__main__":
    run(Report())
