"""The joint posterior against the truth: how far the truth of simulated bags lies from the estimate, in all directions,
and how much the torques of robots that are drawn from it differ.

``python -m benchmarks.posterior [--bags 100]`` records the bags, identifies each and compares.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import geomid_ros
from benchmarks.report import Report
from geomid_ros import register
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.estimation.suggested_motions import instants
from geomid_ros.exports.posterior_samples import torque_bands, within_ranges
from geomid_ros.files.models.urdf import with_inertials
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import Effect
from geomid_ros.model.effects.friction import CoulombFriction
from geomid_ros.model.robot import Robot
from geomid_ros.simulation.description import WRIST_FRAME, robot_description
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate
from geomid_ros.types import FloatArray

FIRST_SEED = 5000
BAGS = 100
_PROCESSES = 2
_DRAWN = 1000


@register
@dataclass(frozen=True)
class SharpFriction(CoulombFriction):
    """Dry friction as the simulator has it: it turns with the direction of motion more sharply than the default does.

    The default, which suits robots, puts its size up by one or two per cent here, and viscous friction down.
    """

    smoothing: float = 0.003

    name = "sharp_friction"

    @classmethod
    def grid(cls) -> tuple[Effect, ...]:
        """Itself."""
        return (cls(),)


_RIGHT = {"effects": ["viscous_friction", "sharp_friction", "rotor_inertia", "effort_offset"]}
_SIMULATED = {"sharp_friction": "coulomb_friction"}


@dataclass(frozen=True)
class Case:
    """A robot, how long its bags are [s], whether its wrist is sensed, and how it is identified."""

    robot: str
    duration: float
    wrist: bool = False
    options: dict[str, Any] = field(default_factory=dict)


CASES = {
    "arm7": Case("arm7", 12.0, options=_RIGHT),
    "arm7 with a wrist sensor": Case("arm7", 12.0, wrist=True, options=_RIGHT),
    "arm3": Case("arm3", 8.0, options=_RIGHT),
    "arm7, default effects": Case("arm7", 12.0, options={"candidates": []}),
    "arm7, effects chosen": Case("arm7", 12.0),
}
"""In the first three the model is right. Then dry friction turns less sharply than the simulator's, and at last it is
chosen from the data which effects there are."""


@dataclass(frozen=True)
class Distances:
    """Of the truth from one estimate.

    Attributes:
        directions: Squared errors ``(D,)`` in variances, along the covariance's eigen-directions from the surest to the
            least sure.
        marginals: The same of the coordinates by themselves.
        geodesic: The first along geodesics.
        held: Share of the true torques in fast motion that lie in the 95 % bands of drawn robots.
        width: Of these bands, as a share of those of ranges of 20 %, mean over the channels.
    """

    directions: FloatArray
    marginals: FloatArray
    geodesic: FloatArray
    held: float
    width: float


def run(report: Report, bags: int = BAGS) -> None:
    """A table with a row for each case."""
    results = {}
    for name, case in CASES.items():
        report.progress(f"posterior: {bags} simulated recordings, {name}")
        with ProcessPoolExecutor(_PROCESSES, mp_context=get_context("spawn")) as pool:
            found = list(pool.map(partial(distances, case), range(FIRST_SEED, FIRST_SEED + bags), chunksize=5))
        results[name] = _summary(found)
        report.result("posterior", results)
    rows = [[name, *(f"{value:.2f}" for value in found.values())] for name, found in results.items()]
    headings = ["", "Mahalanobis^2/D", "median", "largest", "worst direction", "marginals", "along geodesics"]
    headings += ["true torques in 95 % bands", "bands / ranges"]
    caption = (
        f"Of the truth from the estimate, {bags} bags each: mean, median and largest squared distance per direction; "
        "the largest mean squared error of any eigen-direction of the covariance; the mean of the marginals; and the "
        "mean squared distance with the same covariance along geodesics. 1 is right. Then the share of the true "
        "torques in fast motion in the 95 % bands of drawn robots, and the width of these beside ranges of 20 %."
    )
    report.table("Joint posterior", headings, rows, caption)


def _summary(found: Sequence[Distances]) -> dict[str, float]:
    whole = np.array([np.mean(each.directions) for each in found])
    size = min(len(each.directions) for each in found)
    by_direction = np.mean([each.directions[:size] for each in found], axis=0)
    return {
        "mean": float(np.mean(whole)),
        "median": float(np.median(whole)),
        "largest": float(np.max(whole)),
        "worst_direction": float(np.max(by_direction)),
        "marginals": float(np.mean([np.mean(each.marginals) for each in found])),
        "geodesic": float(np.mean([np.mean(each.geodesic) for each in found])),
        "held": float(np.mean([each.held for each in found])),
        "width": float(np.mean([each.width for each in found])),
    }


def distances(case: Case, seed: int) -> Distances:
    """Record a bag, identify it, and compare."""
    frame = WRIST_FRAME if case.wrist else None
    simulated = SimulationOptions(robot=case.robot, seed=seed, duration=case.duration, wrench_frame=frame)
    wrench = f"/wrench:{WRIST_FRAME}:mounted" if case.wrist else ()
    with tempfile.TemporaryDirectory(prefix="geomid_") as folder:
        recorded = simulate(Path(folder) / "bag", simulated)
        truth = json.loads(recorded.truth.read_text(encoding="utf-8"))
        urdf = robot_description(case.robot)
        found = geomid_ros.identify(recorded.bag, urdf, wrench=wrench, hold_out=0.0, **case.options)
    cuts = [WRIST_FRAME] if case.wrist else []
    posterior = found.estimate.posterior
    true = true_parameters(posterior, truth, urdf, cuts)
    manifold, variances = posterior.manifold, np.diag(posterior.covariance)
    values, vectors = np.linalg.eigh(posterior.covariance)
    straight = posterior.coordinates(true)
    geodesic = manifold.log(posterior.point, manifold.point(np.maximum(true, _least(posterior, true))))
    return Distances(
        (vectors.T @ straight) ** 2 / values,
        straight**2 / variances,
        (vectors.T @ geodesic) ** 2 / values,
        *_torques(found, true),
    )


def _torques(found: geomid_ros.Identification, true: FloatArray) -> tuple[float, float]:
    """The share of true torques in the bands of drawn robots, and the width of the bands beside those of ranges."""
    model, parameters = found.session.model, found.estimate.parameters
    first = len(model.nominal_inertias)
    columns = np.append(np.arange(first), first + np.flatnonzero(parameters[first:]))

    def whole(own: FloatArray) -> FloatArray:
        result = np.zeros((*own.shape[:-1], model.dimension))
        result[..., columns] = own
        return result

    motion = instants(model, moving=True)
    drawn = whole(found.estimate.posterior.draw(_DRAWN, np.random.default_rng(0)))
    low, high = torque_bands(model, motion, drawn)
    lowest, highest = torque_bands(model, motion, within_ranges(model, parameters))
    _, expected = model.predict(motion, whole(true))
    widths = [np.sqrt(np.mean((above - below) ** 2, axis=0)) for below, above in ((low, high), (lowest, highest))]
    return float(np.mean((low <= expected) & (expected <= high))), float(np.mean(widths[0] / widths[1]))


def _least(posterior: Posterior, true: FloatArray) -> FloatArray:
    """Of positive coefficients that are not there, whose logarithm is infinite: a hundredth of the estimate."""
    least = np.full(len(true), -np.inf)
    least[posterior.manifold.positive] = 0.01 * posterior.parameters[posterior.manifold.positive]
    return least


def true_parameters(posterior: Posterior, truth: dict[str, Any], urdf: str, cuts: Sequence[str]) -> FloatArray:
    """The true parameters ``(D,)`` of a simulated robot, in the posterior's order; effects that it has not are zero."""
    inertias = {
        link["name"]: pseudo_inertia.assemble(*(np.array(link[key]) for key in ("mass", "com", "inertia")))
        for link in truth["links"]
    }
    robot = Robot(with_inertials(urdf, inertias), cuts=cuts)
    bodies = {body.name: body.parameters for body in robot.bodies}
    effects = {(effect["effect"], effect["joint"]): effect["parameters"] for effect in truth["effects"]}
    coefficients = [
        effects.get((_SIMULATED.get(c.name, c.name), c.place), {}).get(c.parameter, 0.0) for c in posterior.effects
    ]
    return np.concatenate([*(bodies[name] for name in posterior.links), coefficients])


def main() -> None:
    """Run with the number of bags that is asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.posterior", description=__doc__)
    parser.add_argument("--bags", type=int, default=BAGS, help="of each case (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder for results (%(default)s)")
    arguments = parser.parse_args()
    run(Report(arguments.out), arguments.bags)


if __name__ == "__main__":
    main()
