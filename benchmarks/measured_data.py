"""Held-out errors on measured robots: the URDF, friction alone, plain least squares and geomid, on the same rows.

Reads the recordings in ../shared/data, which are not part of this repository:

    python benchmarks/measured_data.py [ROBOT ...]
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.starting_point import prior_parameters
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

DATA = Path(__file__).parents[2] / "shared" / "data"


@dataclass(frozen=True)
class Case:
    """A robot's recordings: what to train on, what to test on (the last part of the first bag, or another bag)."""

    urdf: str
    train: str
    validate: str = ""
    hold_out: float = 0.0
    configuration: dict[str, Any] = field(default_factory=dict)


_PLATE = {
    "floating_base": True,
    "wrenches": ["plate"],
    "wrench.plate.topic": "/wrench",
    "wrench.plate.frame": "odom",
    "wrench.plate.role": "external",
}
CASES = {
    "UR10": Case("ur10_unisa_rosbag2/ur10.urdf", "ur10_unisa_rosbag2/ur10_exciting_trajectory", hold_out=0.3),
    "AIRBOT": Case("airbot_play/airbot_play.urdf", "airbot_play/chirp", "airbot_play/trapez"),
    "LWR4+": Case("kuka_lwr4_hw/kuka_lwr4.urdf", "kuka_lwr4_hw/measurements_1", "kuka_lwr4_hw/measurements_2"),
    "human": Case(
        "human_forceplate/human_94kg.urdf",
        "human_forceplate/first_60s",
        hold_out=0.25,
        configuration={**_PLATE, "filter.cutoff": 3.0},
    ),
}


@dataclass(frozen=True, eq=False)
class Comparison:
    """RMS on held-out data by method, ``(channels,)`` each; how many links are possible bodies; geomid's estimate."""

    channels: tuple[str, ...]
    errors: dict[str, FloatArray]
    possible: dict[str, int]
    estimate: Estimate


def compare(case: Case) -> Comparison:
    """Fit every method to the same rows and try it on the same held-out samples."""
    session = Session(read_urdf(DATA / case.urdf), Configuration(case.configuration), case.urdf)
    train, test = _split(session, case)
    session.identifier.add(train)
    estimate = session.identifier.solve()
    solutions = {
        "URDF": session.nominal_parameters,
        "effects alone": prior_parameters(session.model, session.identifier.snapshot(), None),
        "least squares": _least_squares(session, train),
        "geomid": np.asarray(estimate.parameters),
    }
    return Comparison(
        tuple(channel.name for channel in session.model.channels),
        {method: session.rms([test], parameters) for method, parameters in solutions.items()},
        {method: _possible(session, parameters) for method, parameters in solutions.items()},
        estimate,
    )


def main() -> None:
    """Print one table per robot."""
    if not DATA.is_dir():
        sys.exit(f"the measured recordings are not there: {DATA}")
    for name in sys.argv[1:] or CASES:
        _report(name, compare(CASES[name]))


def _report(name: str, found: Comparison) -> None:
    table = Table(title=f"{name}: RMS on held-out data", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("", *found.channels, "total", "possible links"):
        table.add_column(heading, justify="right", no_wrap=True)
    for method, rms in found.errors.items():
        possible = f"{found.possible[method]} of {len(found.estimate.links)}"
        table.add_row(method, *(f"{value:.3g}" for value in rms), f"{np.sum(rms):.4g}", possible)
    ratio = found.errors["geomid"] / found.errors["least squares"]
    table.add_row("geomid / least squares", *(f"{value:.2f}" for value in ratio), "", "")
    Console(width=160).print(table)
    estimate = found.estimate
    smallest = min(link.min_eigenvalue_ratio for link in estimate.links)
    masses = ", ".join(f"{link.mass:.3g}" for link in estimate.links)
    print(f"gamma {estimate.gamma:.1e}, smallest min_eigenvalue_ratio {smallest:.4f}, {estimate.seconds:.1f} s")
    print(f"masses [kg]: {masses}\n")


def _split(session: Session, case: Case) -> tuple[Samples, Samples]:
    train = _samples(session, case.train)
    if case.validate:
        return train, _samples(session, case.validate)
    first, last = int(train.stamps[0]), int(train.stamps[-1])
    early = train.stamps < last + 1 - round(case.hold_out * (last + 1 - first))
    return train.select(early), train.select(~early)


def _samples(session: Session, name: str) -> Samples:
    topics = Topics("joint_states", "odom")
    with Bag(DATA / name) as bag:
        return Samples.concatenate(list(read_samples(bag, session, session.new_pipeline(), topics)))


def _least_squares(session: Session, train: Samples) -> FloatArray:
    rows = session.model.rows(train)
    measured = np.isfinite(rows.targets)
    solution: FloatArray = np.linalg.lstsq(rows.coefficients[measured], rows.targets[measured], rcond=1e-3)[0]
    return solution


def _possible(session: Session, parameters: FloatArray) -> int:
    count = len(session.model.body_names)
    bodies = pseudo_inertia.from_parameters(np.asarray(parameters)[: 10 * count].reshape(count, 10))
    return int(np.count_nonzero(np.linalg.eigvalsh(bodies)[:, 0] > 0.0))


if __name__ == "__main__":
    main()
