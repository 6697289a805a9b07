"""All that a run says, on one robot whose model has effects already."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.gap import workflow
from geomid_ros.gap.records import Records
from geomid_ros.gap.result import GapResult, Rival
from geomid_ros.gap.workflow import CUTOFF, find_gap, residual_rms
from geomid_ros.inference.candidates import EffectTerm
from geomid_ros.inference.prior import OtherRecordings
from geomid_ros.model.effects import AtJoint, KnownEffect, Quantity
from geomid_ros.model.effects.friction import ViscousFriction
from geomid_ros.model.effects.sensor_errors import EffortOffset
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from . import planted

BARE = planted.model()
MODEL = MeasurementModel(BARE.robot, (ViscousFriction(), EffortOffset()))
JOINTS = BARE.robot.joint_names
SEED = 81
INERTIAS = planted.true_inertias(SEED, 0.1)
RIGID = planted.rigid(INERTIAS)
KNOWN, FOUND, LOAD = 0.3, 0.5, 0.08
"""Viscous friction at the first joint, which the model has, and at the second, which it has not; friction by the load
at the third, which it has as a tenth too little."""


def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    rigid = RIGID(q, v, a)
    load_friction = LOAD * np.abs(rigid) * np.tanh(v / 0.003)
    return rigid + np.array([KNOWN, FOUND, 0.0]) * v + np.array([0.0, 0.0, 1.0]) * load_friction


def nominal(**coefficients: float) -> FloatArray:
    """Of the model: only these are known."""
    values = {f"{c.effect.name} {c.place_name}": np.nan for c in MODEL.coefficients}
    values.update({f"viscous_friction {joint}": value for joint, value in coefficients.items()})
    return np.append(np.full(len(MODEL.nominal_inertias), np.nan), list(values.values()))


BESIDE = KnownEffect("load_friction", JOINTS[2], "", {"coefficient": Quantity(0.9 * LOAD, 0.01, "-")})
TRAIN, UNSEEN = planted.recording(efforts, SEED, 25.0), planted.recording(efforts, SEED + 1000, 15.0)
PROGRESS: list[tuple[str, float]] = []


@pytest.fixture(scope="module")
def result() -> GapResult:
    return find_gap(
        MODEL,
        [TRAIN],
        [UNSEEN],
        nominal=nominal(**{JOINTS[0]: KNOWN}),
        other_effects=[BESIDE],
        progress=lambda what, share: PROGRESS.append((what, share)),
    )


def test_what_is_missing_is_named_and_what_is_known_stays(result: GapResult) -> None:
    (finding,) = result.findings
    assert (finding.effect, finding.joint, result.verdict) == ("viscous_friction", JOINTS[1], "named")
    found = finding.parameters["coefficient"]
    assert abs(found.value - FOUND) < 4.0 * found.std
    coefficients = dict(zip(MODEL.coefficients, result.coefficients, strict=True))
    known = [value for c, value in coefficients.items() if np.isfinite(value)]
    assert known == [coefficients[MODEL.coefficients[0]]]
    assert known == [KNOWN], "no finding says that it is another"
    assert result.beside == (BESIDE,)
    assert result.ordinary == (), "the model knows of friction"


@pytest.mark.parametrize(("losses", "nothing"), [((), 0.9), ((), 1.1), ((2.0, 15.0), 1.3), ((2.0, 15.0), 1.4)])
def test_a_name_is_likely_if_it_or_a_rival_is_rather_than_nothing(
    result: GapResult, losses: tuple[float, ...], nothing: float
) -> None:
    """By the weights of all, of which the name's is 1."""
    something = 1.0 + sum(np.exp(-0.5 * loss) for loss in losses)
    rivals = tuple(Rival("spring", JOINTS[0], loss) for loss in losses)
    finding = replace(result.findings[0], probability=1.0 / (something + nothing), rivals=rivals)
    assert finding.is_likely == (something >= nothing)


def test_a_model_with_effects_beside_its_coefficients_is_judged_as_the_search_begins(result: GapResult) -> None:
    known = nominal(**{JOINTS[0]: KNOWN})
    left = residual_rms(MODEL, [UNSEEN], CUTOFF, known, [BESIDE])
    np.testing.assert_allclose(left, result.gap.before * result.floor, rtol=1e-9)
    without = residual_rms(MODEL, [UNSEEN], CUTOFF, known, [])
    assert without[2] > 1.5 * left[2]
    np.testing.assert_allclose(without[:2], left[:2], rtol=1e-9)


def test_the_inertias_are_as_good_as_the_true_ones(result: GapResult) -> None:
    _, q, v, a = planted.motion(SEED + 1000, 15.0)
    off = planted.rigid(result.inertias)(q, v, a) - RIGID(q, v, a)
    assert np.sqrt(np.mean(off**2)) < 0.5 * planted.NOISE


def test_the_trace_is_of_unseen_data(result: GapResult) -> None:
    """What the URDF with its known friction predicts, by the recursive algorithm; the final model is right."""
    trace, (chosen,) = result.trace, Records.make([UNSEEN], planted.CUTOFF).chosen
    np.testing.assert_array_equal(trace.stamps, UNSEEN.stamps[chosen])
    np.testing.assert_array_equal(trace.measured, UNSEEN.effort[chosen])
    _, q, v, a = (part[chosen] for part in planted.motion(SEED + 1000, 15.0))
    np.testing.assert_array_equal(trace.position, q)
    np.testing.assert_array_equal(trace.velocity, v)
    before = planted.rigid(MODEL.nominal_inertias.reshape(-1, 10))(q, v, a)
    np.testing.assert_allclose(trace.before[:, :2], before[:, :2] + np.array([KNOWN, 0.0]) * v[:, :2], atol=1e-9)
    exact = efforts(q, v, a)
    away = np.abs(v[:, 2]) > 0.1
    assert np.sqrt(np.mean((trace.after - exact)[away] ** 2)) < planted.NOISE
    np.testing.assert_array_equal(trace.load, np.abs(trace.after))
    assert np.std((trace.inertias_only - exact)[:, 1]) > np.std((trace.after - exact)[:, 1])


def test_gaps_are_root_mean_squares_of_the_trace_in_units_of_the_floor(result: GapResult) -> None:
    """Of joints without dry friction, wherever they move."""
    trace, records = result.trace, Records.make([UNSEEN], planted.CUTOFF)
    usable = records.usable(BARE, BARE.rows(records.samples).targets)
    for predicted, gap in (
        (trace.before, result.gap.before),
        (trace.inertias_only, result.gap.inertias_only),
        (trace.after, result.gap.after),
    ):
        left = trace.measured[:, 0][usable[:, 0]] - predicted[:, 0][usable[:, 0]]
        assert gap[0] == pytest.approx(np.sqrt(np.mean(left**2)) / result.floor[0], rel=0.05)
    assert np.all(result.gap.expected >= 1.0)
    assert np.all(result.gap.expected < 1.1)
    assert np.all(result.gap.after < 1.15 * result.gap.expected)


class TestPrior:
    """What is known before, from what the user gives."""

    def prior(self, values: FloatArray | None = None, deviations: FloatArray | None = None) -> workflow.Prior:
        information = OtherRecordings(np.eye(30), np.zeros(30))
        return workflow._prior(MODEL, values, deviations, information)

    def test_effects_are_a_fiftieth_unsure_or_as_they_say_where_that_is_more(self) -> None:
        """Those of no size are none."""
        values = nominal(**{JOINTS[0]: 0.5, JOINTS[1]: -1e-4, JOINTS[2]: 0.0})
        prior = self.prior(values)
        assert prior.terms == tuple(EffectTerm(ViscousFriction(), AtJoint(joint)) for joint in (0, 1))
        np.testing.assert_allclose(prior.values, [0.5, -1e-4])
        np.testing.assert_allclose(prior.prior_stds, [0.01, 2e-6])
        unsure = np.full(MODEL.dimension, np.nan)
        unsure[len(MODEL.nominal_inertias)] = 0.4
        np.testing.assert_allclose(self.prior(values, unsure).prior_stds, [0.4, 2e-6])

    def test_only_what_is_small_may_change_by_a_small_share_of_what_is_measured(self) -> None:
        """Of a larger coefficient the change is to be named, whatever else the joint carries."""
        records = Records.make([TRAIN], planted.CUTOFF)
        measured, velocity = (np.sqrt(np.mean(part[:, :2] ** 2, axis=0)) for part in (TRAIN.effort, TRAIN.velocity))
        share = 0.01 * measured / velocity
        prior = self.prior(nominal(**{JOINTS[0]: 0.8 * share[0], JOINTS[1]: 1.2 * share[1]}))
        own = OtherRecordings(np.zeros((1, 32)), np.zeros(1), prior.prior_stds)
        found = workflow._with_least_stds(BARE, records, replace(prior, other_recordings=own))
        np.testing.assert_allclose(found.prior_stds, [share[0], prior.prior_stds[1]], rtol=0.05)
        assert found.other_recordings is not None
        np.testing.assert_array_equal(found.other_recordings.changes, found.prior_stds)

    @pytest.mark.parametrize(("std", "expected"), [(0.0, 0.02), (0.001, 0.02), (0.02, 0.15), (np.inf, 0.02)])
    def test_an_effect_beside_the_coefficients_is_as_unsure_as_its_motion_says(
        self, std: float, expected: float
    ) -> None:
        beside = KnownEffect("load_friction", JOINTS[2], "", {"coefficient": Quantity(LOAD, std, "-")})
        records = Records.make([TRAIN], planted.CUTOFF)
        prior, _ = workflow._with_other_effects(BARE, records, self.prior(), [beside])
        np.testing.assert_allclose(prior.values, [LOAD])
        np.testing.assert_allclose(prior.prior_stds, [expected * LOAD])


def without_rest(samples: Samples, joints: Sequence[int], rest: float) -> Records:
    """With these joints at rest all the time, or never."""
    effects = samples.effects.copy()
    for joint in joints:
        effects[:, samples.entries.at(workflow.REST, joint)] = rest
    return Records.make([replace(samples, effects=effects)], planted.CUTOFF)


def test_a_recording_needs_thirty_independent_instants_that_measure_something_in_motion() -> None:
    """Two in a seventh of a second, or so."""
    short, enough = (Records.make([planted.recording(RIGID, 1, seconds)], planted.CUTOFF) for seconds in (1.5, 3.0))
    nothing = Records.make([replace(TRAIN, effort=np.full(TRAIN.effort.shape, np.nan))], planted.CUTOFF)
    resting = without_rest(TRAIN, range(3), 1.0)
    for records, said in (
        (short, f"too short: {len(short.samples)} independent"),
        (Records.make([], planted.CUTOFF), "too short: 0 independent"),
        (nothing, r"no effort or wrench is measured.*joint1"),
        (resting, "no joint moves"),
    ):
        with pytest.raises(InputError, match=said):
            workflow._check(BARE, records)
    with pytest.raises(InputError, match="no usable held-out data"):
        workflow._check_held_out(BARE, resting)
    assert len(short.samples) < 30 <= len(enough.samples)
    for records in (enough, without_rest(resting.dense[0], [1], 0.0)):
        workflow._check(BARE, records)
