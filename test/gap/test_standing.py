"""What a model lacked where it was identified is expected elsewhere, and is no change there."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.gap.analysis import known_remainder
from geomid_ros.gap.features import LARGEST_SCALE, KnownRemainder
from geomid_ros.gap.linearised_problem import LinearisedProblem
from geomid_ros.gap.records import Records
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.workflow import find_gap, remainder_of_model
from geomid_ros.inference.fit import fit_of_prior
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from . import planted

MODEL, JOINT, COGGING = planted.model(), 1, 0.4  # [N m]
TRUE = planted.true_inertias(3, 0.1)
LINKS = TRUE[list(MODEL.identified)]
GIVEN = fit_of_prior(planted.prior(LINKS))


def cogging(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    efforts = planted.rigid(TRUE)(q, v, a)
    efforts[:, JOINT] += COGGING * np.sin(7.0 * q[:, JOINT] + 0.3)
    return efforts


def recorded(seed: int, more: float = 0.0) -> Samples:
    """With ``more`` dry friction of the last joint."""

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        found = cogging(q, v, a)
        found[:, -1] += more * np.tanh(v[:, -1] / 0.02)
        return found

    return planted.recording(efforts, seed, 30.0)


@cache
def standing() -> KnownRemainder:
    found = remainder_of_model(MODEL, [recorded(1)], planted.CUTOFF, LINKS.ravel(), ())
    assert found is not None
    return found


def problem_of(samples: Samples, known: KnownRemainder) -> LinearisedProblem:
    """Another recording of the model, of which this remainder is known."""
    return LinearisedProblem.at(MODEL, Records.make([samples], planted.CUTOFF), GIVEN, known_remainder=known)


@pytest.mark.parametrize("seed", [2, 8])
def test_it_is_expected_of_another_motion_as_far_as_it_says(seed: int) -> None:
    """What is not expected of another motion is as large as noise and the coefficients' covariance say."""
    problem = problem_of(recorded(seed), standing())
    residual = problem.residual(GIVEN)
    for channel, own in enumerate(problem.features):
        off, unsure = residual[:, channel] - own.expected_remainder, own.expected_variance
        assert 0.6 < np.sqrt(np.mean(off**2 / (planted.NOISE**2 + unsure))) < 1.4
        if channel == JOINT:
            assert np.std(off) < 0.5 * np.std(residual[:, JOINT])


def test_a_prediction_is_as_unsure_as_the_coefficients_and_the_remainder() -> None:
    known = problem_of(recorded(2), standing())
    without = LinearisedProblem(known.model, known.records, known.total).variance(GIVEN)
    for channel, own in enumerate(known.features):
        np.testing.assert_allclose((known.variance(GIVEN) - without)[:, channel], own.expected_variance, atol=1e-12)
        assert np.all(own.expected_variance > 0.0)


def with_a_share(share: float) -> KnownRemainder:
    """What is known from a recording of which the joint has a share of the efforts."""
    own = recorded(1)
    few = own.effort.copy()
    few[round(share * len(own)) :, JOINT] = np.nan
    return known_remainder(MODEL, Records.make([replace(own, effort=few)], planted.CUTOFF), planted.prior(LINKS))


def test_of_channels_without_rows_nothing_is_known() -> None:
    """Which is not that they lack nothing."""
    found, known = with_a_share(0.0), standing()
    features = problem_of(recorded(2), found).features
    for channel, (mean, triangle) in enumerate(zip(found.means, found.triangles, strict=True)):
        assert len(mean) == len(triangle) == (0 if channel == JOINT else len(known.means[channel]))
        assert (features[channel].mean is None) == (channel == JOINT)


def gap(samples: Samples) -> GapResult:
    """Beside the model and what it lacks."""
    return find_gap(MODEL, [samples], (), nominal=LINKS.ravel(), known_remainder=standing())


@pytest.mark.parametrize("seed", [5, 8])
def test_it_is_no_change_and_leaves_nothing_unexplained(seed: int) -> None:
    """Though it is many times the noise."""
    found = gap(recorded(seed))
    assert (found.verdict, found.findings) == ("no gap", ())
    assert found.moving[JOINT] > 10.0


def test_a_change_beside_it_that_has_no_name_is_left_where_it_is() -> None:
    """Cogging of the last joint, too."""
    samples = recorded(6)
    effort = samples.effort.copy()
    effort[:, -1] += 0.5 * COGGING * np.sin(9.0 * samples.position[:, -1])
    found = gap(replace(samples, effort=effort))
    assert found.verdict == "unexplained"
    assert [(left.joint, left.depends_on) for left in found.unexplained] == [(MODEL.robot.joint_names[-1], "position")]


def test_a_change_beside_it_is_named() -> None:
    (finding,) = gap(recorded(6, more=0.3)).findings
    assert (finding.effect, finding.joint) == ("coulomb_friction", MODEL.robot.joint_names[-1])


def test_nothing_is_known_of_what_depends_on_time() -> None:
    for own in problem_of(recorded(7), standing()).features:
        of_time = np.array([name == "time" for name in own.depends_on])[own.block]
        assert own.mean is not None
        assert own.covariance is not None
        assert not np.any(own.mean[of_time])
        assert not np.any(own.covariance[of_time])
        assert np.all(np.diag(own.covariance)[~of_time] > 0.0)


def test_a_joint_that_stands_still_makes_no_feature_large() -> None:
    """Its motion is rounding errors; where it moves, what they would have told is not known."""
    samples = recorded(1)
    still = {name: getattr(samples, name).copy() for name in ("position", "velocity", "acceleration")}
    for value, own in zip((0.3, 1e-14, 1e-13), still.values(), strict=True):
        own[:, JOINT] = value * (1.0 if value > 0.1 else np.random.default_rng(1).standard_normal(len(own)))
    found = remainder_of_model(MODEL, [replace(samples, **still)], planted.CUTOFF, LINKS.ravel(), ())
    assert found is not None
    assert max(np.max(own) for own in found.basis.scales) <= LARGEST_SCALE
    assert all(np.all(np.abs(own) < 1e6) for own in (*found.means, *found.triangles))


def test_a_basis_of_other_features_is_refused() -> None:
    known = standing()
    scales = (known.basis.scales[0][1:], *known.basis.scales[1:])
    other = replace(known, basis=replace(known.basis, scales=scales))
    with pytest.raises(InputError, match=r"identify again"):
        _ = problem_of(recorded(2), other).features


def test_of_a_recording_that_is_too_short_nothing_is_known() -> None:
    short = recorded(1).select(slice(50))
    assert remainder_of_model(MODEL, [replace(short)], planted.CUTOFF, LINKS.ravel(), ()) is None
