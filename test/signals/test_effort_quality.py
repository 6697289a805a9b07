"""What the numbers of efforts look like: held, coarse, cut about zero, overflowing, copied; and real ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from geomid_ros.signals.effort_quality import EffortFaultDetector
from geomid_ros.signals.ledger import meaning_of
from geomid_ros.types import FloatArray

COUNT, PERIOD = 3000, 10_000_000
NAMES = ("one", "two", "three")


def told(
    efforts: FloatArray, turning: bool = True, piece: int = 50, speed: float = 0.1, period: int = PERIOD
) -> tuple[list[str], list[str]]:
    """What is wrong, and what is noted."""
    found: list[str] = []
    quality = EffortFaultDetector(NAMES, np.full(3, turning), found.append)
    stamps = np.arange(COUNT) * period
    stamps[COUNT // 2 :] += 100_000_000_000  # a pause is no rate
    positions = np.cumsum(speed * np.ones((COUNT, 3)), axis=0) * period * 1e-9
    for begin in range(0, COUNT, piece):
        part = slice(begin, begin + piece)
        quality.add(stamps[part], positions[part], efforts[part])
    by_meaning = {meaning: [one for one in found if meaning_of(one) == meaning] for meaning in ("driver error", "told")}
    assert sum(map(len, by_meaning.values())) == len(found)
    return by_meaning["driver error"], by_meaning["told"]


def usual(noise: float = 0.02, seed: int = 1) -> FloatArray:
    """Efforts as sines of several periods, with noise."""
    rng = np.random.default_rng(seed)
    times = np.arange(COUNT)[:, None] * PERIOD * 1e-9
    size, phase = rng.uniform(0.5, 2.0, (3, 3)), rng.uniform(0.0, 6.0, (3, 3))
    waves = [size[k] * np.sin((0.8 + 0.7 * k) * times + phase[k]) for k in range(3)]
    return np.asarray(np.sum(waves, axis=0) + noise * rng.normal(size=(COUNT, 3)))


def held(effort: FloatArray) -> FloatArray:
    return effort[np.arange(COUNT) // 20 * 20]


def cut(effort: FloatArray) -> FloatArray:
    return np.where(np.abs(effort) < 0.5 * np.std(effort, axis=0), 0.0, effort)


def switched_off(effort: FloatArray) -> FloatArray:
    return np.where((np.arange(COUNT) % 200 < 30)[:, None], 0.0, effort + 2.0)


def overflowing(effort: FloatArray) -> FloatArray:
    limit = np.quantile(np.abs(effort[:, 1]), 0.8)
    effort[:, 1] = (effort[:, 1] + limit) % (2.0 * limit) - limit
    return effort


def copied(effort: FloatArray) -> FloatArray:
    effort[:, 2] = effort[:, 0]
    return effort


def coarse(effort: FloatArray, missing: float = 0.0) -> FloatArray:
    effort[:, 0] = np.round(effort[:, 0])
    effort[np.random.default_rng(2).permutation(COUNT) < missing * COUNT, 0] = np.nan
    effort[0, 0] = np.nan if missing else effort[0, 0]
    return effort


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (held, "all joints change only every 0.2 s"),
        (cut, "all joints drop to exactly zero"),
        (switched_off, "all joints drop to exactly zero"),
        (overflowing, "'two' jump from one end of their range to the other: integer overflow"),
        (copied, "'one', 'three' are identical"),
        (coarse, "'one' come in steps of a quarter or more of their variation"),
        (partial(coarse, missing=0.05), "'one' come in steps of a quarter or more of their variation"),
    ],
)
def test_what_is_wrong_is_told(fault: Callable[[FloatArray], FloatArray], said: str) -> None:
    """Coarse ones are noted, also where some efforts are not measured, the first one, too."""
    wrong, noted = told(fault(usual()))
    (sentence,) = noted if "steps" in said else wrong
    assert said in sentence
    assert len(wrong) + len(noted) == 1


@pytest.mark.parametrize("step", [0.0, 0.1])
@pytest.mark.parametrize("noise", [0.0, 0.02, 3.0])
def test_real_efforts(step: float, noise: float) -> None:
    """Clean, noisy, of noise alone; rounded to a twentieth of what they vary by; also of a driver at 17 Hz."""
    effort = usual(noise, 1)
    for period in (PERIOD, 6 * PERIOD):
        assert told(effort if step == 0.0 else np.round(effort / step) * step, period=period) == ([], [])


def test_a_robot_that_stands_may_send_the_same_for_long() -> None:
    assert told(held(usual()), speed=0.0) == ([], [])


def test_efforts_that_are_not_measured_are_passed_over() -> None:
    effort = usual()
    effort[:, 1] = np.nan
    assert told(effort) == ([], [])


def test_a_few_spikes_are_no_overflow() -> None:
    """From one end of what they make the range to the other."""
    effort = usual()
    places = np.arange(200, len(effort) - 2, 150)
    effort[places, 1] = 20.0 * np.ptp(effort[:, 1])
    effort[places + 1, 1] = -effort[places, 1]
    effort[places + 2, 1] = effort[places, 1]
    assert not any("overflow" in sentence for sentences in told(effort) for sentence in sentences)
