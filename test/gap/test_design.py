"""Products of whitened columns, against the columns themselves."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap.features import Features
from geomid_ros.gap.linearised_problem import LinearisedProblem, design_of
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.records import TotalModel
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import AtJoint, AtSensor, OnLink
from geomid_ros.model.effects.friction import ViscousFriction
from geomid_ros.model.effects.mounting import CarriedBody
from geomid_ros.model.effects.sensor_errors import WrenchOffset
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

from . import planted

ROWS, CHANNELS, LINKS = 90, 2, 2
RNG = np.random.default_rng(6)
COEFFICIENTS = RNG.normal(size=(ROWS, CHANNELS, 10 * LINKS))
TARGETS = RNG.normal(size=(ROWS, CHANNELS))
VALID = RNG.uniform(size=(ROWS, CHANNELS)) > 0.2
SEGMENT = (np.arange(ROWS) >= 50).astype(int)
BOTH, FIRST, SECOND = (EffectTerm(ViscousFriction(), AtJoint(joint)) for joint in range(3))
COLUMNS: dict[EffectTerm, dict[int, FloatArray]] = {
    BOTH: {0: RNG.normal(size=ROWS), 1: RNG.normal(size=ROWS)},
    FIRST: {0: RNG.normal(size=ROWS)},
    SECOND: {1: RNG.normal(size=ROWS)},
}
NOISE = (Autoregression((np.zeros(0), np.array([0.5])), np.array([1.0, 0.75])), Autoregression.white())
RECORDS: Any = SimpleNamespace(segment=SEGMENT)
NOTHING = (Features(np.zeros((ROWS, 0)), np.zeros(0, dtype=np.intp), ()),) * CHANNELS
DESIGN = design_of(Rows(COEFFICIENTS, TARGETS), VALID, COLUMNS, NOTHING, NOISE, RECORDS)


def white(channel: int, values: FloatArray) -> FloatArray:
    """A column whitened by hand: less half of the row before, where that is valid and of the same segment."""
    valid = np.flatnonzero(VALID[:, channel])
    if channel == 1:
        return values[valid]
    result = []
    for row in valid:
        follows = row > 0 and VALID[row - 1, channel] and SEGMENT[row] == SEGMENT[row - 1]
        result.append(values[row] - 0.5 * values[row - 1] if follows else np.sqrt(0.75) * values[row])
    return np.array(result)


def stacked(channel: int, bodies: list[int], terms: list[EffectTerm]) -> FloatArray:
    """The whitened columns that a fit has, those that do not reach the channel zero."""
    zero = np.zeros(ROWS)
    again = [COEFFICIENTS[:, channel, 10 * body + k] for body in bodies for k in range(10)]
    own = [COLUMNS[term].get(channel, zero) for term in terms]
    columns = [*COEFFICIENTS[:, channel].T, *again, *own, TARGETS[:, channel]]
    return np.column_stack([white(channel, column) for column in columns])


def test_products_are_those_of_the_whitened_columns() -> None:
    bodies, terms = [1], [FIRST, BOTH, SECOND]
    products = DESIGN.gather(bodies, terms)
    for channel in range(CHANNELS):
        columns = stacked(channel, bodies, terms)
        np.testing.assert_allclose(products.weighed(np.arange(CHANNELS) == channel), columns.T @ columns, atol=1e-10)
        assert DESIGN.counts[channel] == len(columns)


@pytest.mark.parametrize(
    "candidate",
    [Candidate(ViscousFriction(), AtJoint(0), (BOTH, SECOND)), Candidate(CarriedBody(), OnLink(1, 1), ())],
    ids=["two terms", "a payload, which has the columns of its link"],
)
def test_crossed_products_are_those_with_a_candidate_s_columns(candidate: Candidate) -> None:
    found = DESIGN.candidate_products([candidate], dict(enumerate(DESIGN.places([1], [FIRST]))))
    assert DESIGN.affected_channels(candidate) == [0, 1]
    for channel in range(CHANNELS):
        columns = stacked(channel, [], [BOTH, SECOND])
        mine = columns[:, 10 * LINKS : -1] if candidate.terms else columns[:, 10:20]
        np.testing.assert_allclose(found[channel].crossed[0], mine.T @ stacked(channel, [1], [FIRST]), atol=1e-10)
        np.testing.assert_allclose(found[channel].squared[0], mine.T @ mine, atol=1e-10)


def test_candidates_have_products_in_the_channels_that_they_reach() -> None:
    both = Candidate(ViscousFriction(), AtJoint(0), (BOTH,))
    candidate = Candidate(ViscousFriction(), AtJoint(2), (SECOND,))
    assert DESIGN.affected_channels(candidate) == [1]
    first, second = DESIGN.candidate_products([both, candidate], dict(enumerate(DESIGN.places([], []))))
    assert (first.which.tolist(), second.which.tolist()) == ([0], [0, 1])
    assert (second.crossed.shape, second.squared.shape) == ((2, 1, 10 * LINKS + 1), (2, 1, 1))
    for column, own in zip((BOTH, SECOND), second.squared[:, 0, 0].tolist(), strict=True):
        mine = white(1, COLUMNS[column][1])
        assert own == pytest.approx(mine @ mine)


def test_an_offset_of_a_sensor_reaches_each_axis_by_itself() -> None:
    sensor, count = WrenchSensor("/wrench", "link3", "mounted", ("fx", "tz")), 30
    model = MeasurementModel(Robot((planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")), (), (sensor,))
    motion = planted.recording(planted.rigid(planted.true_inertias(1, 0.1)), 1, 2.0).select(slice(count))
    total = TotalModel(np.zeros((0, 10)), (), model.robot.gravity)
    records: Any = SimpleNamespace(samples=motion, with_shifted_efforts=lambda _: records)
    terms = [EffectTerm(WrenchOffset(), AtSensor("/wrench", (3, 4)), index) for index in range(2)]
    found = LinearisedProblem(model, records, total).columns(terms)
    assert [list(by_channel) for by_channel in found.values()] == [[3], [4]]
    np.testing.assert_array_equal(found[terms[1]][4], np.ones(count))
