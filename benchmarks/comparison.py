"""All methods on one problem: the prior's weight chosen, the fit measured, the result judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.measuring import measure
from benchmarks.peers import METHODS, Fit, Method, NoSolutionError
from benchmarks.problem import Problem
from benchmarks.report import Report
from geomid_ros.geometry import spd
from geomid_ros.types import FloatArray

_FOLDS = 5  # blocks of the training time, each held out in turn
WEIGHTS = tuple(10.0 ** (-0.5 * k) for k in range(2, 17))
"""From a tenth of the rows' down, by half decades."""

_BOUNDARY = 1e-3


@dataclass(frozen=True, eq=False)
class Outcome:
    """A method's result on a problem.

    ``chosen``: whether the weight was found on held-out blocks. ``boundary``: links whose smallest eigenvalue relative
    to the prior is below 1e-3; those in which it is not above zero are ``impossible``. Distances are means over the
    links, infinite with an impossible one.
    """

    method: str
    weight: float
    chosen: bool
    seconds: float
    first_seconds: float
    peak: float
    growth: float
    train: FloatArray
    validation: FloatArray
    boundary: int
    impossible: int
    from_prior: float
    to_truth: float | None
    parameters: FloatArray

    def as_json(self) -> dict[str, Any]:
        """All but the parameters, in plain types."""
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "parameters"}
        return plain | {"train": self.train.tolist(), "validation": self.validation.tolist()}


def compare(problem: Problem, report: Report, methods: Sequence[Method] = METHODS) -> list[Outcome]:
    """Every method's outcome."""
    outcomes = []
    for method in methods:
        weight = method.weight
        if weight is None:
            report.progress(f"{problem.name}: {method.name}, choosing the prior's weight")
            weight = choose_weight(problem, method.fit)
        report.progress(f"{problem.name}: {method.name}")
        outcomes.append(_outcome(problem, method, weight))
    return outcomes


def choose_weight(problem: Problem, fit: Fit) -> float:
    """The weight whose fits predict blocks of the training time that they have not seen.

    The prior is weakened by half decades for as long as that predicts better, so that a fluke far beyond does not
    count; a parabola through the last three losses gives the rest. The loss is the logarithm of the mean squared error,
    averaged over channels and blocks, as the package's own choice; infinite where the method's solver gives up.
    """
    losses = [_held_out_loss(problem, fit, WEIGHTS[0])]
    for weight in WEIGHTS[1:]:
        losses.append(_held_out_loss(problem, fit, weight))
        if losses[-1] > losses[-2]:
            break
    best = int(np.argmin(losses))
    shift = 0.0
    if 0 < best < len(losses) - 1 and math.isfinite(losses[best + 1]):
        before, here, after = losses[best - 1 : best + 2]
        shift = 0.5 * (before - after) / (before - 2.0 * here + after)
    return WEIGHTS[best] * 10.0 ** (-0.5 * shift)


def _held_out_loss(problem: Problem, fit: Fit, weight: float) -> float:
    rows, losses = problem.train, []
    for block in np.array_split(np.unique(rows.instant), _FOLDS):
        held_out = np.isin(rows.instant, block)
        try:
            parameters = fit(problem.with_train(rows.select(~held_out)), weight)
        except NoSolutionError:
            return math.inf
        losses.append(2.0 * np.log(rows.select(held_out).rms(parameters)))
    return float(np.mean(losses))


def _outcome(problem: Problem, method: Method, weight: float) -> Outcome:
    found = measure(problem, method.name, weight)
    ratios = smallest_ratios(problem, found.parameters)
    truth = None if problem.truth is None else mean_distance(problem, problem.truth, found.parameters)
    return Outcome(
        method.name,
        weight,
        method.weight is None,
        found.seconds,
        found.first_seconds,
        found.peak,
        found.growth,
        problem.train.rms(found.parameters),
        problem.validation.rms(found.parameters),
        int(np.count_nonzero(ratios < _BOUNDARY)),
        int(np.count_nonzero(ratios <= 0.0)),
        mean_distance(problem, problem.prior, found.parameters),
        truth,
        found.parameters,
    )


def smallest_ratios(problem: Problem, parameters: FloatArray) -> FloatArray:
    """Per link the smallest eigenvalue of ``P0^-1/2 P P0^-1/2``, ``(links,)``."""
    found = problem.manifold.point(parameters).pseudo_inertias
    return spd.relative_eigenvalues(problem.prior_point.pseudo_inertias, found)[:, 0]


def mean_distance(problem: Problem, reference: FloatArray, parameters: FloatArray) -> float:
    """Mean over the links of the geodesic distance; infinite when a link is impossible."""
    if np.any(smallest_ratios(problem, parameters) <= 0.0):
        return math.inf
    return float(np.mean(link_distances(problem, reference, parameters)))


def link_distances(problem: Problem, reference: FloatArray, parameters: FloatArray) -> FloatArray:
    """Geodesic distance of every link, ``(links,)``."""
    here, there = (problem.manifold.point(p).pseudo_inertias for p in (reference, parameters))
    return spd.distance(here, there)


def show(problem: Problem, outcomes: Sequence[Outcome], report: Report, title: str, caption: str) -> None:
    """Print the outcomes as a table and keep them for the machine-readable result."""
    headings = ["", "prior's weight", "train RMS", "validation RMS", "on boundary", "to prior"]
    headings += [] if problem.truth is None else ["to truth"]
    rows = []
    for o in outcomes:
        numbers = [" ".join(f"{v:.3g}" for v in values) for values in (o.train, o.validation)]
        on_boundary = f"{o.boundary} of {problem.manifold.links}"
        on_boundary += f", {o.impossible} impossible" if o.impossible else ""
        weight = "" if o.method == "prior" else f"{o.weight:.1e}" + (" chosen" if o.chosen else "")
        distances = [o.from_prior] + ([] if o.to_truth is None else [o.to_truth])
        costs = ["", ""] if o.method == "prior" else [f"{o.seconds:.3g}", f"{o.growth:.0f}"]
        rows.append([o.method, weight, *numbers, on_boundary, *(f"{d:.4f}" for d in distances), *costs])
    report.table(title, [*headings, "seconds", "MB"], rows, caption)
    report.result(problem.name, [o.as_json() for o in outcomes])
