"""What the numbers of efforts look like: held, coarse, cut about zero, overflowing, copied; and real ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from geomid_ros.signals.effort_quality import EffortFaultDetector, SaturationDetector
from geomid_ros.signals.joint_messages import JointReader
from geomid_ros.signals.ledger import meaning_of
from geomid_ros.types import BoolArray, FloatArray

from .feeding import START

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


@pytest.mark.parametrize("noise", [0.0, 0.02, 3.0])
def test_real_efforts(noise: float) -> None:
    """Clean, noisy, of noise alone; rounded to a twentieth of what they vary by; also of a driver at 17 Hz. And some
    that are not measured."""
    effort = usual(noise, 1)
    for period in (PERIOD, 6 * PERIOD):
        assert told(effort, period=period) == told(np.round(effort / 0.1) * 0.1, period=period) == ([], [])
    effort[:, 1] = np.nan
    assert told(effort) == ([], [])


def test_a_robot_that_stands_may_send_the_same_for_long() -> None:
    assert told(held(usual()), speed=0.0) == ([], [])


def test_a_few_spikes_are_no_overflow() -> None:
    """From one end of what they make the range to the other."""
    effort = usual()
    places = np.arange(200, len(effort) - 2, 150)
    effort[places, 1] = 20.0 * np.ptp(effort[:, 1])
    effort[places + 1, 1] = -effort[places, 1]
    effort[places + 2, 1] = effort[places, 1]
    assert not any("overflow" in sentence for sentences in told(effort) for sentence in sentences)


LARGEST = 40.0  # [N m]
MAX_GAP = 500_000_000


def curve(frequency: float, rate: float, periods: float, phase: float = 1.0) -> FloatArray:
    """A sinusoid of size one."""
    return np.sin(2.0 * np.pi * frequency * np.arange(int(periods / frequency * rate)) / rate + phase)


def rounded(values: FloatArray, bits: int) -> FloatArray:
    """As a sensor of so many bits from -1 to 1 shows them."""
    steps = 2.0 ** (bits - 1)
    return np.asarray(np.round(values * steps) / steps)


def refused(efforts: FloatArray, rate: float, speed: float = 1.0) -> BoolArray:
    """Which messages are not taken with the effort of a joint at this ``speed``, beside one that moves and is well."""
    reader = JointReader(("one", "other"), np.ones(2), np.zeros(2, dtype=np.bool_), MAX_GAP, lambda _: None)
    times = np.arange(len(efforts)) / rate
    stamps = START + np.round(times * 1e9).astype(np.int64)
    ones = np.ones(len(times))
    pairs = ((speed * times, times), (speed * ones, ones), (LARGEST * efforts, 1.0 + times))
    numbers = np.stack([np.column_stack(pair) for pair in pairs], axis=1)
    values, refusals = reader.read(stamps, numbers)
    assert all(refusal is None or "effort of 'one' saturated" in refusal for refusal in refusals)
    lasting = np.isnan(values[:, 4])  # the equation is left out
    return lasting | np.array([refusal is not None for refusal in refusals])


@pytest.mark.parametrize("bits", [0, 8])
@pytest.mark.parametrize(("rate", "frequency"), [(1000.0, 1.0), (100.0, 0.3), (10.0, 0.03)])
def test_a_curve_that_is_cut_off_is_refused_where_it_is(rate: float, frequency: float, bits: int) -> None:
    """At 70 % of its size, for half of the time; and nowhere else, but for the beginning of each time."""
    values = np.clip(curve(frequency, rate, 3.0, phase=0.1) / 0.7, -1.0, 1.0)
    seen = rounded(values, bits) if bits else values
    cut_off, found = np.abs(seen) == 1.0, refused(seen, rate)
    assert not np.any(found & ~cut_off)
    assert np.sum(found) > 0.6 * np.sum(cut_off)


@pytest.mark.parametrize(("rate", "frequency"), [(1000.0, 0.5), (10.0, 0.01)])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_curve_that_is_rounded_is_taken(rate: float, frequency: float, noise: float) -> None:
    """On the top level it stays for up to 4.8 times as long as on the one below, for longer than any fixed time."""
    for bits in (5, 8):
        rng = np.random.default_rng(bits)
        clean = rng.uniform(0.8, 1.0) * curve(frequency, rate, 2.5, rng.uniform(0.0, 6.0))
        seen = rounded(clean + noise * 2.0 ** (1 - bits) * rng.normal(size=len(clean)), bits)
        assert not np.any(refused(seen, rate))


@pytest.mark.parametrize("rate", [10.0, 125.0])
def test_the_same_lap_again_and_again_is_taken(rate: float) -> None:
    """Each with exactly the same largest effort; at low rates a single message lasts for long."""
    lap = curve(0.25, rate, 1.0) + 0.4 * curve(0.75, rate, 3.0, phase=0.3)
    lap /= 1.2 * np.max(np.abs(lap))
    for each in (lap, rounded(lap, 10)):
        assert not np.any(refused(np.tile(each, 6), rate))


def test_a_joint_that_is_held_while_others_move_is_taken() -> None:
    """Its coarse sensor shows the same all the time, after it came there fast."""
    seen = np.concatenate([rounded(0.3 * curve(1.0, 200.0, 3.0), 8), np.full(400, 0.5)])
    assert not np.any(refused(seen, 200.0, speed=0.0))
    assert np.any(refused(seen, 200.0)), "one that moves is at its limit, as far as one can tell"


@pytest.mark.parametrize(("rate", "longest"), [(10.0, 6), (100.0, 6), (1000.0, 50)])
def test_an_effort_that_is_the_largest_for_a_moment_is_taken(rate: float, longest: int) -> None:
    """For six messages, and for fifty milliseconds; it comes there at once, from far below, while the joint moves."""
    low = 0.3 * curve(rate / 50.0, rate, 1.0)
    for count, expected in ((longest - 1, False), (2 * longest, True)):
        pulses = np.concatenate([np.concatenate([low + 1e-3 * lap, np.full(count, 1.0), low]) for lap in range(3)])
        found = refused(pulses, rate)
        assert np.any(found) == expected
        assert not np.any(found & (pulses < 1.0))


@pytest.mark.parametrize("held", [10, 20, 50])
def test_efforts_that_a_driver_renews_seldom_are_not_saturated(held: int) -> None:
    """Some of them are the largest so far, and as long the same as the others; but one that stays is."""
    values = curve(0.31, 100.0, 6.0) * np.linspace(0.5, 1.0, int(6.0 / 0.31 * 100.0))
    seen = values[np.arange(len(values)) // held * held]
    assert not np.any(refused(seen, 100.0))
    cut_off = np.clip(seen, -0.4, 0.4)
    assert np.any(refused(cut_off, 100.0))


def test_nothing_is_saturated_before_a_smaller_effort_has_changed_while_the_robot_moved() -> None:
    """The robot stands, and the driver renews its efforts seldom: the first of the motion is the largest so far."""
    effort = np.repeat([0.2, 0.1, 0.5, 0.3, 0.6], 20)[:, None]
    moving = np.arange(len(effort)) > 40
    stamps = START + 10_000_000 * np.arange(len(effort))
    found = SaturationDetector(1).saturated(stamps, effort, 1.0 * moving[:, None], moving)
    assert not np.any(found)
