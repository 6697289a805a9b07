"""From samples to the truth: an arm with hidden inertias and effects, felt through pinocchio's RNEA and noise."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geomid_ros.estimation import estimator
from geomid_ros.estimation.estimate import Estimate, interval_of_positive
from geomid_ros.estimation.estimator import WarmStart, estimate
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

from .arms import ALL_EFFECTS, Case, Truth, arm, efforts, identifier, solved, summary, without_gains

NOISE = 0.05


@cache
def standard() -> tuple[Case, Estimate]:
    """With nothing configured."""
    case = arm("arm7", 0, noise=NOISE)
    return case, solved(case)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_predictions_of_a_fresh_motion_are_about_as_good_as_the_noise() -> None:
    """That is: the base parameters, the combinations of inertias that can be known, are found."""
    case, found = standard()
    fresh = case.fresh(0)
    assert found.converged
    assert rms(fresh.error(found.parameters)) < 2.0 * NOISE
    nominal = np.concatenate([case.model.nominal_inertias, np.zeros(len(case.model.coefficients))])
    assert rms(fresh.error(found.parameters)) < 0.05 * rms(fresh.error(nominal))
    np.testing.assert_allclose(found.rms, NOISE, rtol=0.4)  # the prior's pull is in it
    np.testing.assert_allclose(found.rms_nominal, case_rms(case, nominal), rtol=1e-9)
    np.testing.assert_allclose(found.rms, case_rms(case, *found.predictor), rtol=1e-9)


def case_rms(case: Case, *model: FloatArray) -> FloatArray:
    measured, predicted = case.model.predict(case.samples, *model)
    return np.sqrt(np.mean((measured - predicted) ** 2, axis=0))


def test_effects_are_recovered() -> None:
    case, found = standard()
    tolerances = {"viscous_friction": 0.1, "coulomb_friction": 0.1, "rotor_inertia": 0.05, "effort_offset": 0.15}
    truth = case.truth[len(case.model.nominal_inertias) :]
    for effect, value in zip(without_gains(found.effects), truth, strict=True):
        if effect.from_data > 0.9:
            assert effect.value == pytest.approx(value, abs=tolerances[effect.name]), (effect.name, effect.joint)
    assert all(effect.from_data > 0.5 for effect in found.effects)


def test_links_are_possible_and_described_consistently() -> None:
    case, found = standard()
    for place, link in enumerate(found.links):
        ten = found.parameters[10 * place : 10 * place + 10]
        np.testing.assert_array_equal(link.parameters, ten)
        pseudo = pseudo_inertia.from_parameters(ten)
        nominal = pseudo_inertia.from_parameters(case.model.nominal_inertias[10 * place : 10 * place + 10])
        assert np.linalg.eigvalsh(pseudo)[0] > 0.0
        assert link.mass == pytest.approx(ten[0])
        np.testing.assert_allclose(link.mass * link.com, ten[1:4], rtol=1e-12)
        np.testing.assert_allclose(link.inertia, pseudo_inertia.central_inertia(ten), rtol=1e-9, atol=1e-12)
        assert link.distance_from_prior == pytest.approx(float(spd.distance(nominal, pseudo)), rel=1e-6)
        ratio = np.min(np.linalg.eigvals(np.linalg.solve(nominal, pseudo)).real)
        assert link.min_eigenvalue_ratio == pytest.approx(ratio, rel=1e-9)
        assert link.name == case.model.body_names[place]
        assert 0.0 <= link.from_data <= 1.0
    assert [effect.joint for effect in without_gains(found.effects)] == [c.place_name for c in case.model.coefficients]
    assert found.channels == tuple(joint.name for joint in case.model.robot.joints)
    assert found.rows_accepted == case.samples.effort.size


def test_a_channel_with_one_row_does_not_spoil_the_others() -> None:
    """Found by breaking it: one row, met exactly, got all the weight."""
    case = arm("arm3", 0)
    silent, few = case.samples.effort.copy(), case.samples.effort.copy()
    silent[:, 2], few[1:, 2] = np.nan, np.nan
    without, found = solved(case.with_efforts(silent)), solved(case.with_efforts(few))
    np.testing.assert_allclose(case.error(found.parameters)[:2], case.error(without.parameters)[:2], atol=0.3 * NOISE)


def test_a_subset_of_links_is_found_while_the_others_stay() -> None:
    links = ("link5", "link7")
    case = arm("arm7", 3, links=links)
    found = solved(case)
    assert tuple(link.name for link in found.links) == links
    assert rms(case.fresh(3).error(found.parameters)) < 2.0 * NOISE
    assert len(found.parameters) == case.model.dimension == 10 * len(links) + 4 * len(case.model.robot.joints)


def test_a_prior_that_is_the_truth_is_kept() -> None:
    case = arm("arm7", 2)
    found = identifier(case, prior=case.truth, gamma=1e-2).solve()
    assert rms(case.fresh(2).error(found.parameters)) < 0.3 * NOISE
    assert all(link.distance_from_prior < 0.1 for link in found.links)
    partly = np.where(np.arange(case.model.dimension) < 10, case.truth, np.nan)
    known = identifier(case, prior=partly, gamma=1e3).solve()
    np.testing.assert_allclose(known.links[0].parameters, case.truth[:10], rtol=1e-2, atol=1e-4)


def test_a_warm_start_from_half_of_the_data_reaches_the_minimum_of_all() -> None:
    case, _ = standard()
    half = len(case.samples) // 2
    growing = Identifier(case.model)
    growing.add(case.samples.select(slice(0, half)))
    first = growing.solve()
    growing.add(case.samples.select(slice(half, None)))
    warm = growing.solve(WarmStart(first.parameters))
    np.testing.assert_allclose(warm.parameters, standard()[1].parameters, rtol=1e-6, atol=1e-9)


def test_a_configured_sigma_sets_a_channels_weight() -> None:
    case = arm("arm3", 0)
    bias = case.with_efforts(case.samples.effort * [1.0, 1.3, 1.0])
    trusted = solved(bias, sigma={"joint1": 100.0, "joint3": 100.0, "joint2": 0.05})
    np.testing.assert_allclose(trusted.sigmas, [100.0, 0.05, 100.0])
    distrusted = solved(bias, sigma={"joint2": 100.0})
    assert trusted.rms[1] < 1.5 * NOISE
    assert distrusted.rms[1] > 10 * NOISE
    assert np.all(distrusted.rms[[0, 2]] < 1.5 * NOISE)


def test_dry_friction_of_a_joint_that_never_moves_has_any_value() -> None:
    """Its offset is no better known than that, though all of its rows agree; what no motion shows may be as large."""
    case, stiction = arm("arm3", 0), 2.0
    still = np.array([False, False, True])
    motion = {name: getattr(case.samples, name) for name in ("position", "velocity", "acceleration")}
    moving = replace(case.samples, **{name: np.where(still, 0.0, values) for name, values in motion.items()})
    felt = efforts(case.model.robot, case.true, moving) + stiction * still
    found = solved(replace(case, samples=replace(moving, effort=felt)))
    at_joint = [effect for effect in without_gains(found.effects) if effect.joint == "joint3"]
    *unseen, offset = sorted(at_joint, key=lambda effect: effect.name == "effort_offset")
    assert abs(offset.value - case.true.effects["effort_offset"][2]) < 4.0 * offset.std
    assert len(unseen) == 3
    assert all(effect.std > stiction for effect in unseen)
    assert max(abs(effect.value) for effect in found.effects) < 10.0, "no friction of tonnes"
    assert any(text.startswith("never measured in motion: 'joint3';") for text in found.warnings)


def test_a_link_is_no_better_known_than_a_rotor_that_is_one_with_it() -> None:
    """The first link turns about a vertical axis; its URDF inertia about that is as large as both together."""
    usual = arm("arm3", 1)
    robot = Robot(re.sub(r'(?<=mass value="2.2"/>)\s*<inertia [^>]*>', _ROUND, usual.model.robot.urdf))
    links = np.array([body.parameters for body in robot.bodies])
    links[0, 4:] *= 0.4
    rotors = usual.true.effects["rotor_inertia"] + np.array([0.3, 0.0, 0.0])
    felt = efforts(robot, Truth(links, {**usual.true.effects, "rotor_inertia": rotors}), usual.samples)
    noise = NOISE * np.random.default_rng(1).normal(size=felt.shape)
    model = MeasurementModel(robot, usual.effects)
    found = solved(replace(usual, model=model).with_efforts(felt + noise))
    rotor = next(effect for effect in found.effects if effect.name == "rotor_inertia")
    assert found.links[0].std[9] > 0.75 * rotor.std


def test_intervals_of_masses_hold_the_truth_where_the_urdf_has_placeholders() -> None:
    """Of 1 kg and some centimetres. The nearest bodies with the first moments that gravity shows are thin."""
    case = arm("arm3", 0)
    true, prior = case.model.nominal_parameters, np.full(case.model.dimension, np.nan)
    prior[:30] = np.tile([1.0, 0.0, 0.0, 0.0, 1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3], 3)
    rows = case.model.rows(case.samples).coefficients
    targets = rows @ true + 1e-2 * np.random.default_rng(1).normal(size=rows.shape[:2])
    found = estimate(case.model, summary(case.model, rows, targets), prior=prior)
    for link, mass in zip(found.links, true[:30:10], strict=True):
        assert abs(np.log(mass / link.mass)) < 4.0 * link.std_mass / link.mass


@pytest.mark.parametrize(("seed", "factor", "cogging"), [(3, 1.0, 1.0), (1, 6.0, 0.0)])
def test_a_mass_that_nothing_contradicts_is_near_the_urdf_and_no_surer_for_that(
    seed: int, factor: float, cogging: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Motors that cog drive links away, their masses by a factor of up to fifteen. A link that is truly six times as
    heavy, of which the data tell almost only the first moment, comes back as well: its interval says so. A warm start
    ends at the same."""
    case = arm("arm7", seed)
    links = case.true.links.copy()
    links[5] *= factor
    position = case.samples.position
    clean = efforts(case.model.robot, Truth(links, case.true.effects), case.samples) + cogging * np.sin(6.0 * position)
    noise = 0.1 * np.random.default_rng(seed).normal(size=clean.shape)
    case = replace(case, samples=replace(case.samples, effort=clean + noise))
    held = solved(case)
    off = np.abs(np.log([link.mass for link in held.links] / links[:, 0]))
    for link, mass in zip(held.links, links[:, 0], strict=True):
        assert abs(link.mass - mass) < 4.0 * link.std_mass
    warm = identifier(case).solve(WarmStart(held.parameters, held.rows_accepted, held.prior_stds))
    np.testing.assert_allclose([link.mass for link in warm.links], [link.mass for link in held.links], rtol=1e-4)
    if cogging:
        monkeypatch.setattr(estimator, "_uncontradicted_masses", lambda *_: iter(()))
        driven = np.abs(np.log([link.mass for link in solved(case).links] / links[:, 0]))
        assert np.max(off) < 0.6 * np.max(driven)


_ROUND = '<inertia ixx="0.5" ixy="0" ixz="0" iyy="0.5" iyz="0" izz="0.5"/>'


def test_samples_counted_twice_change_nothing_but_the_count() -> None:
    case = arm("arm3", 0, seconds=10)
    twice = replace(case, samples=case.samples.select(np.repeat(np.arange(len(case.samples)), 2)))
    one, two = solved(case, gamma=1e-3, sigma=SIGMAS), solved(twice, gamma=1e-3, sigma=SIGMAS)
    np.testing.assert_allclose(two.parameters, one.parameters, rtol=1e-6, atol=1e-9)
    assert two.rows_accepted == 2 * one.rows_accepted


SIGMAS = {"joint1": 0.05, "joint2": 0.05, "joint3": 0.05}


def test_the_truth_is_as_likely_as_the_information_on_the_links_says() -> None:
    """Its residuals are noise of standard deviation 1, as many as it determines directions: chi-squared."""
    case, found = standard()
    known, links = found.information, 10 * len(case.model.identified)
    assert known.rows.shape == (links, links)
    off = known.residuals + known.rows @ (case.truth - found.parameters)[:links]
    determined = np.abs(np.diag(known.rows)) > 1e-6 * np.max(known.rows)
    rank = int(np.sum(determined))
    assert links / 3 < rank < links
    assert abs(float(np.sum(off[determined] ** 2)) / rank - 1.0) < 4.0 * np.sqrt(2.0 / rank)


def test_a_wrench_sensor_that_feels_no_identified_link_tells_nothing() -> None:
    """It carries the tool alone, whose inertia is the URDF's."""
    case = arm("arm3", 0, noise=NOISE)
    robot = Robot(case.model.robot.urdf, cuts=("wrist_ft",))
    effects = [identifiable()[name] for name in ALL_EFFECTS]
    wrenches = np.random.default_rng(1).normal(size=(len(case.samples), 1, 6))
    sensor = WrenchSensor("/wrench", "wrist_ft", "mounted")
    with_it = replace(
        case,
        model=MeasurementModel(robot, effects, (sensor,), links=("link2", "link3")),
        samples=replace(case.samples, wrenches=wrenches),
    )
    without = replace(case, model=MeasurementModel(robot, effects, links=("link2", "link3")))
    found, expected = solved(with_it), solved(without)
    assert found.gamma == pytest.approx(expected.gamma, rel=1e-6)
    np.testing.assert_allclose(found.parameters, expected.parameters, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.sigmas[:3], expected.sigmas)
    np.testing.assert_array_equal(found.rms[3:], found.rms_nominal[3:])


def test_intervals_of_positive_quantities_are_those_of_the_logarithm() -> None:
    """They stay positive, and are symmetric where little is unknown."""
    low, high = interval_of_positive(2.0, 4.0)
    assert 0.0 < low < 2.0 < high
    assert np.log(high / 2.0) == pytest.approx(np.log(2.0 / low)) == pytest.approx(1.96 * 2.0)
    assert interval_of_positive(2.0, 1e-4) == pytest.approx((2.0 - 1.96e-4, 2.0 + 1.96e-4), abs=1e-8)
    assert interval_of_positive(2.0, np.inf) == (2.0, 2.0)
