"""Efforts that are cut off are told from those that are merely rounded, slow, or the same in every lap."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.signals.effort_quality import SaturationDetector
from geomid_ros.signals.joint_messages import JointReader
from geomid_ros.types import BoolArray, FloatArray

from .feeding import START, read
from .sent import JointMessage

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


@pytest.mark.parametrize("bits", [5, 8])
@pytest.mark.parametrize(("rate", "frequency"), [(1000.0, 0.5), (10.0, 0.01)])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_curve_that_is_rounded_is_taken(rate: float, frequency: float, bits: int, noise: float) -> None:
    """On the top level it stays for up to 4.8 times as long as on the one below, for longer than any fixed time."""
    rng = np.random.default_rng(bits)
    for phase in rng.uniform(0.0, 6.0, size=2):
        clean = rng.uniform(0.8, 1.0) * curve(frequency, rate, 2.5, phase)
        seen = rounded(clean + noise * 2.0 ** (1 - bits) * rng.normal(size=len(clean)), bits)
        assert not np.any(refused(seen, rate))


@pytest.mark.parametrize("rate", [10.0, 15.0, 125.0])
@pytest.mark.parametrize("bits", [0, 10])
def test_the_same_lap_again_and_again_is_taken(rate: float, bits: int) -> None:
    """Each with exactly the same largest effort; at low rates a single message lasts for long."""
    lap = curve(0.25, rate, 1.0) + 0.4 * curve(0.75, rate, 3.0, phase=0.3)
    lap /= 1.2 * np.max(np.abs(lap))
    laps = np.tile(rounded(lap, bits) if bits else lap, 6)
    assert not np.any(refused(laps, rate))


def test_a_joint_that_is_held_while_others_move_is_taken() -> None:
    """Its coarse sensor shows the same all the time, after it came there fast."""
    seen = np.concatenate([rounded(0.3 * curve(1.0, 200.0, 3.0), 8), np.full(400, 0.5)])
    assert not np.any(refused(seen, 200.0, speed=0.0))
    assert np.any(refused(seen, 200.0)), "one that moves is at its limit, as far as one can tell"


def test_what_was_the_largest_before_the_clock_was_set_back_may_be_so_after_it() -> None:
    """Of the time between nothing is known."""
    reader = JointReader(("one",), np.ones(1), np.zeros(1, dtype=np.bool_), MAX_GAP, lambda _: None)
    for begin in (START, START - 10**10):
        for index, effort in enumerate(rounded(curve(0.2, 10.0, 2.0, phase=np.pi / 2), 8).tolist()):
            read(
                reader, JointMessage(begin + index * 10**8, ("one",), (0.1 * index,), (1.0,), (LARGEST * effort + 1.0,))
            )
        reader.restart()


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
