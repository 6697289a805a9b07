"""How often a motion comes back: against motions whose repeats are known, and how much of it counts then."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.estimation.identifier import BufferSettings, Identifier
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.visited_states import VisitedStates
from geomid_ros.model.weighed_masses import weighed_rows
from geomid_ros.types import FloatArray

from .arms import arm

PERIOD = 0.01


def visited(states: FloatArray, apart: float = 0.0) -> VisitedStates:
    found = VisitedStates(apart)
    found.add(states, np.full(len(states), PERIOD))
    return found


def wandering(count: int, size: int = 6) -> FloatArray:
    """A smooth motion that does not come back."""
    seconds = PERIOD * np.arange(count)[:, None]
    rates = np.sqrt(np.arange(2.0, 2.0 + size))
    return np.asarray(np.sin(rates * seconds + np.arange(size)) + 0.1 * seconds)


@pytest.mark.parametrize("cycles", [2, 7, 20])
def test_of_a_cycle_that_repeats_each_state_counts_about_once(cycles: int) -> None:
    noise = 1e-6 * np.random.default_rng(0).normal(size=(40 * cycles, 4))
    phase = 2.0 * np.pi * np.arange(40 * cycles)[:, None] / 40.0
    states = np.sin(phase + np.arange(4.0)) + noise
    # Of the other cycles those states count, too, that are a little before and after.
    assert 1.0 / (3 * cycles) < visited(states).distinct <= 1.0 / cycles + 1e-3


def test_a_motion_that_does_not_come_back_has_as_many_states_as_instants() -> None:
    assert visited(wandering(1000)).distinct == pytest.approx(1.0, abs=0.02)


def test_a_robot_that_stands_is_in_few_states() -> None:
    states = np.random.default_rng(0).normal(size=(1000, 6))
    assert visited(states).distinct < 0.1


def test_units_and_constant_coordinates_do_not_matter() -> None:
    phase = 2.0 * np.pi * np.arange(200)[:, None] / 37.3
    states = np.sin(phase + np.arange(4.0))
    other = np.column_stack([states * [1.0, 1024.0, 0.125, 8.0], np.full(200, 0.75)])
    assert visited(other).distinct == visited(states).distinct


def test_only_states_that_are_so_far_apart_in_time_count() -> None:
    states = wandering(1000)
    alone, every = visited(states[::5]), visited(states, 5 * PERIOD)
    np.testing.assert_allclose(every.kept[:, 0], alone.kept[:, 0])


def test_no_more_than_some_are_kept_and_they_tell_the_same() -> None:
    rng = np.random.default_rng(0)
    phase = 2.0 * np.pi * (np.arange(6000)[:, None] / 41.3)
    states = np.sin(phase + np.arange(4.0)) + 1e-3 * rng.normal(size=(6000, 4))
    found = visited(states)
    assert len(found.kept) <= 1024
    assert found.every > 1
    assert found.distinct == pytest.approx(visited(states[:900]).distinct * 900 / 6000, rel=0.5)


def test_pieces_and_the_whole_are_the_same() -> None:
    states, pieces = wandering(300), VisitedStates()
    for piece in np.array_split(states, 7):
        pieces.add(piece, np.full(len(piece), PERIOD))
    np.testing.assert_array_equal(pieces.kept, visited(states).kept)


def test_the_same_motion_in_two_recordings_is_one() -> None:
    states = wandering(300)
    both = visited(states)
    both.plus(visited(states).kept, 1)
    assert both.distinct == pytest.approx(0.5, abs=0.02)


def repeated(times: int, seconds: float, forgetting_time: float = np.inf) -> Problem:
    """Of a motion of an arm that is repeated so many times."""
    case = arm("arm3", seed=3, seconds=seconds)
    found = Identifier(case.model, buffer=BufferSettings(forgetting_time=forgetting_time))
    for _ in range(times):
        found.add(case.samples)
    summary, unknown = found.snapshot(), np.full(len(case.model.channels), np.nan)
    return Problem(case.model, summary, None, weighed_rows(case.model, ()), unknown, None, 1.0)


def test_rows_of_states_that_differ_count() -> None:
    assert repeated(1, seconds=3.0).distinct == pytest.approx(1.0, abs=0.01)


def test_repeats_count_the_less_the_more_of_their_states_parameters_follow() -> None:
    """From what one passage says to nearly all that all say together; the noise is small, so all rows are followed."""
    shares = [repeated(20, seconds).distinct for seconds in (0.03, 0.1, 1.0, 5.0)]
    once = repeated(20, 0.03).summary.visited.distinct
    assert once < 0.1
    assert once <= shares[0] < 0.3
    assert shares == sorted(shares)
    assert shares[-1] > 0.85


def test_repeats_of_what_is_forgotten_do_not_count() -> None:
    assert repeated(20, seconds=0.03, forgetting_time=0.03).distinct == 1.0
