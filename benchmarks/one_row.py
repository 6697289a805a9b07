"""(b) V-A and Fig. 4: the prior of a real person projected on one measured row, in either metric."""

from __future__ import annotations

import cvxpy
import numpy as np

from benchmarks.bodies import draw_bodies
from benchmarks.comparison import smallest_ratios
from benchmarks.human import body_frames, human_problem
from benchmarks.peers import possible
from benchmarks.problem import Problem
from benchmarks.report import Report
from geomid_ros.geometry import projection, pseudo_inertia
from geomid_ros.types import FloatArray

_CHANNEL = 0  # Mx, as in the paper
_COLLAPSED = 1e-2  # an axis shorter than this share of the prior's
_SEED = 0


def run(report: Report) -> None:
    """A random row in detail, and the same counts over all rows of its channel."""
    problem = human_problem()
    of_channel = np.flatnonzero(problem.train.channel == _CHANNEL)
    chosen = int(np.random.default_rng(_SEED).choice(of_channel))
    report.progress(f"one row: {len(of_channel)} projections in both metrics")
    natural = {int(row): _natural(problem, row) for row in of_channel}
    euclidean = {int(row): _euclidean(problem, row) for row in of_channel}
    results = {"natural": natural, "Euclidean + LMI": euclidean}
    rows = [_summary(problem, name, found, chosen) for name, found in results.items()]
    headings = ["projection", "axes collapsed", "links on boundary", "mass ratios, least and most"]
    headings += [f"all {len(of_channel)} rows: axes collapsed, mean and most"]
    caption = (
        f"Row {chosen} (Mx): measured {problem.train.targets[chosen]:.2f} N m, by the prior "
        f"{problem.train.coefficients[chosen] @ problem.prior:.2f} N m. Collapsed: shorter than 1 % of the prior's. "
        f"There are {3 * problem.manifold.links} axes of equivalent ellipsoids."
    )
    report.table("(b) The prior projected on one row, V-A and Fig. 4", headings, rows, caption)
    shown = [("prior", problem.prior), *((name, found[chosen]) for name, found in results.items())]
    report.picture("fig4_one_row", draw_bodies(problem, body_frames(), shown))
    counts = {name: [_collapsed(problem, p) for p in found.values()] for name, found in results.items()}
    report.result("one_row", {"row": chosen, "collapsed_axes_of_every_row": counts})


def _natural(problem: Problem, row: int) -> FloatArray:
    """Proposition 2."""
    prior = problem.prior_point
    normal = problem.manifold.whiten(prior, problem.train.coefficients[row : row + 1])
    found = projection.project(problem.manifold, prior, normal, problem.train.targets[row : row + 1])
    return problem.manifold.exp(prior, found.tangent[0]).parameters


def _euclidean(problem: Problem, row: int) -> FloatArray:
    """The nearest parameters on the hyperplane that belong to bodies, by Clarabel."""
    unknown = cvxpy.Variable(problem.manifold.dimension)
    coefficients = problem.train.coefficients[row]
    size = np.linalg.norm(coefficients)
    on_plane = (coefficients / size) @ unknown == problem.train.targets[row] / size
    constraints = [on_plane, *possible(problem.manifold, unknown)]
    cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(unknown - problem.prior)), constraints).solve(solver="CLARABEL")
    return np.asarray(unknown.value)


def _summary(problem: Problem, name: str, found: dict[int, FloatArray], chosen: int) -> list[str]:
    parameters = found[chosen]
    ratios = parameters[::10] / problem.prior[::10]
    boundary = np.count_nonzero(smallest_ratios(problem, parameters) < 1e-3)
    counts = [_collapsed(problem, p) for p in found.values()]
    every = f"{np.mean(counts):.1f}, {np.max(counts)}"
    return [name, str(_collapsed(problem, parameters)), str(boundary), f"{ratios.min():.2f}, {ratios.max():.2f}", every]


def _collapsed(problem: Problem, parameters: FloatArray) -> int:
    """How many of the links' axes are shorter than a small share of the prior's, longest compared with longest."""
    axes, _ = pseudo_inertia.equivalent_ellipsoid(parameters.reshape(-1, 10))
    expected, _ = pseudo_inertia.equivalent_ellipsoid(problem.prior.reshape(-1, 10))
    return int(np.count_nonzero(~(axes > _COLLAPSED * expected)))


if __name__ == "__main__":
    run(Report())
