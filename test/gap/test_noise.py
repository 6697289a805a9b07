"""Whitening: theorems of autoregressive processes, and planted ones recovered."""

import numpy as np
from scipy.signal import lfilter

from geomid_ros.gap.noise import Autoregression, levinson, runs_of


def planted(count: int, seed: int = 3) -> np.ndarray:
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
    values = planted(20000)
    valid = np.arange(len(values)) % 50 != 7
    found = Autoregression.fit(values, runs_of(valid, np.zeros(len(values), dtype=np.int64)))
    padded = np.append(found.predictors[found.order], np.zeros(6))
    np.testing.assert_allclose(padded[:2], [1.2, -0.5], atol=0.05)
    assert abs(found.variances[-1] - 1.0) < 0.05


def test_whitened_noise_is_white_from_the_first_row_of_every_run() -> None:
    values = planted(40000)
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
        values = planted(3000, seed)
        orders.append(Autoregression.fit(values, [slice(0, len(values))]).order)
    assert min(orders) == 2
    assert np.mean(np.array(orders) == 2) > 0.6
    noise = np.random.default_rng(3).standard_normal((40, 500))
    white = [Autoregression.fit(values, [slice(0, 500)]) for values in noise]
    assert np.mean([process.order == 0 for process in white]) > 0.6
    assert abs(np.mean([process.variances[0] for process in white]) - 1.0) < 0.05


def test_covariances_are_of_pairs_within_a_run() -> None:
    """In pairs nothing is told of what is further apart: no process has a memory of 0.9 that ends after one row, so of
    more than one row none is made up."""
    first, new = np.random.default_rng(5).standard_normal((2, 4000))
    values = np.stack([first, 0.9 * first + np.sqrt(0.19) * new], axis=1).ravel()
    found = Autoregression.fit(values, [slice(start, start + 2) for start in range(0, len(values), 2)])
    assert found.order == 1
    assert abs(found.predictors[1][0] - 0.9) < 0.02
    assert abs(found.variances[1] - 0.19) < 0.02
