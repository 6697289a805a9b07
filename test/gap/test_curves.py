"""Free curves: the functions of which they are made, by other ways to compute them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import eval_legendre

from geomid_ros.gap.evidence.curves import Curves
from geomid_ros.types import FloatArray

from . import planted

MODEL = planted.model()
NAMES = MODEL.robot.joint_names
JOINT, COUNT = 1, 2000
RNG = np.random.default_rng(4)
POSITION, VELOCITY, LOAD = RNG.normal(size=(3, COUNT, 3))
SIGN = np.sign(VELOCITY)
STAMPS = 5_000_000_000 + np.sort(RNG.integers(0, 10**10, COUNT))
SITUATION: Any = SimpleNamespace(predicted=LOAD, sign=SIGN)


def records(position: FloatArray = POSITION, split: int = 700) -> Any:
    """Two stretches, of which the second begins at ``split``."""
    samples = SimpleNamespace(stamps=STAMPS, position=position, velocity=VELOCITY)
    dense = [SimpleNamespace(stamps=STAMPS[:split]), SimpleNamespace(stamps=STAMPS[split:])]
    return SimpleNamespace(samples=samples, dense=dense, segment=(np.arange(COUNT) >= split).astype(int))


CURVES = Curves(MODEL, records(), SITUATION)
COLUMNS = CURVES.columns(records(), SITUATION)


def matrix(name: str, joint: int = JOINT) -> FloatArray:
    """The columns of a curve; it reaches its own joint alone."""
    (found,) = (c for c in CURVES.candidates if (c.curve, c.joint) == (name, joint))
    for term in found.terms:
        assert list(COLUMNS[term]) == [joint]
    return np.column_stack([COLUMNS[term][joint] for term in found.terms])


def interpolated(values: FloatArray, heights: FloatArray) -> FloatArray:
    """A broken line with equal steps over all but a hundredth of the values, constant beyond."""
    ends = np.quantile(values, [0.005, 0.995])
    return np.interp(values, np.linspace(*ends, len(heights)), heights)


@pytest.mark.parametrize(
    ("kind", "values"), [("position", POSITION), ("velocity", VELOCITY), ("load", LOAD)], ids=["q", "v", "load"]
)
def test_a_curve_of_one_variable_is_any_broken_line_through_eight_points(kind: str, values: FloatArray) -> None:
    heights = RNG.normal(size=8)
    found = matrix(f"{kind} curve") @ heights
    np.testing.assert_allclose(found, interpolated(values[:, JOINT], heights), atol=1e-12)


@pytest.mark.parametrize(("kind", "values"), [("position", POSITION), ("load", LOAD)], ids=["q", "load"])
def test_friction_by_a_variable_is_a_broken_line_with_the_sign_of_motion(kind: str, values: FloatArray) -> None:
    heights = RNG.normal(size=5)
    expected = SIGN[:, JOINT] * interpolated(values[:, JOINT], heights)
    np.testing.assert_allclose(matrix(f"friction by {kind}") @ heights, expected, atol=1e-12)


def test_friction_by_velocity_is_a_curve_of_velocity_already() -> None:
    assert not [candidate for candidate in CURVES.candidates if candidate.curve == "friction by velocity"]


def test_waves_repeat_two_to_forty_eight_times_a_turn() -> None:
    """So they are the same a turn later, and any phase is a sum of both columns."""
    waves = [c for c in CURVES.candidates if c.curve.startswith("wave") and c.joint == JOINT]
    assert [c.curve for c in waves] == [f"wave {count}" for count in range(2, 49)]
    for count in (2, 7, 48):
        expected = np.sin(count * POSITION[:, JOINT] + 0.4)
        np.testing.assert_allclose(matrix(f"wave {count}") @ [np.cos(0.4), np.sin(0.4)], expected, atol=1e-12)


def test_courses_of_time_are_legendre_polynomials_from_the_first_to_the_last_instant() -> None:
    time = np.interp(STAMPS, [STAMPS[0], STAMPS[-1]], [-1.0, 1.0])
    np.testing.assert_allclose(matrix("drift")[:, 0], time, atol=1e-9)
    expected = np.column_stack([eval_legendre(order, time) for order in range(1, 5)])
    np.testing.assert_allclose(matrix("course"), expected, atol=1e-9)


def test_a_drift_begins_anew_with_every_stretch() -> None:
    drift = matrix("drift from the start")[:, 0]
    longest = max(STAMPS[699] - STAMPS[0], STAMPS[-1] - STAMPS[700])
    assert (drift[0], drift[700], np.max(drift)) == (0.0, 0.0, 1.0)
    np.testing.assert_allclose(drift[:700], (STAMPS[:700] - STAMPS[0]) / longest, atol=1e-12)


def test_another_joint_may_be_felt_by_its_speed_direction_and_position() -> None:
    other, own = POSITION[:, 0], POSITION[:, JOINT]
    np.testing.assert_array_equal(matrix(f"{NAMES[0]} speed")[:, 0], VELOCITY[:, 0])
    np.testing.assert_array_equal(matrix(f"{NAMES[0]} friction")[:, 0], SIGN[:, 0])
    cubic = 2.0 * other - other**2 + 0.5 * other**3
    np.testing.assert_allclose(matrix(f"{NAMES[0]} position") @ [2.0, -1.0, 0.5], cubic, atol=1e-12)
    angles = [other, other + own, other - own]
    for place, angle in enumerate(angles):
        weights = np.zeros(6)
        weights[2 * place : 2 * place + 2] = np.cos(0.3), np.sin(0.3)
        found = matrix(f"{NAMES[0]} and position") @ weights
        np.testing.assert_allclose(found, np.sin(angle + 0.3), atol=1e-12)
    assert not [c for c in CURVES.candidates if c.variable == NAMES[JOINT] and c.joint == JOINT]


def test_a_curve_counts_for_its_coefficients_and_one_more_and_one_of_many_for_two() -> None:
    """Of as good a name and curve the name is taken; of many waves one fits by chance."""
    for candidate in CURVES.candidates:
        assert candidate.penalty == len(candidate.terms) + (2 if candidate.curve.startswith("wave") else 1)


def test_a_curve_depends_on_the_variable_that_it_says() -> None:
    variables = {candidate.variable for candidate in CURVES.candidates if candidate.joint == JOINT}
    assert variables == {"position", "velocity", "load", "time", NAMES[0], NAMES[2]}


def test_on_other_records_a_curve_is_the_same_function() -> None:
    narrow = records(0.5 * POSITION)
    found = CURVES.columns(narrow, SITUATION)
    candidate = next(c for c in CURVES.candidates if (c.curve, c.joint) == ("position curve", JOINT))
    heights = RNG.normal(size=8)
    values = np.column_stack([found[term][JOINT] for term in candidate.terms]) @ heights
    knots = np.linspace(*np.quantile(POSITION[:, JOINT], [0.005, 0.995]), 8)
    np.testing.assert_allclose(values, np.interp(0.5 * POSITION[:, JOINT], knots, heights), atol=1e-12)


def test_of_unmeasured_efforts_there_are_no_curves() -> None:
    model: Any = SimpleNamespace(robot=MODEL.robot, layout=SimpleNamespace(efforts=()))
    silent = Curves(model, records(), SITUATION)
    assert silent.candidates == []
    assert silent.columns(records(), SITUATION) == {}
