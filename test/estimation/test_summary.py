"""The summary has the least-squares content of the rows, however they came, in bounded memory."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import REGIMES
from geomid_ros.types import FloatArray

DIMENSION = 12
CHANNELS = (
    Channel(name="wide", unit="N m", columns=np.arange(DIMENSION)),
    Channel(name="narrow", unit="N m", columns=np.array([3, 4, 11])),
    Channel(name="one", unit="N", columns=np.array([7])),
    Channel(name="silent", unit="N", columns=np.array([0, 1])),
)
CONTENT = 1e-10


def rows(seed: int, count: int) -> tuple[FloatArray, FloatArray]:
    """Coefficients ``(count, channels, D)``, zero where a channel has no column; targets, some not measured."""
    rng = np.random.default_rng(seed)
    coefficients = np.zeros((count, len(CHANNELS), DIMENSION))
    for index, channel in enumerate(CHANNELS):
        coefficients[:, index, channel.columns] = rng.normal(size=(count, len(channel.columns)))
    coefficients[:, 0] *= 10.0 ** np.linspace(-3, 3, DIMENSION)
    targets = rng.normal(size=(count, len(CHANNELS)))
    targets[rng.random(targets.shape) < 0.2] = np.nan
    targets[:, 3] = np.nan
    return coefficients, targets


def summary(coefficients: FloatArray, targets: FloatArray, **settings: float) -> RowSummary:
    """One instant every second."""
    result = RowSummary(CHANNELS, **settings)
    result.add(coefficients, targets, 1.0)
    return result


def weighted(coefficients: FloatArray, targets: FloatArray, channel: int, x: FloatArray, weights: FloatArray) -> float:
    return float(np.nansum(weights * (coefficients[:, channel] @ x - targets[:, channel]) ** 2))


def content(found: RowSummary, x: FloatArray, folds: list[int] | None = None) -> FloatArray:
    """``|Ax - b|^2`` of each channel, in all of its groups."""
    return np.sum(by_group(found, x, folds), axis=0)


def by_group(found: RowSummary, x: FloatArray, folds: list[int] | None = None) -> FloatArray:
    """``|Ax - b|^2`` of each channel's rows by regime ``(regimes, channels)``."""
    chosen = range(found.folds) if folds is None else folds
    errors = [
        sum(np.sum((parts[fold].factor @ np.append(x[channel.columns], -1.0)) ** 2) for fold in chosen)
        for channel, parts in zip(found.groups, found.parts(), strict=True)
    ]
    return np.reshape(errors, (REGIMES, -1))


@pytest.mark.parametrize(("count", "block"), [(100, 30), (121, 60), (500, 240)])
def test_folds_follow_one_another_in_time(count: int, block: int) -> None:
    """Of 30 instants each, and of twice as many each time when all are full."""
    coefficients, targets = rows(1, count)
    found = summary(coefficients, targets, folds=4, block=30)
    fold = np.arange(count) // block
    x = np.random.default_rng(1).normal(size=DIMENSION)
    for chosen in ([0], [1], [2], [0, 2], [0, 1, 2, 3]):
        weights = np.isin(fold, chosen).astype(float)
        expected = [weighted(coefficients, targets, k, x, weights) for k in range(len(CHANNELS))]
        np.testing.assert_allclose(content(found, x, chosen), expected, rtol=CONTENT)
    again = RowSummary(CHANNELS, folds=4, block=30)
    again.restore(found.state())
    for later in (found, again):
        later.add(coefficients[:1], targets[:1], 1.0)
    last_counts = [[parts[3].count for parts in each.parts()] for each in (again, found)]
    np.testing.assert_allclose(*last_counts)


@pytest.mark.parametrize("forgetting_time", [np.inf, 100.0])
def test_many_instants_at_once_are_as_one_by_one(forgetting_time: float) -> None:
    """In pieces of any length; of one fold, so that many rows of one group come."""
    coefficients, targets = rows(1, 900)
    coefficients[::50, 1] = np.inf
    rng = np.random.default_rng(1)
    regimes, elapsed = rng.integers(0, REGIMES, targets.shape), rng.random(len(targets))
    for folds, block in ((4, 20), (2, 1000)):
        alone, together = (RowSummary(CHANNELS, folds, block, forgetting_time) for _ in range(2))
        for one in map(slice, range(900), range(1, 901)):
            alone.add(coefficients[one], targets[one], elapsed[one], regimes[one])
        ends = [0, *np.sort(rng.integers(0, 900, 8)).tolist(), 900]
        for piece in map(slice, ends, ends[1:]):
            together.add(coefficients[piece], targets[piece], elapsed[piece], regimes[piece])
        expected, found = alone.state(), together.state()
        assert (found.instants, found.rows) == (expected.instants, expected.rows)
        np.testing.assert_allclose([found.time, found.weight], [expected.time, expected.weight], rtol=1e-13)
        np.testing.assert_allclose(found.counts, expected.counts, rtol=1e-13)
        for ours, theirs in zip(found.factors, expected.factors, strict=True):
            for one, other in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(one, other)


def test_rows_are_kept_apart_by_regime() -> None:
    """Of each channel by itself; what is weighted alike is as if they were not."""
    coefficients, targets = rows(1, 300)
    regimes = np.random.default_rng(1).integers(0, REGIMES, targets.shape)
    found = RowSummary(CHANNELS, folds=4, block=20)
    found.add(coefficients, targets, 1.0, regimes)
    x = np.random.default_rng(1).normal(size=DIMENSION)
    for group in range(REGIMES):
        for k in range(len(CHANNELS)):
            expected = weighted(coefficients, targets, k, x, (regimes[:, k] == group).astype(float))
            assert by_group(found, x)[group, k] == pytest.approx(expected, rel=CONTENT)
    mixed = summary(coefficients, targets, folds=4, block=20)
    np.testing.assert_allclose(content(found, x), content(mixed, x), rtol=CONTENT)
    np.testing.assert_allclose(found.rms(x), mixed.rms(x), rtol=CONTENT)
    copy = RowSummary(CHANNELS, folds=4, block=20)
    copy.restore(found.state())
    np.testing.assert_array_equal(by_group(copy, x), by_group(found, x))


@pytest.mark.parametrize("count", [10, 400])
def test_forgetting_is_exponential_weighting_by_age(count: int) -> None:
    """Whichever fold and chunk a row is in, and whether or not its channel was measured since."""
    coefficients, targets = rows(1, count)
    elapsed = np.random.default_rng(1).uniform(0.0, 2.0, count)
    found = RowSummary(CHANNELS, folds=4, block=20, forgetting_time=30.0)
    found.add(coefficients, targets, elapsed)
    x = np.random.default_rng(1).normal(size=DIMENSION)
    weights = np.exp((np.cumsum(elapsed) - np.sum(elapsed)) / 30.0)
    for k in range(len(CHANNELS)):
        measured = np.isfinite(targets[:, k])
        expected = weighted(coefficients, targets, k, x, weights)
        assert content(found, x)[k] == pytest.approx(expected, rel=CONTENT)
        assert sum(part.count for part in found.parts()[k]) == pytest.approx(np.sum(weights[measured]), rel=CONTENT)


def test_long_after_the_past_weighs_nothing_and_nothing_breaks() -> None:
    coefficients, targets = rows(0, 50)
    found = summary(coefficients, 1e3 + targets, block=5, forgetting_time=1.5)
    found.add(np.repeat(coefficients[:1], 750, axis=0), np.zeros((750, 4)), 4.0)
    x = np.zeros(DIMENSION)
    np.testing.assert_allclose(content(found, x)[:3], 0.0, atol=1e-200)
    np.testing.assert_allclose(found.rms(x)[:3], 0.0, atol=1e-100)


@pytest.mark.parametrize("count", [3, 8, 200])
def test_compressed_rows_have_the_weighted_content_up_to_a_constant(count: int) -> None:
    """The constant is what no parameters can explain."""
    coefficients, targets = rows(1, count)
    sigmas = np.array([0.3, 2.0, 1e-2, 1.0])
    found = summary(coefficients, targets, block=20)
    a, b = found.compressed(sigmas, DIMENSION)
    assert len(a) <= DIMENSION
    points = np.random.default_rng(1).normal(size=(6, DIMENSION))
    raw = [
        sum(weighted(coefficients, targets, k, x, np.full(count, sigmas[k] ** -2.0)) for k in range(4)) for x in points
    ]
    compressed = [np.sum((a @ x - b) ** 2) for x in points]
    scale = max(raw)
    for (raw_one, raw_two), (one, two) in zip(pairwise(raw), pairwise(compressed), strict=True):
        assert one - two == pytest.approx(raw_one - raw_two, abs=1e-9 * scale)
    present = [(coefficients[:, k] / sigmas[k])[np.isfinite(targets[:, k])] for k in range(4)]
    measured = np.concatenate(present)
    np.testing.assert_allclose(a.T @ a, measured.T @ measured, rtol=0, atol=1e-9 * np.linalg.norm(measured) ** 2)


def test_memory_is_bounded() -> None:
    coefficients, targets = rows(3, 400)
    found = RowSummary(CHANNELS, folds=2)
    most = 0
    for _ in range(3):
        for one in map(slice, range(400), range(1, 401)):
            found.add(coefficients[one], targets[one])
            most = max(most, sum(part.waiting_rows for fold in found._summaries for part in fold))
    assert most < 2 * len(CHANNELS) * RowSummary._CHUNK
    for channel, parts in zip(found.groups, found.parts(), strict=True):
        for part in parts:
            columns = len(channel.columns) + 1
            assert part.factor.shape[0] <= columns
            assert part.factor.shape[1] == columns


@pytest.mark.parametrize("forgetting_time", [np.inf, 20.0])
def test_a_snapshot_stays_as_it_was_and_goes_on_by_itself(forgetting_time: float) -> None:
    coefficients, targets = rows(4, 600)
    x = np.random.default_rng(4).normal(size=DIMENSION)
    found = summary(coefficients[:250], targets[:250], forgetting_time=forgetting_time, block=40)
    copy, before = found.snapshot(), content(found, x)
    found.add(coefficients[250:], targets[250:], 1.0)
    found.parts()
    np.testing.assert_array_equal(content(copy, x), before)
    copy.add(coefficients[250:], targets[250:], 1.0)
    whole = summary(coefficients, targets, forgetting_time=forgetting_time, block=40)
    for other in (found, copy):
        np.testing.assert_allclose(content(other, x), content(whole, x), rtol=CONTENT)


@pytest.mark.parametrize("count", [5, 90, 600])
def test_parameters_that_are_left_out_are_zero(count: int) -> None:
    """Whether factors of all parameters were asked for before, or not."""
    coefficients, targets = rows(6, count)
    chosen = np.array([0, 3, 4, 7, 10])
    left = [np.isin(chosen, channel.columns) for channel in CHANNELS]
    channels = [replace(c, columns=np.flatnonzero(own)) for c, own in zip(CHANNELS, left, strict=True)]
    x = np.zeros(DIMENSION)
    x[chosen] = np.random.default_rng(6).normal(size=len(chosen))
    for known in (False, True):
        whole = summary(coefficients, targets)
        if known:
            whole.factors()
        part = whole.with_columns(channels, chosen)
        np.testing.assert_allclose(part.rms(x[chosen]), whole.rms(x), rtol=CONTENT)
        np.testing.assert_allclose(content(part, x[chosen]), content(whole, x), rtol=CONTENT)


def test_a_fold_that_lacks_a_group_is_refused() -> None:
    """And changes nothing."""
    found = summary(*rows(0, 100), folds=4, block=30)
    state, again = found.state(), RowSummary(CHANNELS, folds=4, block=30)
    factors = (state.factors[0][:-1], *state.factors[1:])
    with pytest.raises(InputError, match="groups"):
        again.restore(replace(state, factors=factors))
    assert again.rows == 0
