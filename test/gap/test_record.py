"""Which rows of a recording are used, and what a model says of them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from model.robots import fixed_base

from geomid_ros.gap.records import Records, TotalModel
from geomid_ros.model.effects import AtJoint, AtJoints, Effect
from geomid_ros.model.effects.drive import RotorInertia
from geomid_ros.model.effects.effect import JointMotion, PairEffect
from geomid_ros.model.effects.friction import CoulombFriction, ViscousFriction
from geomid_ros.model.effects.sensor_errors import EffortGain
from geomid_ros.model.effects.situation import Place
from geomid_ros.model.samples import REST, SIGN, SMOOTH_SIGN, Entries, JointColumn, Samples
from geomid_ros.types import FloatArray

from . import planted

MODEL = planted.model()
CUTOFF = 5.0
START = 1_700_000_000_000_000_000  # [ns] an ordinary day's clock


def samples(count: int, rate: float = 100.0, velocity: FloatArray | None = None) -> Samples:
    """Of three joints that turn with these velocities, with no columns of effects."""
    rates = np.ones((count, 3)) if velocity is None else velocity
    times = np.arange(count)[:, None] / rate
    stamps = START + np.round(1e9 / rate * np.arange(count)).astype(np.int64)
    return fixed_base(stamps, times * rates, rates, np.zeros((count, 3)), np.cos(times + np.arange(3)))


def with_columns(sign: FloatArray, rest: FloatArray, smooth: FloatArray | None = None, rate: float = 100.0) -> Samples:
    """The same with these columns ``(N, 3)``."""
    values = np.concatenate([sign, rest, sign if smooth is None else smooth], axis=1)
    return replace(samples(len(sign), rate), effects=values, entries=Entries((SIGN, REST, SMOOTH_SIGN), 3))


@pytest.mark.parametrize(("rate", "step"), [(200.0, 15), (10.0, 1)])
def test_rows_are_as_far_apart_as_the_filter_makes_them_independent(rate: float, step: int) -> None:
    """2.67 in a period of the cutoff, or all where there are fewer, away from the ends by half a period of it."""
    records = Records.make([samples(1000, rate)], CUTOFF)
    (chosen,) = records.chosen
    margin = round(0.5 * rate / CUTOFF) + 1
    assert set(np.diff(chosen)) == {step}
    assert (chosen[0], records.segment.tolist()) == (margin, [0] * len(chosen))
    assert 1000 - margin - step <= chosen[-1] < 1000 - margin
    np.testing.assert_array_equal(records.samples.stamps, records.dense[0].stamps[chosen])


def test_a_pause_and_a_new_recording_divide_the_stretches() -> None:
    paused = samples(300).select(np.flatnonzero((np.arange(300) < 100) | (np.arange(300) >= 150)))
    records = Records.make([paused, samples(100)], CUTOFF)
    assert [len(part) for part in records.dense] == [100, 150, 100]
    assert np.bincount(records.segment).tolist() == [len(chosen) for chosen in records.chosen]


@pytest.mark.parametrize(("count", "kept"), [(2, False), (36, False), (37, True)])
def test_a_stretch_with_fewer_than_three_rows_is_left_out(count: int, kept: bool) -> None:
    """Eleven samples at either end, and steps of seven."""
    assert len(Records.make([samples(count), samples(200)], CUTOFF).dense) == 1 + kept


def test_efforts_count_of_joints_that_move_one_way() -> None:
    count = 200
    sign, rest = np.ones((count, 3)), np.zeros((count, 3))
    sign[:, 1], rest[:, 2] = np.linspace(-1.1, 1.1, count), np.linspace(0.0, 1.0, count)
    records = Records.make([with_columns(sign, rest)], CUTOFF)
    targets = np.ones((len(records.samples), 3))
    targets[::2, 0] = np.nan
    usable = records.usable(MODEL, targets)
    np.testing.assert_array_equal(usable[:, 0], np.arange(len(targets)) % 2 == 1)
    np.testing.assert_array_equal(usable[:, 1], np.abs(records.samples.column(SIGN)[:, 1]) > 0.97)
    np.testing.assert_array_equal(usable[:, 2], records.samples.column(REST)[:, 2] < 0.3)
    assert 0 < np.count_nonzero(usable[:, 1]) < np.count_nonzero(usable[:, 2]) < len(targets)


@pytest.mark.parametrize("rate", [100.0, 200.0])
def test_friction_is_unsettled_where_two_models_of_it_differ_and_thirty_milliseconds_about(rate: float) -> None:
    count = 400
    sign = np.ones((count, 3))
    smooth = sign.copy()
    smooth[200, 0], smooth[200, 1] = 0.5, 1.5
    records = Records.make([with_columns(sign, np.zeros((count, 3)), smooth, rate)], CUTOFF)
    times = np.abs(records.chosen[0] - 200) / rate
    near = times <= 0.03 + 1e-9
    np.testing.assert_array_equal(records.friction_ambiguity[:, 0] == 0.5, near)
    np.testing.assert_array_equal(records.friction_ambiguity[:, 1] == 0.5, near)
    assert not np.any(records.friction_ambiguity[~near])
    assert not np.any(records.friction_ambiguity[:, 2])
    assert np.any(near)


def test_efforts_of_later_are_interpolated_and_none_beyond_the_end() -> None:
    records = Records.make([samples(200)], CUTOFF)
    for lag in (0.0, 0.013, -0.02):
        (part,) = records.with_shifted_efforts(lag).dense
        times = np.arange(200) / 100.0 + lag
        inside = (times >= 0.0) & (times <= 1.99 + 1e-9)
        expected = np.cos(times[:, None] + np.arange(3))
        np.testing.assert_allclose(part.effort[inside], expected[inside], atol=1e-6)
        assert np.all(np.isnan(part.effort[~inside]))
        np.testing.assert_array_equal(part.position, records.dense[0].position)
        assert records.with_shifted_efforts(lag).chosen is records.chosen
    assert records.with_shifted_efforts(0.0).dense[0] is records.dense[0]


class Belt(PairEffect):
    """A belt between two joints, as a column that no sample carries."""

    name = "belt"

    def columns(self, first: JointMotion, second: JointMotion) -> tuple[FloatArray, FloatArray]:
        return first.velocity - second.velocity, second.velocity - first.velocity


def total(*effects: tuple[Effect, Place, list[float]]) -> TotalModel:
    found = tuple((effect, place, np.array(values)) for effect, place, values in effects)
    inertias = np.array([body.parameters for body in MODEL.robot.bodies])
    return TotalModel(inertias, found, np.array([0.0, 0.0, -9.81]))


def test_efforts_of_a_model_are_those_of_all_its_effects_of_motion() -> None:
    """Of columns that the samples carry, filtered, and of those that they do not."""
    velocity = np.random.default_rng(2).normal(size=(50, 3))
    plain = samples(50, velocity=velocity)
    carried = np.random.default_rng(3).normal(size=(50, 3))
    coulomb = CoulombFriction(0.003)
    part = replace(plain, effects=carried, entries=Entries((JointColumn(coulomb),), 3))
    own = total(
        (coulomb, AtJoint(1), [0.3]),
        (coulomb, AtJoint(2), [0.1]),
        (ViscousFriction(), AtJoint(1), [2.0]),
        (ViscousFriction(), AtJoint(1), [0.5]),
        (Belt(), AtJoints(0, 2), [4.0]),
        (EffortGain(), AtJoint(0), [0.7]),
    )
    expected = np.zeros((50, 3))
    expected[:, 1] = 0.3 * carried[:, 1] + 2.5 * velocity[:, 1]
    expected[:, 2] = 0.1 * carried[:, 2] + 4.0 * (velocity[:, 2] - velocity[:, 0])
    expected[:, 0] = 4.0 * (velocity[:, 0] - velocity[:, 2])
    np.testing.assert_allclose(own.efforts(part), expected, atol=1e-12)


def test_the_situation_is_that_of_the_total_model() -> None:
    """The gears transmit the efforts of rigid bodies; friction and a motor's own inertia are predicted beside these."""
    inertias = planted.true_inertias(4, 0.2)
    rigid = planted.rigid(inertias)
    recorded = planted.recording(rigid, 4, 12.0, noise=0.0)
    records = Records.make([recorded], planted.CUTOFF)
    friction: Any = (ViscousFriction(), AtJoint(1), np.array([0.7]))
    rotor: Any = (RotorInertia(), AtJoint(2), np.array([0.3]))
    model = TotalModel(inertias, (friction, rotor), MODEL.robot.gravity)
    situation = records.situation(MODEL, model)
    (chosen,) = records.chosen
    _, q, v, a = planted.motion(4, 12.0)
    load = rigid(q, v, a)[chosen]
    # The load is smoothed at half the filter's cutoff, which these motions are below.
    np.testing.assert_allclose(situation.load[5:-5], load[5:-5], atol=0.02 * np.std(load))
    np.testing.assert_allclose(situation.transmitted, load, atol=1e-9)
    beside = situation.predicted - situation.transmitted
    np.testing.assert_allclose(beside, [0.0, 0.7, 0.0] * v[chosen] + [0.0, 0.0, 0.3] * a[chosen], atol=1e-9)
    times = np.arange(len(q)) / planted.RATE
    slope = np.gradient(rigid(q, v, a), times, axis=0)[chosen]
    np.testing.assert_allclose(situation.load_rate[5:-5], slope[5:-5], atol=0.05 * np.std(slope))
    bend = np.gradient(np.gradient(rigid(q, v, a), times, axis=0), times, axis=0)[chosen]
    np.testing.assert_allclose(situation.load_acceleration[5:-5], bend[5:-5], atol=0.15 * np.std(bend))
    # So are functions of the load, each layer by itself.
    layers = situation.from_load_history(lambda load, _: np.stack([load, -2.0 * load], axis=2))
    for each, expected in zip(layers, (load, slope, bend), strict=True):
        np.testing.assert_allclose(each[5:-5, :, 0], expected[5:-5], atol=0.15 * np.std(expected))
        np.testing.assert_array_equal(each[:, :, 1], -2.0 * each[:, :, 0])
    np.testing.assert_array_equal(situation.sign, records.samples.column(SIGN))
    assert situation.coefficients == {("viscous_friction", AtJoint(1)): 0.7, ("rotor_inertia", AtJoint(2)): 0.3}
    np.testing.assert_array_equal(situation.gravity, MODEL.robot.gravity)
    assert situation.typical_load(AtJoint(1)) == pytest.approx(np.std(situation.load[:, 1]))
