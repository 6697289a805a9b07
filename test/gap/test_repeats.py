"""The floor from repeats: planted noise is recovered however wrong the model is, and other motions are no repeats."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from geomid_ros.gap import noise
from geomid_ros.gap.noise import noise_by_repeats, repeated_after
from geomid_ros.gap.records import Records
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from . import planted

PERIOD = 6.0  # [s] of the planted motion
SIZES = np.array([0.05, 0.1, 0.2])  # [N m]


def recording(seed: int, seconds: float, noise_seed: int, memory: float = 0.0) -> Samples:
    """A robot with friction, that no model here knows, under noise with a standard deviation of SIZES."""
    rigid = planted.rigid(planted.true_inertias(3, 0.3))
    exact = planted.recording(lambda q, v, a: rigid(q, v, a) + np.tanh(v / 0.1), seed, seconds, noise=0.0)
    white = np.random.default_rng(noise_seed).standard_normal((len(exact) + 500, len(SIZES)))
    noise = np.asarray(lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white, axis=0))[500:]
    return replace(exact, effort=exact.effort + SIZES * noise)


def found(*parts: Samples) -> tuple[Records, FloatArray, FloatArray]:
    """The records of some recordings, and their noise with the number of its samples."""
    records = Records.make(parts, planted.CUTOFF)
    return records, *noise_by_repeats(planted.model(), records)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_noise_is_what_two_periods_differ_by(memory: float) -> None:
    """And a joint that is not measured leaves the others their floor."""
    samples = recording(1, 40.0, 2, memory)
    records, noise, _ = found(samples)
    assert repeated_after(records.dense[0], records.dense[0]) == pytest.approx(PERIOD, abs=1e-3)
    # A spline between white samples averages them: up to a tenth of the deviation of noise that is not filtered.
    np.testing.assert_allclose(noise, SIZES, rtol=0.13)
    effort = samples.effort.copy()
    effort[:, 1] = np.nan
    np.testing.assert_array_equal(found(replace(samples, effort=effort))[1], [noise[0], np.nan, noise[2]])


def test_two_recordings_of_one_motion_are_repeats_and_those_of_others_are_not() -> None:
    """Each is shorter than two periods; the second begins later in the motion."""
    first, second = recording(1, 8.0, 2), recording(1, 9.0, 3)
    records, noise, _ = found(first, second.select(slice(32, None)))
    assert repeated_after(*records.dense) == pytest.approx(-32 / planted.RATE, abs=1e-3)
    np.testing.assert_allclose(noise, SIZES, rtol=0.15)
    assert np.all(np.isnan(found(first, recording(4, 8.0, 3))[1]))


def test_what_a_model_leaves_is_the_floor_unless_repeats_say_surely_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five instants are sure of nothing."""
    said, remainder = np.array([0.99, 0.8, 1.2, np.nan, 1.0]), np.array([1.0, 1.0, 1.0, 1.0, np.nan])
    for count, expected in ((200.0, [1.0, 0.8, 1.0, 1.0, 1.0]), (5.0, np.ones(5))):
        monkeypatch.setattr(noise, "noise_by_repeats", lambda *_, count=count: (said, np.full(5, count)))
        unused: Any = None
        np.testing.assert_array_equal(noise.noise_floor(unused, unused, remainder), expected)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_the_floor_of_a_model_that_lacks_nothing_is_not_too_low(memory: float) -> None:
    """On average over robots and channels: of two measures of the noise the smaller one would be."""
    ratios = []
    for seed in range(12):
        records, _, counts = found(recording(1, 2.0 * PERIOD, seed, memory))
        remainder = SIZES * (1.0 + np.random.default_rng(seed).standard_normal(3) / np.sqrt(2.0 * 2.0 * counts))
        ratios.append(noise.noise_floor(planted.model(), records, remainder) / SIZES)
    assert abs(np.mean(ratios) - 1.0) < 0.02


@pytest.mark.parametrize("lag", [-30, -1, 0, 1, 25])
def test_two_stretches_differ_by_the_mean_over_what_overlaps(lag: int) -> None:
    first, second = np.random.default_rng(1).normal(size=(2, 40, 3))
    pairs = [(row, row + lag) for row in range(40) if 0 <= row + lag < 40]
    expected = np.mean([np.sum((second[there] - first[here]) ** 2) for here, there in pairs])
    assert noise._difference(first, second, lag) == pytest.approx(expected)


def test_the_lowest_of_a_parabola() -> None:
    for place in (-0.4, 0.0, 0.3):
        three = 2.0 + 5.0 * (np.array([-1.0, 0.0, 1.0]) - place) ** 2
        assert noise._lowest(three) == pytest.approx((2.0, place))
    assert noise._lowest(np.array([1.0, 1.0, 1.0])) == (1.0, 0.0), "a line has none"
    assert noise._lowest(np.array([2.0, 1.0, -5.0]))[1] == 0.0
    assert noise._lowest(5.0 * (np.array([-1.0, 0.0, 1.0]) - 0.3) ** 2 - 1.0)[0] == 0.0, "no mean square is negative"


def test_the_mean_of_standard_deviations_is_over_all_pairs_of_repeats() -> None:
    """Each pair of stretches is one measure; they have as many instants as overlap, as far as these are independent."""
    parts = [recording(1, 8.0, seed) for seed in (2, 3, 4)]
    records, noise, counts = found(*parts)
    pairs = [(0, 1), (0, 2), (1, 2)]
    squares = [0.5 * np.mean((parts[a].effort - parts[b].effort) ** 2, axis=0) for a, b in pairs]
    np.testing.assert_allclose(noise, np.sqrt(np.mean(squares, axis=0)), rtol=1e-3)
    share = len(records.samples) / sum(len(part) for part in records.dense)
    np.testing.assert_allclose(counts, share * 3 * len(parts[0]), rtol=0.01)


def test_what_hardly_overlaps_or_stands_still_or_is_slow_is_no_repeat() -> None:
    whole = recording(1, 24.0, 2)
    first = whole.select(slice(0, 384))
    assert repeated_after(first, whole.select(slice(192, 576))) == pytest.approx(-3.0, abs=1e-3)
    still = replace(first, position=0.0 * first.position)
    assert repeated_after(still, still) is None
    short = whole.select(slice(0, 60))
    assert repeated_after(short, short) is None
    later = np.sin(0.002 * whole.seconds)[:, None]  # a second later it is nearly where it was, and ever farther away
    slow = replace(whole, position=later * np.ones(whole.position.shape[1]))
    assert repeated_after(slow, slow) is None
