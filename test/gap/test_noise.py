"""Whitening: theorems of autoregressive processes, and planted ones recovered.

The floor from repeats: planted noise is recovered however wrong the model is, and other motions are no repeats.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from geomid_ros.gap import noise as noise_module
from geomid_ros.gap.noise import Autoregression, levinson, noise_by_repeats, repeated_after, runs_of
from geomid_ros.gap.records import Records
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from . import planted


def process(count: int, seed: int = 3) -> np.ndarray:
    """An autoregressive process with the coefficients 1.2, -0.5 and innovations of variance 1."""
    noise = np.random.default_rng(seed).standard_normal(count + 500)
    return np.asarray(lfilter([1.0], [1.0, -1.2, 0.5], noise))[500:]


def test_levinson_solves_the_yule_walker_equations() -> None:
    covariance = np.array([2.0, 1.1, 0.3, -0.2])
    predictors, variances = levinson(covariance)
    for order in range(1, 4):
        toeplitz = covariance[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
        expected = np.linalg.solve(toeplitz, covariance[1 : order + 1])
        np.testing.assert_allclose(predictors[order], expected, atol=1e-12)
        np.testing.assert_allclose(variances[order], covariance[0] - expected @ covariance[1 : order + 1])


def test_a_planted_process_is_recovered_from_runs() -> None:
    values = process(20000)
    valid = np.arange(len(values)) % 50 != 7
    found = Autoregression.fit(values, runs_of(valid, np.zeros(len(values), dtype=np.int64)))
    padded = np.append(found.predictors[found.order], np.zeros(6))
    np.testing.assert_allclose(padded[:2], [1.2, -0.5], atol=0.05)
    assert abs(found.variances[-1] - 1.0) < 0.05


def test_whitened_noise_is_white_from_the_first_row_of_every_run() -> None:
    values = process(40000)
    runs = [slice(start, start + 8) for start in range(0, len(values) - 8, 10)]
    predictors, variances = levinson(true_covariance())
    white = Autoregression(predictors, variances).whiten(values[:, None], runs).reshape(-1, 8)
    covariance = white.T @ white / len(white)
    np.testing.assert_allclose(covariance, np.eye(8), atol=0.08)


def true_covariance() -> np.ndarray:
    """Autocovariance at lags 0 to 2 of the planted process, from its equations."""
    first, second = 1.2, -0.5
    ratio = first / (1.0 - second)
    ratios = np.array([1.0, ratio, first * ratio + second])
    return ratios / (1.0 - first * ratios[1] - second * ratios[2])


def test_runs_end_at_gaps_and_at_the_ends_of_segments() -> None:
    valid = np.array([True, True, False, True, True, True])
    segment = np.array([0, 0, 0, 0, 1, 1])
    assert runs_of(valid, segment) == [slice(0, 2), slice(3, 4), slice(4, 6)]


def test_the_order_is_that_of_the_process_not_more() -> None:
    """Akaike's criterion takes too much one time in six or so, and never too little of this memory."""
    orders = []
    for seed in range(40):
        values = process(3000, seed)
        orders.append(Autoregression.fit(values, [slice(0, len(values))]).order)
    assert min(orders) == 2
    assert np.mean(np.array(orders) == 2) > 0.6
    noise = np.random.default_rng(3).standard_normal((40, 500))
    white = [Autoregression.fit(values, [slice(0, 500)]) for values in noise]
    assert np.mean([own.order == 0 for own in white]) > 0.6
    assert abs(np.mean([own.variances[0] for own in white]) - 1.0) < 0.05


def test_covariances_are_of_pairs_within_a_run() -> None:
    """In pairs nothing is told of what is further apart: no process has a memory of 0.9 that ends after one row, so of
    more than one row none is made up."""
    first, new = np.random.default_rng(5).standard_normal((2, 4000))
    values = np.stack([first, 0.9 * first + np.sqrt(0.19) * new], axis=1).ravel()
    found = Autoregression.fit(values, [slice(start, start + 2) for start in range(0, len(values), 2)])
    assert found.order == 1
    assert abs(found.predictors[1][0] - 0.9) < 0.02
    assert abs(found.variances[1] - 0.19) < 0.02


PERIOD = 6.0  # [s] of the planted motion
SIZES = np.array([0.05, 0.1, 0.2])  # [N m]


def noisy(seed: int, seconds: float, noise_seed: int, memory: float = 0.0) -> Samples:
    """A robot with friction, that no model here knows, under noise with a standard deviation of SIZES."""
    rigid = planted.rigid(planted.true_inertias(3, 0.3))
    exact = planted.recording(lambda q, v, a: rigid(q, v, a) + np.tanh(v / 0.1), seed, seconds, noise=0.0)
    white = np.random.default_rng(noise_seed).standard_normal((len(exact) + 500, len(SIZES)))
    noise = np.asarray(lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white, axis=0))[500:]
    return replace(exact, effort=exact.effort + SIZES * noise)


def found_of(*parts: Samples) -> tuple[Records, FloatArray, FloatArray]:
    """The records of some recordings, and their noise with the number of its samples."""
    records = Records.make(parts, planted.CUTOFF)
    return records, *noise_by_repeats(planted.model(), records)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_noise_is_what_two_periods_differ_by(memory: float) -> None:
    """And a joint that is not measured leaves the others their floor."""
    samples = noisy(1, 40.0, 2, memory)
    records, noise, _ = found_of(samples)
    assert repeated_after(records.dense[0], records.dense[0]) == pytest.approx(PERIOD, abs=1e-3)
    # A spline between white samples averages them: up to a tenth of the deviation of noise that is not filtered.
    np.testing.assert_allclose(noise, SIZES, rtol=0.13)
    effort = samples.effort.copy()
    effort[:, 1] = np.nan
    np.testing.assert_array_equal(found_of(replace(samples, effort=effort))[1], [noise[0], np.nan, noise[2]])


def test_two_recordings_of_one_motion_are_repeats_and_those_of_others_are_not() -> None:
    """Each is shorter than two periods; the second begins later in the motion."""
    first, second = noisy(1, 8.0, 2), noisy(1, 9.0, 3)
    records, noise, _ = found_of(first, second.select(slice(32, None)))
    assert repeated_after(*records.dense) == pytest.approx(-32 / planted.RATE, abs=1e-3)
    np.testing.assert_allclose(noise, SIZES, rtol=0.15)
    assert np.all(np.isnan(found_of(first, noisy(4, 8.0, 3))[1]))


def test_what_a_model_leaves_is_the_floor_unless_repeats_say_surely_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five instants are sure of nothing."""
    said, remainder = np.array([0.99, 0.8, 1.2, np.nan, 1.0]), np.array([1.0, 1.0, 1.0, 1.0, np.nan])
    for count, expected in ((200.0, [1.0, 0.8, 1.0, 1.0, 1.0]), (5.0, np.ones(5))):
        monkeypatch.setattr(noise_module, "noise_by_repeats", lambda *_, count=count: (said, np.full(5, count)))
        unused: Any = None
        np.testing.assert_array_equal(noise_module.noise_floor(unused, unused, remainder), expected)


def test_the_floor_of_a_model_that_lacks_nothing_is_not_too_low() -> None:
    """On average over robots and channels: of two measures of the noise the smaller one would be."""
    ratios = []
    for seed in range(12):
        records, _, counts = found_of(noisy(1, 2.0 * PERIOD, seed, memory=0.8))
        remainder = SIZES * (1.0 + np.random.default_rng(seed).standard_normal(3) / np.sqrt(2.0 * 2.0 * counts))
        ratios.append(noise_module.noise_floor(planted.model(), records, remainder) / SIZES)
    assert abs(np.mean(ratios) - 1.0) < 0.02


def test_the_lowest_of_a_parabola() -> None:
    for place in (-0.4, 0.0, 0.3):
        three = 2.0 + 5.0 * (np.array([-1.0, 0.0, 1.0]) - place) ** 2
        assert noise_module._lowest(three) == pytest.approx((2.0, place))
    assert noise_module._lowest(np.array([1.0, 1.0, 1.0])) == (1.0, 0.0), "a line has none"
    assert noise_module._lowest(np.array([2.0, 1.0, -5.0]))[1] == 0.0
    assert noise_module._lowest(5.0 * (np.array([-1.0, 0.0, 1.0]) - 0.3) ** 2 - 1.0)[0] == 0.0, (
        "no mean square is negative"
    )


def test_the_mean_of_standard_deviations_is_over_all_pairs_of_repeats() -> None:
    """Each pair of stretches is one measure; they have as many instants as overlap, as far as these are independent."""
    parts = [noisy(1, 8.0, seed) for seed in (2, 3, 4)]
    records, noise, counts = found_of(*parts)
    pairs = [(0, 1), (0, 2), (1, 2)]
    squares = [0.5 * np.mean((parts[a].effort - parts[b].effort) ** 2, axis=0) for a, b in pairs]
    np.testing.assert_allclose(noise, np.sqrt(np.mean(squares, axis=0)), rtol=1e-3)
    share = len(records.samples) / sum(len(part) for part in records.dense)
    np.testing.assert_allclose(counts, share * 3 * len(parts[0]), rtol=0.01)


def test_what_hardly_overlaps_or_stands_still_or_is_slow_is_no_repeat() -> None:
    whole = noisy(1, 24.0, 2)
    first = whole.select(slice(0, 384))
    assert repeated_after(first, whole.select(slice(192, 576))) == pytest.approx(-3.0, abs=1e-3)
    still = replace(first, position=0.0 * first.position)
    assert repeated_after(still, still) is None
    short = whole.select(slice(0, 60))
    assert repeated_after(short, short) is None
    later = np.sin(0.002 * whole.seconds)[:, None]  # a second later it is nearly where it was, and ever farther away
    slow = replace(whole, position=later * np.ones(whole.position.shape[1]))
    assert repeated_after(slow, slow) is None
