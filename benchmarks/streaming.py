"""A million rows through the bounded buffer, beside a batch solve of all of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.measuring import in_fresh_process, resident
from benchmarks.report import Report
from geomid_ros.estimation.estimator import EstimatorSettings
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.estimation.objective import ResidualObjective
from geomid_ros.estimation.paper_estimator import PAPER
from geomid_ros.estimation.solvers import trust_region
from geomid_ros.estimation.starting_point import (
    DEFAULT_PRIOR_STD,
    default_prior_stds,
    prior_parameters,
    scales_of_coefficients,
)
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_URDF = Path(__file__).parents[1] / "bags" / "arm7.urdf"
_FEW, _MANY = 10_000, 1_000_000
_AT_ONCE = 100  # instants
_RATE = 40.0  # Hz
_TONES = 5
_NOISE = 0.2  # N m
# Given, so that all rows of a channel weigh the same.
_SETTINGS = EstimatorSettings(gamma=PAPER, sigma={f"joint{number}": _NOISE for number in range(1, 8)})


@dataclass(frozen=True, eq=False)
class _Stream:
    """What streaming so many ``rows`` took: ``seconds``, the process's ``peak`` of memory [MB], ``buffered`` [MB] in
    the buffer itself; and the ``parameters (D,)`` found."""

    rows: int
    seconds: float
    peak: float
    buffered: float
    parameters: FloatArray


def run(report: Report) -> None:
    """Memory, speed, and how far the minimisers are apart."""
    report.progress(f"streaming: {_FEW} and {_MANY} rows")
    few, many = (in_fresh_process(_stream, count) for count in (_FEW, _MANY))
    report.progress("streaming: all rows at once")
    apart, batch_peak = in_fresh_process(_distance_to_batch, many.parameters)
    headings = ["", "rows", "rows/s", "peak of the process [MB]", "in the buffer [MB]"]
    rows = [
        [f"streamed, {s.rows:,}", str(s.rows), f"{s.rows / s.seconds:,.0f}", f"{s.peak:.1f}", f"{s.buffered:.2f}"]
        for s in (few, many)
    ]
    rows.append(["all at once", str(many.rows), "", f"{batch_peak:.1f}", ""])
    caption = (
        f"Peak with a hundred times the rows: {many.peak / few.peak:.3f} times as high; must be at most 1.2. Geodesic "
        f"distance between the streamed minimiser and that of all rows at once: {apart:.1e}. rows/s: from samples of "
        "the motion to rows in the buffer. Arm of 7 joints with friction, rotor inertia and offsets, 98 parameters."
    )
    report.table("Streaming: a million rows through the bounded buffer", headings, rows, caption)
    report.result(
        "streaming",
        {
            "peak_ratio": many.peak / few.peak,
            "peaks": {"few": few.peak, "many": many.peak, "batch": batch_peak},
            "buffered": {"few": few.buffered, "many": many.buffered},
            "rows_per_second": many.rows / many.seconds,
            "distance_to_batch": apart,
        },
    )


def _stream(count: int) -> _Stream:
    model = _model()
    identifier = Identifier(model, _SETTINGS)
    seconds = 0.0
    for samples in _recording(model, count):
        begin = time.perf_counter()
        identifier.add(samples)
        seconds += time.perf_counter() - begin
    parameters = identifier.solve().parameters
    buffered = sum(part.factor.nbytes for parts in identifier.snapshot().parts() for part in parts)
    return _Stream(identifier.rows, seconds, resident("VmHWM"), buffered / 2**20, parameters)


def _model() -> MeasurementModel:
    return Session(read_urdf(_URDF), Configuration({"candidates": []}), _URDF.name).model


def _recording(model: MeasurementModel, count: int) -> Iterator[Samples]:
    """Samples with ``count`` rows, or a few more, of an arm whose parameters are not those of the URDF."""
    rng = np.random.default_rng(0)
    joints = len(model.robot.joints)
    speeds = rng.uniform(0.3, 6.0, (_TONES, joints))
    phases = rng.uniform(0.0, 2.0 * np.pi, (_TONES, joints))
    links = model.nominal_inertias.reshape(-1, 10) * rng.uniform(0.7, 1.4, (len(model.body_names), 1))
    truth = np.append(links, rng.uniform(0.1, 0.5, len(model.coefficients)))
    nothing = np.zeros((_AT_ONCE, 0))
    for begin in range(0, -(-count // joints), _AT_ONCE):
        instants = np.arange(begin, begin + _AT_ONCE)
        angles = speeds * (instants / _RATE)[:, None, None] + phases
        motion = np.sin(angles).sum(1), (speeds * np.cos(angles)).sum(1), -(speeds**2 * np.sin(angles)).sum(1)
        wrenches = np.zeros((_AT_ONCE, 0, 6))
        still_unknown = Samples(instants, *motion, np.zeros((_AT_ONCE, joints)), nothing, nothing, nothing, wrenches)
        efforts = model.rows(still_unknown).coefficients @ truth + _NOISE * rng.normal(size=(_AT_ONCE, joints))
        yield Samples(instants, *motion, efforts, nothing, nothing, nothing, wrenches)


def _distance_to_batch(streamed: FloatArray) -> tuple[float, float]:
    """Geodesic distance from the streamed minimiser to that of all rows, and this process's peak of memory [MB]."""
    model = _model()
    identifier = Identifier(model, _SETTINGS)
    coefficients, targets = [], []
    for samples in _recording(model, _MANY):
        identifier.add(samples)
        made = model.rows(samples)
        coefficients.append(made.coefficients.reshape(-1, model.dimension))
        targets.append(made.targets.ravel())
    summary = identifier.snapshot()
    manifold = model.manifold(scales_of_coefficients(model, summary)[model.positives :])
    prior = manifold.point(prior_parameters(model, summary, None))
    sigmas = np.resize(identifier.solve().sigmas, sum(map(len, targets)))
    rows = np.concatenate(coefficients)
    rows /= sigmas[:, None]
    objective = ResidualObjective.of(manifold, rows, np.concatenate(targets) / sigmas, prior, PAPER)
    relative = (DEFAULT_PRIOR_STD / default_prior_stds(manifold)) ** 2
    objective = replace(objective, prior_weights=objective.prior_weights * relative)
    found = trust_region(objective, prior, _SETTINGS.tolerance * PAPER, _SETTINGS.max_steps)
    return manifold.distance(manifold.point(streamed), found.point), resident("VmHWM")


if __name__ == "__main__":
    run(Report())
