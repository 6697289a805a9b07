"""(e) A real arm: UR10, efforts from motor currents, so that friction and rotor inertia are unknowns too."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.comparison import Outcome, compare, show
from benchmarks.problem import Problem, Rows, measured
from benchmarks.report import Report
from geomid_ros.estimation.starting_point import prior_parameters, scales_of_coefficients
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.session.session import Session

_FOLDER = "ur10_unisa_rosbag2"
_TRAINING = 0.7  # of the time
_SHOWN = ("prior", "Euclidean + LMI", "entropic", "trust_region (19)", "residual (Remark 3)")


def measured_arm() -> Problem:
    """Rows, prior and standard deviations of the package's own session, trained on the first part of the recording."""
    folder = measured(_FOLDER)
    session = Session(read_urdf(folder / "ur10.urdf"), Configuration(), "ur10.urdf")
    with Bag(folder / "ur10_exciting_trajectory") as bag:
        topics = Topics("joint_states", "odom")
        samples = Samples.concatenate(list(read_samples(bag, session, session.new_pipeline(), topics)))
    training = round(_TRAINING * len(samples))
    session.identifier.add(samples.select(slice(training)))
    summary = session.identifier.snapshot()
    sigmas = session.identifier.solve().sigmas
    model = session.model
    rows = model.rows(samples)
    count = len(model.channels)
    everything = Rows(
        rows.coefficients.reshape(-1, model.dimension),
        rows.targets.ravel(),
        np.tile(sigmas, len(samples)),
        np.tile(np.arange(count), len(samples)),
        np.repeat(np.arange(len(samples)), count),
    )
    manifold = model.manifold(scales_of_coefficients(model, summary)[model.positives :])
    return Problem(
        "arm",
        tuple(channel.name.removesuffix("_joint") for channel in model.channels),
        manifold,
        prior_parameters(model, summary, None),
        everything.select(everything.instant < training),
        everything.select(everything.instant >= training),
    )


def run(report: Report) -> None:
    """The table with all methods and a picture of the held-out errors."""
    problem = measured_arm()
    outcomes = compare(problem, report)
    caption = (
        f"{len(problem.train)} rows to train on, {len(problem.validation)} later ones to judge by. "
        f"RMS [N m] of {', '.join(problem.channels)}. The prior: the URDF's inertias, with friction, rotor inertia and "
        "offsets fitted to what they leave. Standard deviations: those that `geomid identify` uses. The rest as in (c)."
    )
    show(problem, outcomes, report, "(e) A real arm, UR10", caption)
    report.picture("arm_held_out", _draw(problem, outcomes))


def _draw(problem: Problem, outcomes: list[Outcome]) -> Figure:
    """Held-out errors of every joint over the prior's."""
    shown = [o for name in _SHOWN for o in outcomes if o.method == name]
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panel = figure.subplots()
    width = 0.8 / len(shown)
    places = np.arange(len(problem.channels))
    for index, outcome in enumerate(shown):
        ratios = outcome.validation / shown[0].validation
        panel.bar(places + (index + 0.5) * width - 0.4, ratios, width, label=outcome.method)
    panel.set_xticks(places, problem.channels)
    panel.set_ylabel("held-out RMS / prior's")
    panel.grid(axis="y", alpha=0.3)
    panel.legend(ncols=len(shown), fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 1.16))
    return figure


if __name__ == "__main__":
    run(Report())
