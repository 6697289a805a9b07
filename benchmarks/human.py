"""(c) V-B, Table I and Fig. 5: a real person on a balance board, rows of Lee, Wensing & Park (T-RO 2020)."""

from __future__ import annotations

import numpy as np

from benchmarks.bodies import draw_bodies
from benchmarks.comparison import compare, show
from benchmarks.problem import Problem, Rows, measured
from benchmarks.report import Report
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.types import FloatArray

_FOLDER = "human_lee_balanceboard"
_TO_PINOCCHIO = [0, 1, 2, 3, 4, 7, 5, 9, 8, 6]  # from m, hx, hy, hz, Ixx, Iyy, Izz, Ixy, Iyz, Izx
_SHOWN = ("prior", "Euclidean + LMI", "constant pullback + LMI", "trust_region (19)", "residual (Remark 3)")


def human_problem() -> Problem:
    """Trained on the first two thirds of the instants."""
    data = _data()
    links = data["Phi_prior"].shape[1]
    count = len(data["A"])
    channels = 3
    rows = Rows(
        data["A"].reshape(count, links, 10)[:, :, _TO_PINOCCHIO].reshape(count, -1),
        data["b"].ravel(),
        np.tile(data["sigma"].ravel(), count // channels),
        np.tile(np.arange(channels), count // channels),
        np.repeat(np.arange(count // channels), channels),
    )
    train, validation = rows.until(2.0 / 3.0)
    manifold = ParameterManifold(links, 0, np.zeros(0))
    prior = data["Phi_prior"].T[:, _TO_PINOCCHIO].ravel()
    return Problem("human", ("Mx", "My", "Fz"), manifold, prior, train, validation)


def body_frames() -> FloatArray:
    """Poses ``(links, 4, 4)`` of the bodies' frames."""
    return np.moveaxis(_data()["T_sb"], 2, 0)


def _data() -> dict[str, FloatArray]:
    with np.load(measured(_FOLDER) / "human_lee_balanceboard.npz") as archive:
        return dict(archive)


def run(report: Report) -> None:
    """Table I with all methods, and Fig. 5."""
    problem = human_problem()
    outcomes = compare(problem, report)
    caption = (
        f"{len(problem.train)} rows to train on, {len(problem.validation)} later ones to judge by. RMS of Mx, My [N m] "
        "and Fz [N]. Weights: the paper's 1e-2, or chosen on five held-out blocks of the training rows. On boundary: "
        "links whose smallest eigenvalue relative to the prior is below 1e-3. To prior: mean geodesic distance of a "
        "link. MB: the process's peak over what it had before the fit, code that is loaded then included."
    )
    show(problem, outcomes, report, "(c) A real person, V-B and Table I", caption)
    shown = [(o.method, o.parameters) for name in _SHOWN for o in outcomes if o.method == name]
    report.picture("fig5_human", draw_bodies(problem, body_frames(), shown))


if __name__ == "__main__":
    run(Report())
