"""A planted population is found again from its robots, whoever else is among them, and serves a new robot."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.population import (
    Population,
    PopulationFit,
    RobotLikelihood,
    common_likelihoods,
    population_and_members,
)
from geomid_ros.types import FloatArray

from .arms import parameters, solved
from .fleets import Type, typical, with_tool

ROBOTS = 12
ANOTHER = 31  # seed of a robot that is none of these
MOST_OF_URDF = 0.55
MOST_MOVED = 0.05  # standard deviations


@cache
def of_type() -> Type:
    return typical("arm3", 3)


@cache
def robots() -> tuple[RobotLikelihood, ...]:
    return tuple(of_type().fleet(ROBOTS))


@cache
def population() -> Population:
    return PopulationFit(common_likelihoods(robots())).population


def moved(found: Population, before: Population) -> float:
    """How far the mean or a standard deviation has moved, in standard deviations."""
    deviations = np.sqrt(np.diag(before.covariance))
    mean = np.abs(before.manifold.log(before.point, found.point)) / deviations
    return float(max(np.max(mean), np.max(np.abs(np.sqrt(np.diag(found.covariance)) / deviations - 1.0))))


def deviations_of(found: Population, truth: FloatArray) -> FloatArray:
    """Tangent coordinates of a truth at the mean, in principal directions of the covariance and in standard
    deviations."""
    values, vectors = np.linalg.eigh(found.covariance)
    tangent = found.manifold.log(found.point, found.manifold.point(truth))
    return np.asarray(vectors.T @ tangent / np.sqrt(values))


def test_new_robots_are_as_far_from_the_mean_as_the_covariance_says() -> None:
    """Of robots that took no part: over directions and robots, the mean square is about 1."""
    kind = of_type()
    truths = [parameters(kind.case.model, kind.robot(seed)) for seed in range(100, 160)]
    squares = np.array([deviations_of(population(), truth) ** 2 for truth in truths])
    assert 0.5 < np.mean(squares) < 1.6


def test_effects_of_the_type_are_found() -> None:
    """The relative deviation of frictions is that of the planted ones, and means are its means within a few errors."""
    found = population()
    first = 10 * len(found.links)
    names = [effect.name for effect in found.effects]
    spread = np.sqrt(np.diag(found.covariance))[first:]
    truth = parameters(of_type().case.model, of_type().case.true)[first:]
    for index, name in enumerate(names):
        if found.effects[index].positive and name != "rotor_inertia":  # which links of a short arm hide
            assert 0.07 < spread[index] < 0.3
            assert abs(np.log(found.parameters[first + index] / truth[index])) < 4.0 * spread[index] / np.sqrt(ROBOTS)


def test_a_new_robot_with_one_second_of_data_is_predicted_far_better_than_from_its_urdf() -> None:
    errors = []
    for seed in range(40, 44):
        kind = of_type()
        case = kind.recorded(kind.robot(seed), seed, 1.0)
        fresh = case.fresh(seed)
        known = (None, population())
        errors.append([np.mean(fresh.error(solved(case, population=each).parameters) ** 2) for each in known])
    by_urdf, by_population = np.sqrt(np.mean(errors, axis=0))
    assert by_population < MOST_OF_URDF * by_urdf
    ratios = np.sqrt([after / before for before, after in errors])
    assert np.median(ratios) < MOST_OF_URDF


def test_a_population_does_not_count_as_data() -> None:
    """Of the little that a population leaves open, data take no larger share away than of the much that a URDF does, if
    they tell links from rotors by themselves."""
    kind = of_type()
    case = kind.recorded(kind.robot(51), 51, 8.0)
    alone, beside = (
        np.array([link.from_data for link in solved(case, population=known).links]) for known in (None, population())
    )
    assert np.all(beside < alone + 0.1)


def test_much_data_win_over_the_population() -> None:
    kind = of_type()
    case = kind.recorded(kind.robot(50), 50, 30.0)
    alone, beside = solved(case), solved(case, population=population())
    fresh = case.fresh(51)
    assert np.max(fresh.error(beside.parameters)) < 0.02
    np.testing.assert_allclose(fresh.error(beside.parameters), fresh.error(alone.parameters), atol=0.01)


def judged(other: RobotLikelihood) -> tuple[Population, list[bool], tuple[str, ...]]:
    """The population with another robot instead of the last, who is of it, and in what the other is unlike it."""
    found, members = population_and_members([*robots()[:-1], other])
    return found, [member.member for member in members], members[-1].unlike


@cache
def of_the_others() -> Population:
    return PopulationFit(common_likelihoods(robots()[:-1])).population


def test_a_robot_of_another_type_is_told_and_moves_nothing() -> None:
    kind = typical("arm3", 4)
    found, members, unlike = judged(RobotLikelihood.of(solved(kind.recorded(kind.robot(ANOTHER), ANOTHER, 10.0))))
    assert members == [True] * (ROBOTS - 1) + [False]
    assert unlike
    assert moved(found, of_the_others()) < MOST_MOVED


def test_a_tool_left_on_is_told_and_moves_nothing() -> None:
    kind = of_type()
    case = kind.recorded(with_tool(kind.robot(ANOTHER), 0.8), ANOTHER, 10.0)
    found, members, unlike = judged(RobotLikelihood.of(solved(case)))
    assert members == [True] * (ROBOTS - 1) + [False]
    assert unlike[0] == kind.case.model.body_names[-1]
    assert moved(found, of_the_others()) < MOST_MOVED
    told = solved(case, population=found).warnings
    assert any(f"link '{unlike[0]}' differs" in sentence for sentence in told)


def test_what_is_left_of_some_effects_is_the_least_over_the_others() -> None:
    """Leaving out effects is minimising over them: compared with least squares."""
    whole = robots()[0]
    kept = [effect for effect in whole.effects if effect.name != "effort_offset"]
    part = whole.of_effects(kept)
    first = 10 * len(whole.links)
    chosen = [*range(first), *(first + whole.effects.index(effect) for effect in kept)]
    others = [column for column in range(len(whole.parameters)) if column not in chosen]
    x, y = whole.prior[chosen], whole.parameters[chosen]

    def least(values: FloatArray) -> float:
        left = whole.targets - whole.rows[:, chosen] @ values
        best = np.linalg.lstsq(whole.rows[:, others], left, rcond=None)[0]
        return float(np.sum((left - whole.rows[:, others] @ best) ** 2))

    squares = [float(np.sum((part.rows @ values - part.targets) ** 2)) for values in (x, y)]
    assert squares[0] - squares[1] == pytest.approx(least(x) - least(y), rel=1e-6)


def test_two_robots_are_no_population() -> None:
    with pytest.raises(InputError, match="a population of 2 robots, expected at least 3"):
        common_likelihoods(robots()[:2])


def test_a_population_of_other_robots_is_refused() -> None:
    case = typical("arm7", 1).recorded(typical("arm7", 1).robot(1), 1, 2.0)
    renamed = replace(population().part(population().links[:1], population().effects), links=("elsewhere",))
    with pytest.raises(InputError, match=r"has no link of this robot: its links are elsewhere, the robot's are"):
        solved(case, population=renamed)
