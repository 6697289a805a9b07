"""Products of whitened columns, against the columns themselves."""

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap.candidates import Candidate, EffectTerm
from geomid_ros.gap.features import Features
from geomid_ros.gap.linearised_problem import LinearisedProblem, design_of
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.records import TotalModel
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import AtJoint, AtSensor, OnLink, OnRobot, Situation
from geomid_ros.model.effects.friction import ViscousFriction
from geomid_ros.model.effects.mounting import CarriedBody, GravityTilt
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


def test_crossed_products_are_those_with_a_candidate_s_columns() -> None:
    candidate = Candidate(ViscousFriction(), AtJoint(0), (BOTH, SECOND))
    found = DESIGN.candidate_products([candidate], dict(enumerate(DESIGN.places([1], [FIRST]))))
    assert DESIGN.affected_channels(candidate) == [0, 1]
    for channel in range(CHANNELS):
        mine = stacked(channel, [], [BOTH, SECOND])[:, 10 * LINKS : -1]
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


def test_a_payload_has_the_columns_of_its_link() -> None:
    candidate = Candidate(CarriedBody(), OnLink(1, 1), ())
    assert DESIGN.affected_channels(candidate) == [0, 1]
    found = DESIGN.candidate_products([candidate], dict(enumerate(DESIGN.places([], [FIRST]))))
    for channel in range(CHANNELS):
        mine = stacked(channel, [], [])[:, 10:20]
        np.testing.assert_allclose(found[channel].crossed[0], mine.T @ stacked(channel, [], [FIRST]), atol=1e-10)
        np.testing.assert_allclose(found[channel].squared[0], mine.T @ mine, atol=1e-10)


class TestColumns:
    """Columns of effects by the channels that they reach."""

    URDF = (planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")
    MODEL = MeasurementModel(Robot(URDF), (), (WrenchSensor("/wrench", "link3", "mounted", ("fx", "tz")),))
    COUNT = 30
    PREDICTED = RNG.normal(size=(COUNT, 5))

    def columns(self, *terms: EffectTerm) -> dict[EffectTerm, dict[int, FloatArray]]:
        motion = planted.recording(planted.rigid(planted.true_inertias(1, 0.1)), 1, 2.0).select(slice(self.COUNT))
        by_gravity = np.zeros((self.COUNT, 5, 3))
        by_gravity[:, 1:4, 1] = self.PREDICTED[:, 1:4]
        said = {"predicted": self.PREDICTED, "by_gravity": by_gravity, "gravity": np.array([0.0, 0.0, -9.81])}
        unsaid: dict[str, Any] = dict.fromkeys(field.name for field in fields(Situation))
        situation = Situation(**{**unsaid, **said, "coefficients": {}})
        records: Any = SimpleNamespace(samples=motion, with_shifted_efforts=lambda _: records)
        problem = LinearisedProblem(self.MODEL, records, TotalModel(np.zeros((0, 10)), (), self.MODEL.robot.gravity))
        vars(problem)["situation"] = situation
        return problem.columns(terms)

    def test_a_tilt_reaches_what_gravity_reaches(self) -> None:
        terms = [EffectTerm(GravityTilt(), OnRobot(), index) for index in range(2)]
        found = self.columns(*terms)
        assert [list(by_channel) for by_channel in found.values()] == [[1, 2, 3], []]
        # R^T g turns towards y by x, from (0, 0, -g) to (0, -g sin, -g cos).
        np.testing.assert_allclose(found[terms[0]][2], -9.81 * self.PREDICTED[:, 2], rtol=1e-6)

    def test_an_offset_of_a_sensor_reaches_each_axis_by_itself(self) -> None:
        place = AtSensor("/wrench", (3, 4))
        terms = [EffectTerm(WrenchOffset(), place, index) for index in range(2)]
        found = self.columns(*terms)
        assert [list(by_channel) for by_channel in found.values()] == [[3], [4]]
        np.testing.assert_array_equal(found[terms[1]][4], np.ones(self.COUNT))
