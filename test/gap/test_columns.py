"""Columns of effects that depend on the model, against differences of a robot on which the effect acts."""

import numpy as np
import pytest

from geomid_ros.gap.linearised_problem import LinearisedProblem
from geomid_ros.gap.records import Records
from geomid_ros.inference.fit import fit_of_prior
from geomid_ros.model.effects import AtJoint
from geomid_ros.model.effects.drive import CROSSINGS, JointElasticity, sides
from geomid_ros.model.effects.sensor_errors import EncoderOffset
from geomid_ros.types import FloatArray

from . import planted

JOINT = 1


@pytest.fixture(scope="module")
def problem() -> LinearisedProblem:
    model = planted.model()
    inertias = planted.true_inertias(5, 0.2)
    records = Records.make([planted.recording(planted.rigid(inertias), 5, noise=0.0)], planted.CUTOFF)
    return LinearisedProblem.at(model, records, fit_of_prior(planted.prior(inertias)))


def agree(column: FloatArray, expected: FloatArray, share: float) -> None:
    assert np.linalg.norm(column - expected) < share * np.linalg.norm(expected)


def test_encoder_offset(problem: LinearisedProblem) -> None:
    """The link is behind the measured position by the offset, at every instant."""
    offset, exact = 1e-6, planted.motion(5, 40.0)[1:]
    moved = [part.copy() for part in exact]
    moved[0][:, JOINT] -= offset
    dynamics, (chosen,) = planted.rigid(problem.total.inertias), problem.records.chosen
    expected = (dynamics(*moved) - dynamics(*exact))[chosen] / offset
    agree(EncoderOffset().columns(problem.situation, AtJoint(JOINT))[20:-20, :, 0], expected[20:-20], 0.05)


def test_elasticity(problem: LinearisedProblem) -> None:
    """The link is behind the motor by the gear's effort times the compliance, at every instant."""
    compliance = 1e-6
    times, *exact = planted.motion(5, 40.0)
    dynamics = planted.rigid(problem.total.inertias)
    load = dynamics(*exact)[:, JOINT]
    bent = [part.copy() for part in exact]
    for part in bent:
        part[:, JOINT] -= compliance * load
        load = np.gradient(load, times, edge_order=2)
    (chosen,) = problem.records.chosen
    expected = (dynamics(*bent) - dynamics(*exact))[chosen] / compliance
    agree(JointElasticity().columns(problem.situation, AtJoint(JOINT))[20:-20, :, 0], expected[20:-20], 0.05)


def square(period: float, seconds: float, size: float) -> np.ndarray:
    """A load of one size that changes its direction every second, ``(N, 1)``."""
    times = np.arange(round(seconds / period)) * period
    return size * np.where(np.floor(times) % 2 == 0, 1.0, -1.0)[:, None]


@pytest.mark.parametrize("size", [0.1, 30.0])
def test_the_usual_load_crosses_in_the_time_of_its_name(size: float) -> None:
    period = 1e-3
    side = sides(square(period, 4.0, size), period)[:, 0]
    for place, crossing in enumerate(CROSSINGS):
        changing = np.abs(side[:, place]) < 1.0 - 1e-9
        crossings = 3  # at 1, 2 and 3 s
        assert np.count_nonzero(changing) * period / crossings == pytest.approx(crossing, abs=1.1 * period)
