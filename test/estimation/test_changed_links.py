"""Which link has changed: planted changes are found, and nothing is where nothing changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from geomid_ros.estimation.comparison import ChangedLink, LinkEvidence, changed_links
from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.geometry import pseudo_inertia

NAMES = ("upper", "lower", "hand")
LIMIT = float(chdtri(10, 0.05 / len(NAMES)))
ALIKE = 6.0
NOISE = 0.01
SEEDS = 200


def bodies(random: np.random.Generator) -> np.ndarray:
    """Parameters ``(3, 10)`` of bodies of 1 to 3 kg."""
    centres = 0.1 * random.standard_normal((3, 3))
    return pseudo_inertia.assemble(random.uniform(1.0, 3.0, 3), centres, np.tile(0.02 * np.eye(3), (3, 1, 1)))


def measured(
    parameters: np.ndarray, rows: np.ndarray, random: np.random.Generator, started: np.ndarray
) -> LinkEvidence:
    """What ``rows (N, 30)`` of noisy measurements say about an estimate that is a little off."""
    estimate = started * (1.0 + 0.02 * random.standard_normal((3, 1)))
    errors = (rows @ (estimate - parameters).ravel() + NOISE * random.standard_normal(len(rows))) / NOISE
    triangle = np.linalg.qr(np.column_stack([rows / NOISE, errors]), mode="r")
    return LinkEvidence(estimate, LinksInformation(triangle[:30, :30], triangle[:30, 30]))


def of_combinations(random: np.random.Generator) -> np.ndarray:
    """Rows ``(200, 30)`` that tell 26 combinations of the parameters, and no single one."""
    return random.standard_normal((200, 26)) @ random.standard_normal((26, 30))


def found(seed: int, change: dict[int, float]) -> tuple[ChangedLink, ...]:
    """What is found if links are so many times as heavy in the second result."""
    random = np.random.default_rng(seed)
    before = bodies(random)
    after = before.copy()
    for link, factor in change.items():
        after[link] *= factor
    first, second = (measured(own, of_combinations(random), random, before) for own in (before, after))
    return changed_links(NAMES, first, second, LIMIT, ALIKE)


@pytest.mark.parametrize(("seed", "change"), [(0, {0: 1.2}), (1, {1: 1.2}), (2, {2: 1.2}), (5, {0: 1.3, 2: 0.7})])
def test_links_that_changed_are_named_with_their_masses(seed: int, change: dict[int, float]) -> None:
    before = bodies(np.random.default_rng(seed))
    changed = {NAMES.index(each.link): each.mass for each in found(seed, change)}
    assert changed.keys() == change.keys()
    for link, mass in changed.items():
        assert abs(mass.value - (change[link] - 1.0) * before[link][0]) < 4.0 * mass.std
        assert mass.std < 0.1 * before[link][0]


def test_a_payload_far_larger_than_its_link_is_not_shared_out() -> None:
    random = np.random.default_rng(0)
    before, rows = bodies(random), of_combinations(random)
    after = before.copy()
    after[2] += pseudo_inertia.assemble(np.array(8.0), np.array([0.0, 0.1, 0.8]), 0.05 * np.eye(3))
    results = [measured(own, rows, random, own) for own in (before, after)]
    for sign, pair in ((1.0, results), (-1.0, results[::-1])):
        (changed,) = changed_links(NAMES, *pair, LIMIT, ALIKE)
        assert changed.link == "hand"
        assert abs(changed.mass.value - sign * 8.0) < 4.0 * changed.mass.std


@pytest.mark.parametrize("seed", range(3))
def test_what_a_change_adds_is_known_to_a_tenth(seed: int) -> None:
    """No other link is named for the rest, and the interval of the change allows for it."""
    random = np.random.default_rng(seed)
    before, rows = bodies(random), of_combinations(random)
    after = before.copy()
    after[2] *= 1.5
    first, second = (measured(own, rows, random, before) for own in (before, after))
    added = rows @ (after - before).ravel() / NOISE
    errors = 0.05 * np.std(added) * random.standard_normal(len(rows))
    pull = np.linalg.lstsq(rows / NOISE, errors, rcond=1e-9)[0]
    information = replace(second.information, residuals=second.information.residuals + second.information.rows @ pull)
    (changed,) = changed_links(NAMES, first, replace(second, information=information), LIMIT, ALIKE)
    assert changed.link == "hand"
    assert abs(changed.mass.value - 0.5 * before[2][0]) < 3.0 * changed.mass.std


def test_nothing_is_named_where_nothing_changed() -> None:
    """In 5 % of all cases at most; what is counted is binomial."""
    named = sum(bool(found(seed, {})) for seed in range(SEEDS))
    most = 0.05 * SEEDS + 4.0 * np.sqrt(0.05 * 0.95 * SEEDS)
    assert named <= most


def test_links_that_move_alike_are_rivals() -> None:
    """Where rows tell the sum of two links alone, either may have changed."""
    random = np.random.default_rng(3)
    before = bodies(random)
    before[1] = before[0]
    rows = random.standard_normal((200, 20))
    rows = np.column_stack([rows[:, :10], rows[:, :10], rows[:, 10:]])
    after = before.copy()
    after[1] *= 1.2
    (changed,) = changed_links(NAMES, *(measured(own, rows, random, before) for own in (before, after)), LIMIT, ALIKE)
    assert {changed.link, *changed.rivals} == {"upper", "lower"}
    assert f"or {changed.rivals[0]} changed instead" in changed.sentence


def test_a_body_that_was_moved_has_another_first_moment_and_the_same_mass() -> None:
    random = np.random.default_rng(8)
    before = bodies(random)
    after = before.copy()
    placed = pseudo_inertia.quantities_of(before[1])
    placed[1:4] += np.array([0.0, 0.05, 0.0])
    after[1] = pseudo_inertia.parameters_of(placed)
    rows = random.standard_normal((200, 30))
    (changed,) = changed_links(NAMES, *(measured(own, rows, random, before) for own in (before, after)), LIMIT, ALIKE)
    assert changed.link == "lower"
    assert abs(changed.mass.value) < 4.0 * changed.mass.std
    for axis, moved in zip("xyz", (after - before)[1][1:4], strict=True):
        assert abs(changed.moment[axis].value - moved) < 4.0 * changed.moment[axis].std
    assert changed.moment["y"].value > 10.0 * changed.moment["y"].std
