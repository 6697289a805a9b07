"""Instants that the model can be blamed for: not those at which its own friction is uncertain."""

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.gap.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.records import FEWEST_ROWS, Records
from geomid_ros.inference.fit import fit_of_prior
from geomid_ros.model.effects import AtJoint, identified_effect
from geomid_ros.types import BoolArray

from . import planted

FLOOR = np.full(3, planted.NOISE)
MODEL, INERTIAS = planted.model(), planted.true_inertias(2, 0.1)
RECORDS = Records.make([planted.recording(planted.rigid(INERTIAS), 2)], planted.CUTOFF)


def problem(joint: int, level: float, floor: float = 1.0) -> LinearisedProblem:
    """With Coulomb friction of a level at a joint, where the noise is so many times the planted one."""
    friction = (identified_effect("coulomb_friction"), AtJoint(joint), np.array([level]))
    total = replace(total_model(MODEL, fit_of_prior(planted.prior(INERTIAS))), effects=(friction,))
    return LinearisedProblem(MODEL, RECORDS, total, floor * FLOOR)


def valid(joint: int, level: float, floor: float = 1.0) -> BoolArray:
    """The valid instants of that problem."""
    return problem(joint, level, floor).valid


def test_noise_by_which_hardly_an_instant_counts_is_not_told() -> None:
    """It is what few rows leave: by it fewer count, which leave less, until nothing is judged there."""
    before = problem(2, 2.0)
    left = FLOOR * [0.9, 0.9, 0.0]
    assert np.count_nonzero(before.with_floor(left).valid[:, 2]) < FEWEST_ROWS < np.count_nonzero(before.valid[:, 2])
    floor, told = before.identifiable_floor(left)
    np.testing.assert_array_equal(told, [True, True, False])
    np.testing.assert_array_equal(floor, np.where(told, left, before.floor))
    for other in (before, before.with_floor(np.full(3, np.inf))):
        floor, told = other.identifiable_floor(0.9 * FLOOR)
        np.testing.assert_array_equal(floor, 0.9 * FLOOR)
        assert np.all(told)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_the_more_friction_for_the_noise_the_fewer_instants_count(joint: int) -> None:
    sets = [valid(joint, level)[:, joint] for level in (0.0, 0.1, 1.0, 10.0)]
    for smaller, larger in zip(sets[1:], sets, strict=False):
        assert np.all(larger[smaller])
        assert np.count_nonzero(smaller) < np.count_nonzero(larger)
    np.testing.assert_array_equal(sets[0], RECORDS.usable(MODEL, MODEL.rows(RECORDS.samples).targets)[:, joint])
    np.testing.assert_array_equal(valid(joint, 10.0, floor=10.0)[:, joint], sets[2])


def test_what_is_left_out_is_near_reversals_of_the_joint() -> None:
    without, with_friction = valid(2, 0.0)[:, 2], valid(2, 2.0)[:, 2]
    out = without & ~with_friction
    assert np.any(out)
    speed = np.abs(RECORDS.samples.velocity[:, 2])
    assert np.median(speed[out]) < 0.2 * np.median(speed[with_friction])


def test_a_reversal_reaches_the_joint_that_its_acceleration_loads() -> None:
    """Joints 2 and 3 of the arm turn about parallel axes."""
    lost = np.count_nonzero(valid(2, 0.0) & ~valid(2, 0.5), axis=0)
    assert lost[1] > 0.3 * lost[2] > 0
