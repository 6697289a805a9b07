"""A solve that begins where the last one ended, beside one from the beginning: UR10, ten new instants each time."""

from __future__ import annotations

import time

from benchmarks.problem import measured
from benchmarks.report import Report
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.session.session import Session

_FIRST, _NEW, _UPDATES = 0.7, 10, 20


def run(report: Report) -> None:
    """Processor time of both, and their ratio."""
    folder = measured("ur10_unisa_rosbag2")
    session = Session(read_urdf(folder / "ur10.urdf"), Configuration(), "ur10.urdf")
    with Bag(folder / "ur10_exciting_trajectory") as bag:
        topics = Topics("joint_states", "odom")
        samples = Samples.concatenate(list(read_samples(bag, session, session.new_pipeline(), topics)))
    identifier, begin = session.identifier, round(_FIRST * len(samples))
    identifier.add(samples.select(slice(begin)))
    found = identifier.solve()
    cold = warm = float("inf")
    for update in range(_UPDATES):
        report.progress(f"warm: update {update + 1} of {_UPDATES}")
        identifier.add(samples.select(slice(begin + _NEW * update, begin + _NEW * (update + 1))))
        start = time.process_time()
        found = identifier.solve(WarmStart(found.parameters, spreads=found.prior_stds))
        between = time.process_time()
        identifier.solve()
        warm, cold = min(warm, between - start), min(cold, time.process_time() - between)
    rows = [["warm update", f"{1e3 * warm:.1f}", f"{1e3 * cold:.1f}", f"1/{cold / warm:.3g}", "10 ms", "5 ms"]]
    caption = f"Processor time, best of {_UPDATES} updates by {_NEW} instants, in turns with solves from the beginning."
    report.table("Warm update, UR10", ["", "ms", "from the beginning [ms]", "ratio", "must be", "aim"], rows, caption)
    report.result("warm", {"warm": warm, "cold": cold})


if __name__ == "__main__":
    run(Report())
