"""How often a motion comes back: against motions whose repeats are known, and how much of it counts then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.identifier import BufferSettings, Identifier
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.visited_states import Visits
from geomid_ros.model.weighed_masses import weighed_rows
from geomid_ros.types import FloatArray

from .arms import arm

PERIOD = 0.01


def visited(states: FloatArray, apart: float = 0.0) -> Visits:
    return Visits(age=apart).with_states(states, np.full(len(states), PERIOD), apart)


def wandering(count: int, size: int = 6) -> FloatArray:
    """A smooth motion that does not come back."""
    seconds = PERIOD * np.arange(count)[:, None]
    rates = np.sqrt(np.arange(2.0, 2.0 + size))
    return np.asarray(np.sin(rates * seconds + np.arange(size)) + 0.1 * seconds)


@pytest.mark.parametrize("cycles", [2, 20])
def test_of_a_cycle_that_repeats_each_state_counts_about_once(cycles: int) -> None:
    noise = 1e-6 * np.random.default_rng(0).normal(size=(40 * cycles, 4))
    phase = 2.0 * np.pi * np.arange(40 * cycles)[:, None] / 40.0
    states = np.sin(phase + np.arange(4.0)) + noise
    # Of the other cycles those states count, too, that are a little before and after.
    assert 1.0 / (3 * cycles) < visited(states).distinct <= 1.0 / cycles + 1e-3


@pytest.mark.parametrize("period", [317.3, 64])
def test_cycles_are_found_whatever_share_of_the_states_is_kept(period: float) -> None:
    cycles = 60
    phase = 2.0 * np.pi * np.arange(round(cycles * period))[:, None] / period
    noise = 1e-3 * np.random.default_rng(0).normal(size=(len(phase), 4))
    found = visited(np.sin(phase + np.arange(4.0)) + 0.5 * np.sin(2.0 * phase + 2.0 * np.arange(4.0)) + noise)
    assert found.every > 2
    assert 1.0 / (3 * cycles) < found.distinct < 6.0 / cycles


def test_a_motion_that_does_not_come_back_has_as_many_states_as_instants() -> None:
    assert visited(wandering(1000)).distinct == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("count", [300, 5000])
def test_pieces_and_the_whole_are_the_same(count: int) -> None:
    states, pieces = wandering(count), Visits()
    for piece in np.array_split(states, count // 43):
        pieces = pieces.with_states(piece, np.full(len(piece), PERIOD), 0.0)
    np.testing.assert_array_equal(pieces.kept, visited(states).kept)


def test_the_same_motion_in_two_recordings_is_one() -> None:
    states = wandering(300)
    both = visited(states).plus(visited(states))
    assert both.distinct == pytest.approx(0.5, abs=0.02)


def test_a_place_that_is_passed_the_other_way_is_another_state() -> None:
    case = arm("arm3", seed=3, seconds=3.0)
    back = replace(case.samples, position=case.samples.position[::-1], velocity=-case.samples.velocity[::-1])
    found = Identifier(case.model)
    for samples in (case.samples, replace(back, acceleration=case.samples.acceleration[::-1])):
        found.add(samples)
    assert found.snapshot().visited.distinct == pytest.approx(1.0, abs=0.01)


def test_a_snapshot_and_one_that_goes_on_have_their_own() -> None:
    case = arm("arm3", seed=3, seconds=3.0)
    found, later = Identifier(case.model), Identifier(case.model)
    found.add(case.samples)
    before, memory = found.snapshot(), found.memory()
    later.restore(memory)
    assert later.snapshot().visited.distinct == before.visited.distinct
    np.testing.assert_array_equal(later.snapshot().visited.kept, before.visited.kept)
    kept = before.visited.kept.copy()
    for each in (found, later):
        each.add(case.samples)
    np.testing.assert_array_equal(before.visited.kept, kept)
    np.testing.assert_array_equal(later.snapshot().visited.kept, found.snapshot().visited.kept)


@pytest.mark.parametrize("shape", [(5, 3, 8), (5,)])
def test_states_of_another_robot_are_refused(shape: tuple[int, ...]) -> None:
    case = arm("arm3", seed=3, seconds=1.0)
    found = Identifier(case.model)
    found.add(case.samples)
    memory = found.memory()
    visits = replace(memory.summary.visited, kept=np.zeros(shape))
    with pytest.raises(InputError, match="states of the motion"):
        found.restore(replace(memory, summary=replace(memory.summary, visited=visits)))


def repeated(times: int, seconds: float, forgetting_time: float = np.inf) -> Problem:
    """Of a motion of an arm that is repeated so many times."""
    case = arm("arm3", seed=3, seconds=seconds)
    found = Identifier(case.model, buffer=BufferSettings(forgetting_time=forgetting_time))
    for _ in range(times):
        found.add(case.samples)
    summary, unknown = found.snapshot(), np.full(len(case.model.channels), np.nan)
    return Problem(case.model, summary, None, weighed_rows(case.model, ()), unknown, None, 1.0)


def test_repeats_count_the_less_the_more_of_their_states_parameters_follow() -> None:
    """From what one passage says to nearly all that all say together; the noise is small, so all rows are followed."""
    shares = [repeated(20, seconds).distinct for seconds in (0.03, 0.1, 1.0, 5.0)]
    once = repeated(20, 0.03).summary.visited.distinct
    assert once < 0.1
    assert once <= shares[0] < 0.3
    assert shares == sorted(shares)
    assert repeated(1, seconds=3.0).distinct == pytest.approx(1.0, abs=0.01)
    assert shares[-1] > 0.85


def test_repeats_of_what_is_forgotten_do_not_count() -> None:
    assert repeated(20, seconds=0.03, forgetting_time=0.03).distinct == 1.0
