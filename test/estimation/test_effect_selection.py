"""Optional effects are taken where a hidden truth has them, and hardly ever where it has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geomid_ros.estimation import effect_selection
from geomid_ros.estimation.coefficient_fit import CoefficientRows
from geomid_ros.estimation.estimate import EffectEstimate, Estimate
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.estimation.fit import CERTAINTY
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.trials import Trials
from geomid_ros.model.effects import DEFAULT_CANDIDATES, AtJoint, effect_class, identifiable
from geomid_ros.model.effects.friction import SMOOTHINGS, CoulombFriction
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.weighed_masses import WeighedRows, weighed_rows
from geomid_ros.session.configuration import Configuration
from geomid_ros.types import FloatArray, IntArray

from .arms import Case, Truth, arm, efforts, identifier, solved

NOISE = 0.05
SIZES = {
    "load_friction": 0.1,
    "stribeck_friction": 2.0,
    "saturating_friction": 2.0,
    "presliding": 0.3,
    "quadratic_friction": 0.5,
    "spring": 3.0,
    "coupled_viscous_friction": 0.7,
    "coupled_coulomb_friction": 1.0,
    "coupled_rotor_inertia": 0.2,
}
"""Of the planted coefficients, in SI units."""
OF_MOTOR = ("coupled_viscous_friction", "coupled_coulomb_friction", "coupled_rotor_inertia")
AT_ONE_JOINT = [name for name in DEFAULT_CANDIDATES if effect_class(name).place == "joint"]


def sign(speed: FloatArray) -> FloatArray:
    return np.tanh(speed / 0.02)


def added(effect: str, joint: int, case: Case, clean: FloatArray) -> FloatArray:
    """What an effect at a joint, or at this one and the next, adds to the efforts; by its equation."""
    moving, size = case.samples, SIZES[effect]
    q, v, a = (array[:, joint] for array in (moving.position, moving.velocity, moving.acceleration))
    single: dict[str, Callable[[], FloatArray]] = {
        "load_friction": lambda: size * np.abs(load(case)[:, joint]) * np.tanh(v / 0.003),
        "stribeck_friction": lambda: size * sign(v) * np.exp(-((v / 0.12) ** 2)),
        "saturating_friction": lambda: size * np.tanh(v / 0.6),
        "presliding": lambda: -2.0 * size * np.sign(v) * (v * a > 0.0) * np.exp(-(v**2) / np.abs(2.0 * a * 0.01)),
        "quadratic_friction": lambda: size * v * np.abs(v),
        "spring": lambda: size * q,
    }
    result = np.zeros_like(clean)
    if effect in single:
        result[:, joint] = single[effect]()
        return result
    both = {
        "coupled_viscous_friction": lambda: v + moving.velocity[:, joint + 1],
        "coupled_coulomb_friction": lambda: sign(v + moving.velocity[:, joint + 1]),
        "coupled_rotor_inertia": lambda: a + moving.acceleration[:, joint + 1],
    }
    result[:, joint] = result[:, joint + 1] = size * both[effect]()
    return result


def load(case: Case) -> FloatArray:
    """What the gears transmit ``(N, joints)``: the efforts of the true links alone."""
    return efforts(case.model.robot, Truth(case.true.links, {}), case.samples)  # type: ignore[arg-type]


@cache
def planted(name: str, joint: int, *effects: str, seed: int = 0) -> Case:
    """An arm with these effects beside the usual ones, whose model may have any of the candidates."""
    case = arm(name, seed, noise=NOISE)
    model = MeasurementModel(case.model.robot, case.effects, candidates=Configuration().candidates)
    measured = case.samples.effort + sum(added(effect, joint, case, case.noiseless) for effect in effects)
    return replace(case.with_efforts(measured), model=model)


@cache
def solved_as_planted(name: str, joint: int, *effects: str) -> Estimate:
    """The estimate of :func:`planted`."""
    return solved(planted(name, joint, *effects))


def chosen(found: Estimate) -> list[EffectEstimate]:
    return [effect for effect in found.effects if effect.name in DEFAULT_CANDIDATES]


@pytest.mark.parametrize(
    ("name", "joint", "effects"),
    # Joints 5 and 6 of the large arm are its wrist; no axes of the small one meet.
    [("arm7", 4, OF_MOTOR), *(("arm3", 1, (effect,)) for effect in AT_ONE_JOINT)],
)
def test_planted_effects_are_found_where_they_are(name: str, joint: int, effects: tuple[str, ...]) -> None:
    case = planted(name, joint, *effects)
    names = [one.name for one in case.model.robot.joints]
    place = f"{names[joint]}+{names[joint + 1]}" if effects == OF_MOTOR else names[joint]
    taken = chosen(solved_as_planted(name, joint, *effects))
    assert len(taken) <= len(effects) + 1
    found = {(one.name, one.joint): one for one in taken}
    for effect in effects:
        value = found[effect, place]
        assert value.value == pytest.approx(SIZES[effect], abs=max(4.0 * value.std, 0.1 * SIZES[effect]))


def test_a_motor_turns_two_joints_with_its_friction_or_not_at_all() -> None:
    """One of its effects alone is something else, whatever its size."""
    effect = "coupled_viscous_friction"
    assert not [one.name for one in chosen(solved(planted("arm7", 4, effect))) if one.name in OF_MOTOR]


def test_what_is_significant_must_be_visible_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Load-dependent friction of more than three standard deviations, by which its joint's residual hardly falls."""
    case = planted("arm3", 1)
    small = case.with_efforts(case.samples.effort + 0.04 * added("load_friction", 1, case, case.noiseless))
    assert not chosen(solved(small))
    monkeypatch.setattr(effect_selection, "_VISIBLE", 0.0)
    assert ("load_friction", "joint2") in {(one.name, one.joint) for one in chosen(solved(small))}


@pytest.mark.parametrize(("stiffness", "is_found"), [(0.2, False), (0.5, True)])
def test_a_spring_is_larger_than_errors_of_the_effort_that_links_need(stiffness: float, is_found: bool) -> None:
    """The smaller one is visible and repeats, but so is a gain of the drive that depends on the position."""
    case = planted("arm3", 1)
    change = np.zeros_like(case.samples.effort)
    change[:, 1] = stiffness * case.samples.position[:, 1]
    taken = chosen(solved(case.with_efforts(case.samples.effort + change)))
    assert [(one.name, one.joint) for one in taken] == [("spring", "joint2")] * is_found


def test_the_side_on_which_a_motor_turns_two_joints_is_exact() -> None:
    """What is known of a coupling, and beside it, does not depend on whether it might have been the other side."""
    case = planted("arm7", 4, *OF_MOTOR)
    motor = [identifiable()[name] for name in OF_MOTOR]  # on one side
    known = replace(case, model=MeasurementModel(case.model.robot, case.effects, candidates=motor))
    estimates = solved_as_planted("arm7", 4, *OF_MOTOR), solved(known)
    searched, told = ({(e.name, e.joint): e.std for e in found.effects} for found in estimates)
    assert searched == pytest.approx(told, rel=0.1)


def test_a_motor_that_turns_parallel_joints_is_told_from_an_inertia_by_the_prior_alone() -> None:
    """``c (a_1 + a_2)`` at both is what the outer link's inertia about their axis makes, which would have to be far
    from the prior. No such motor is looked for; who knows of one says so."""
    case = planted("arm3", 1, "coupled_rotor_inertia")
    assert not [c for c in case.model.coefficients if c.effect.name == "coupled_rotor_inertia"]
    known = identifiable()["coupled_rotor_inertia"]
    model = MeasurementModel(case.model.robot, [*case.effects, known])
    found = solved(replace(case, model=model))
    (taken,) = (effect for effect in chosen(found) if effect.joint == "joint2+joint3")
    assert taken.value == pytest.approx(SIZES["coupled_rotor_inertia"], rel=0.05)
    np.testing.assert_allclose(found.rms, NOISE, rtol=0.1)


@pytest.mark.parametrize(
    ("smoothing", "more", "rtol"),
    [(SMOOTHINGS[0], 1.0, 0.03), (SMOOTHINGS[-1], 1.0, 0.03), (0.004, 10.0, 0.01), (0.065, 10.0, 0.01)],
)
def test_dry_friction_passes_for_nothing_else(smoothing: float, more: float, rtol: float) -> None:
    """It turns within a speed that nobody told. Of a shape that is not tried many times the noise is left near rest; in
    motion its level is found all the same."""
    case = planted("arm3", 1)
    speeds, levels = case.samples.velocity, case.true.effects["coulomb_friction"] + more
    change = levels * np.tanh(speeds / smoothing) - (levels - more) * np.tanh(speeds / 0.02)
    found = solved(case.with_efforts(case.samples.effort + change))
    shapes = [effect for effect in found.effects if effect.name == "coulomb_friction"]
    assert smoothing not in SMOOTHINGS or [smoothing_of(effect) for effect in shapes] == 3 * [smoothing]
    np.testing.assert_allclose([effect.value for effect in shapes], levels, rtol=rtol)
    assert chosen(found) == []


def smoothing_of(effect: EffectEstimate) -> float:
    return effect.parameters["smoothing"].value if "smoothing" in effect.parameters else CoulombFriction().smoothing


def test_what_does_not_repeat_is_not_believed() -> None:
    """A spring in a quarter of the recording, large as it is."""
    case = planted("arm3", 1)
    quarter = np.arange(len(case.samples)) < len(case.samples) // 4
    spring = added("spring", 1, case, case.noiseless)
    everywhere = solved(case.with_efforts(case.samples.effort + 0.25 * spring))
    once = solved(case.with_efforts(case.samples.effort + quarter[:, None] * spring))
    assert "spring" in {one.name for one in chosen(everywhere)}
    assert "spring" not in {one.name for one in chosen(once)}


@pytest.mark.parametrize(("effect", "size"), [("load_friction", 1.5), ("spring", -3.0)])
def test_what_no_robot_has_is_not_taken(effect: str, size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """However well it explains the data: more friction than load, or a spring that pushes away."""
    monkeypatch.setitem(SIZES, effect, size)
    planted.cache_clear()
    found = solved(planted("arm3", 1, effect))
    assert effect not in {one.name for one in chosen(found)}
    planted.cache_clear()


def test_hardly_anything_is_taken_where_there_is_nothing() -> None:
    """Three standard deviations are one in 400 for a single candidate by chance."""
    cases = [("arm3", 1, seed) for seed in range(4)] + [("arm7", 3, 0)]
    taken = [chosen(solved(planted(name, joint, seed=seed))) for name, joint, seed in cases]
    assert sum(map(len, taken)) <= 1


def beside(case: Case, parameters: FloatArray) -> Estimate:
    """What is chosen where these effects were chosen before."""
    return identifier(case).solve(WarmStart(parameters, effects_alone=True))


def test_the_choice_is_determined_by_the_rows_and_kept_by_a_warm_start() -> None:
    case, one = planted("arm3", 1, "spring"), solved_as_planted("arm3", 1, "spring")
    for again in (solved(case), beside(case, one.parameters)):
        np.testing.assert_array_equal(again.parameters, one.parameters)
    warm = identifier(case).solve(WarmStart(one.parameters, one.rows_accepted))
    np.testing.assert_allclose(warm.parameters, one.parameters, rtol=1e-6, atol=1e-9)
    assert [effect.name for effect in warm.effects] == [effect.name for effect in one.effects]


def test_what_was_chosen_before_goes_if_nothing_asks_for_it_any_more() -> None:
    """One coefficient that stands for nothing, beside one that is right: the choice begins from nothing."""
    case = planted("arm3", 1, "spring")
    expected = solved_as_planted("arm3", 1, "spring").parameters
    parameters = expected.copy()
    parameters[np.setdiff1d(columns(case, ("saturating_friction", 2)), columns(case))] = 1.0
    again = beside(case, parameters)
    assert [(one.name, one.joint) for one in chosen(again)] == [("spring", case.model.robot.joints[1].name)]
    np.testing.assert_array_equal(again.parameters, expected)


# --- what the choice goes by ----------------------------------------------------------------------------------------


def problem(case: Case) -> Problem:
    summary = identifier(case).snapshot()
    channels = len(case.model.channels)
    return Problem(case.model, summary, None, weighed_rows(case.model, ()), np.full(channels, np.nan), None, 1.0)


def columns(case: Case, *more: tuple[str, int]) -> IntArray:
    """The parameters that are not optional, and the first coefficients of these effects at these joints."""
    own = [k for k, c in enumerate(case.model.coefficients) if not c.optional]
    for name, joint in more:
        places = [case.model.robot.joints[joint].name == c.place_name for c in case.model.coefficients]
        named = [c.effect.name == name for c in case.model.coefficients]
        own.append(int(np.flatnonzero(np.array(places) & named)[0]))
    first = case.model.dimension - len(case.model.coefficients)
    return np.concatenate([np.arange(first), first + np.sort(own)])


def test_the_marginal_likelihood_rises_with_a_planted_effect_and_falls_with_others() -> None:
    effect = "load_friction"
    case = planted("arm3", 1, effect)
    rows = CoefficientRows(problem(case))
    without = rows.fit(columns(case))
    scores = {
        (name, joint): rows.fit(columns(case, (name, joint)), without).score
        for name in ("load_friction", "saturating_friction", "spring")
        for joint in range(3)
    }
    assert min(scores, key=lambda place: scores[place]) == (effect, 1)
    assert scores[effect, 1] < without.score - 100.0
    true = rows.fit(columns(case, (effect, 1)), without)
    for name in {"load_friction", "saturating_friction", "spring"} - {effect}:
        beside = rows.fit(columns(case, (effect, 1), (name, 2)), true).score
        assert beside > true.score - 12.0


def test_spreads_of_links_are_their_distances_from_the_prior_and_what_is_unsure_of_them() -> None:
    """As in the fit that follows, roughly; the covariance by its principal directions."""
    case = planted("arm3", 1)
    rows = CoefficientRows(problem(case))
    fitted = rows.fit(columns(case)).fit
    manifold, prior = fitted.objective.manifold, fitted.objective.profile.prior
    values, vectors = np.linalg.eigh(fitted.hessian)
    links = manifold.inertial
    squares = manifold.log(prior, fitted.point)[links] ** 2 + np.sum(vectors**2 / values, axis=1)[links]
    usual = rows.problem.default_stds
    expected = np.sqrt((np.sum(squares.reshape(-1, 10), axis=1) + CERTAINTY * usual**2) / (10.0 + CERTAINTY))
    np.testing.assert_allclose(fitted.scales, expected, rtol=0.02)


def test_what_a_column_promises_is_what_a_fit_with_it_finds() -> None:
    """To first order, its gain in likelihood."""
    case, effect = planted("arm3", 1), "saturating_friction"
    small = replace(
        case, samples=replace(case.samples, effort=case.samples.effort + 0.02 * added(effect, 1, case, case.noiseless))
    )
    rows = CoefficientRows(problem(small))
    without = rows.fit(columns(small))
    (column,) = np.setdiff1d(columns(small, (effect, 1)), columns(small))
    larger = rows.fit(columns(small, (effect, 1)), without)
    (gain,) = without.gains(np.array([column]))
    assert gain == pytest.approx(without.score - larger.score, rel=0.3)


def test_friction_that_would_drive_is_not_there_in_a_trial() -> None:
    case, effect = planted("arm3", 1), "saturating_friction"
    driven = case.with_efforts(case.samples.effort - 0.02 * added(effect, 1, case, case.noiseless))
    rows, own = CoefficientRows(problem(driven)), columns(driven)
    present, column = rows.fit(own), np.setdiff1d(columns(driven, (effect, 1)), own)
    (trial,) = Trials(present, column).trials([np.append(own, column)])
    assert trial.values.tolist() == [0.0]
    assert trial.score == pytest.approx(present.score, abs=1e-6)


@pytest.mark.parametrize(("prior_std", "tied"), [(1.0, 0.0), (0.2, 0.0), (1.0, 300.0)])
def test_a_trial_is_a_fit_to_second_order(prior_std: float, tied: float) -> None:
    """Its score, for a small effect that is added, and for another shape of one; the links' prior stds are given. A
    prior may tie all parameters to each other."""
    case = planted("arm3", 1)
    small = case.with_efforts(case.samples.effort + 0.02 * added("spring", 1, case, case.noiseless))
    free = problem(small)
    tie = tied / np.append(np.full(free.manifold.inertial.stop, 10.0), free.scales)[None]
    rows, own = CoefficientRows(free.with_known_rows(WeighedRows(tie, tie @ free.prior))), columns(small)
    present = rows.fit(own, prior_stds=prior_std * rows.problem.default_stds)
    shapes = next(rows.shapes[m] for m in rows.mechanisms(own) if m[:2] == ("coulomb_friction", AtJoint(1)))
    (used,), (spring,) = np.intersect1d(shapes, own), np.setdiff1d(columns(small, ("spring", 1)), own)
    nearest = shapes[shapes.index(used) + 1]
    choices = [np.append(own, spring), np.append(np.setdiff1d(own, used), nearest)]
    for columns_, trial in zip(choices, Trials(present, np.unique([*shapes, spring])).trials(choices), strict=True):
        fitted = rows.fit(np.sort(columns_), present, prior_stds=present.fit.scales)
        assert trial.all_columns.tolist() == sorted(columns_.tolist())
        assert trial.score - present.score == pytest.approx(fitted.score - present.score, rel=0.02, abs=0.1)
        assert abs(fitted.score - present.score) > 10.0
        remaining = np.min((fitted.residual_squares / present.residual_squares)[rows.fast])
        assert (trial.leaves_less(0.99 - remaining), trial.leaves_less(1.01 - remaining)) == (True, False)
