"""Messages in bursts are timed by their number in the row.

Samples move by their positions; velocities of messages tell whether stamps and units are right, and when messages were
measured if the stamps do not.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from geomid_ros.model.samples import Samples
from geomid_ros.signals.clocks import SCALED, MotionClock, RegularClock, in_bursts
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.signals.sampler import LATE, NOW_IN_BURSTS, UNEVEN
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, IntArray

from .feeding import JOINTS, START, Motion, assert_same, balanced, feed, joint_messages, pipeline_of, regular
from .sent import JointMessage
from .spoiled import in_parts, pipeline

MS = 1_000_000  # [ns]
PERIOD = 10 * MS


def received(sizes: IntArray, late: IntArray) -> tuple[IntArray, IntArray]:
    """When messages were measured and, in bursts of these sizes that are late by so much [ns], received."""
    measured = START + PERIOD * np.arange(int(np.sum(sizes)))
    ends = np.cumsum(sizes) - 1
    burst = np.repeat(np.arange(len(sizes)), sizes)
    within = np.arange(len(measured)) - (ends - sizes + 1)[burst]
    return measured, measured[ends][burst] + late[burst] + 10_000 * within


@pytest.mark.parametrize("size", [2, 20])
def test_times_are_those_of_the_measurement(size: int) -> None:
    """To a constant, within the unevenness of the bursts' ends; with another size of bursts, and after a pause."""
    rng = np.random.default_rng(size)
    sizes = np.clip(rng.integers(size - 1, size + 2, 1000 // size), 1, None)
    measured, stamps = received(sizes, rng.integers(0, 2 * MS, len(sizes)))
    assert in_bursts(stamps[:100], 500 * MS)
    clock = RegularClock(stamps[:320])
    assert clock.is_right
    assert clock.period == pytest.approx(PERIOD, rel=3e-3)
    error = clock.times(stamps) - measured
    assert np.max(np.abs(error - np.mean(error))) < 3 * MS
    later = clock.times(stamps + (stamps[-1] - stamps[0]) + 5_000 * MS)
    assert later[0] - stamps[-1] == pytest.approx(5_000 * MS, abs=3 * size * PERIOD)
    assert np.all(np.diff(np.concatenate([later])) > 0)


@pytest.mark.parametrize("lost", [3, 9])
def test_lost_messages_delay_those_after_them_at_once(lost: int) -> None:
    """By as many periods, from the next burst but one on."""
    measured, stamps = received(np.full(60, 10), np.zeros(60, dtype=np.int64))
    clock = RegularClock(stamps[:320])
    kept = np.r_[0:400, 400 + lost : len(stamps)]
    error = (clock.times(stamps[kept]) - measured[kept]) / PERIOD
    assert np.max(np.abs(error[420:] - np.mean(error[:400]))) < 0.5


def test_a_burst_that_comes_early_is_no_step_back() -> None:
    """Times of a burst before its turn follow those before at half a period at least."""
    _, stamps = received(np.full(60, 10), np.zeros(60, dtype=np.int64))
    clock = RegularClock(stamps[:320])
    stamps[400:] -= 60 * MS
    steps = np.diff(clock.times(stamps))
    assert np.min(steps) == pytest.approx(0.5 * clock.period, abs=1.0)
    assert np.median(steps) == pytest.approx(PERIOD, rel=1e-3)


def test_uneven_bursts_are_refused() -> None:
    """Nothing says when their messages were measured: they are refused, and counted, whatever the blocks."""
    rng = np.random.default_rng(3)
    stamps = START + np.cumsum(np.where(rng.random(1000) < 0.15, rng.integers(5 * MS, 450 * MS, 1000), 1000))
    messages = joint_messages(stamps)
    accounts = []
    for ends in ((), range(7, len(messages), 7)):
        target = pipeline(merge=False)
        assert in_parts(target, messages, ends) is None
        accounts.append(target.ledger.topics["joint_states"])
        assert balanced(target, messages)
    assert accounts[0] == accounts[1]
    assert accounts[0].rejected[UNEVEN] >= 640


def test_bursts_that_begin_later_are_named() -> None:
    stamps = regular(0.01, 12.0)
    places = np.arange(len(stamps))
    in_tens = np.where(places < 500, stamps, stamps[np.minimum(places // 10 * 10 + 9, len(stamps) - 1)] + places % 10)
    paused = stamps + np.where(places < 400, 0, 60_000 * MS)
    for expected, sent in ((0, stamps), (0, paused), (1, in_tens)):
        target = pipeline(merge=False)
        in_parts(target, joint_messages(sent), ())
        assert (target.ledger.topics["joint_states"].noted[NOW_IN_BURSTS] > 0) == bool(expected)


STAMPS = regular(0.01, 10.0)
VELOCITY = Motion().derivative(STAMPS, 1)


def fed(velocity: FloatArray | None, seconds: float = 10.0) -> tuple[Samples, str]:
    """Samples of the motion with these velocities ``(N, joints)`` in the messages, and what is noted."""
    messages = joint_messages(STAMPS)
    if velocity is not None:
        messages = [replace(message, velocity=row) for message, row in zip(messages, velocity, strict=True)]
    target = pipeline_of(JOINTS, settings=SignalSettings(period=0.01))
    samples = feed(target, messages[: round(100 * seconds)])
    return samples, " ".join(map(str, target.ledger.topics[JOINT_STATES].noted))


@pytest.mark.parametrize(
    ("factor", "late", "seconds", "noted"),
    [
        (1.0, 0, 10.0, False),
        (1.02, 0, 10.0, False),
        (1.1, 0, 10.0, True),
        (1.1, 0, 2.0, False),
        (0.714, 0, 10.0, True),
        (-1.0, 0, 10.0, False),
        (2.0, 0, 10.0, False),
        (0.5, 1, 10.0, False),
        (1.0, 20, 10.0, False),
        ([1.0, np.nan, 1.0], 0, 10.0, False),
    ],
)
def test_samples_move_by_their_positions_and_velocities_in_another_unit_of_time_are_told(
    factor: float | list[float], late: int, seconds: float, noted: bool
) -> None:
    """As are stamps that run too fast; a joint that is reversed, or a clock off by half, is another fault. Velocities
    that are late are less than the derivatives at the same time, but not in proportion; as a motion begins, so little
    tells nothing."""
    found, notes = fed(np.roll(VELOCITY, late, axis=0) * factor, seconds)
    assert (str(SCALED) in notes) == noted
    assert_same(found, fed(None, seconds)[0], tolerance=0.0)


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_a_joint_that_stands_still_tells_nothing(rate: float) -> None:
    """What moves there is in the last digits; a clock is judged by the others."""
    still = np.arange(3) == 1
    small, factors = np.where(still, 1e-7, 1.0), np.where(still, 0.7, rate)
    messages = [
        replace(m, position=small * m.position, velocity=factors * small * row)
        for m, row in zip(joint_messages(STAMPS), VELOCITY, strict=True)
    ]
    target = pipeline_of(JOINTS, settings=SignalSettings(period=0.01))
    feed(target, messages)
    noted = " ".join(map(str, target.ledger.topics[JOINT_STATES].noted))
    assert ("stamps run 2 times too fast" in noted) == (rate == 2.0)
    assert str(SCALED) not in noted


def republished(source: float, period: float, seconds: float = 40.0, noise: float = 1e-5) -> list[JointMessage]:
    """Messages of a node that repeats the latest measurement of a source with another period [s], and stamps it when it
    publishes; with noise of the positions [rad]."""
    stamps = regular(period, seconds)
    measured = START + np.round(((stamps - START) * 1e-9 // source) * source * 1e9).astype(np.int64)
    errors = dict(zip(measured.tolist(), noise * np.random.default_rng(1).normal(size=(len(stamps), 3)), strict=True))
    sent = joint_messages(measured, velocity=True)
    return [
        replace(message, stamp=int(stamp), position=message.position + errors[when])
        for message, stamp, when in zip(sent, stamps, measured.tolist(), strict=True)
    ]


def arrays(messages: list[JointMessage]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Stamps, positions and velocities."""
    stamps = np.array([message.stamp for message in messages])
    return stamps, np.array([m.position for m in messages]), np.array([m.velocity for m in messages])


SOURCES = {"slower": (0.0340, 1 / 30), "faster": (0.0327, 1 / 30), "much faster": (0.01, 1 / 30)}


@pytest.mark.parametrize("source", ["slower", "much faster"])
def test_samples_move_as_measured_whenever_messages_were_published(source: str) -> None:
    """Accelerations are as far from the truth as those of a source that stamps its messages itself, nearly. From the
    stamps alone they are several times as far."""
    messages = republished(*SOURCES[source])

    def error(sent: list[JointMessage]) -> tuple[float, bool]:
        target = pipeline_of(JOINTS, settings=SignalSettings(cutoff=4.0))
        samples = feed(target, sent)
        later = samples.select(samples.stamps > START + 10_000 * MS)
        # The age of the latest measurement is unknown, but for its changes: the truth may be so much earlier.
        ages = np.arange(0, 40 * MS, MS)
        apart = [later.acceleration - Motion().derivative(later.stamps - age, 2) for age in ages]
        return min(float(np.sqrt(np.mean(one**2))) for one in apart), LATE in target.ledger.topics[JOINT_STATES].noted

    found, noted = error(messages)
    by_stamps, without_velocities = error([replace(message, velocity=()) for message in messages])
    assert noted
    assert not without_velocities
    assert found < by_stamps / 3.0


@pytest.mark.parametrize("late", [slice(0, 150), slice(0, 1200), slice(400, 1200)])
def test_times_from_the_motion_do_not_depend_on_blocks(late: slice) -> None:
    """They increase, also where messages come at once, stand for a pause, lack a velocity, or were measured when they
    were stamped. Stamps that are right for long are not looked at again."""
    messages = joint_messages(regular(1 / 30, 40.0), velocity=True)[:1200]
    messages[late] = republished(0.0327, 1 / 30)[late]
    stamps, position, velocity = arrays(messages)
    for begin in (late.start + 130, 900):
        stamps[begin : begin + 10] = stamps[begin] + np.arange(10)
    stamps[600:] += 5_000 * MS
    position[22:28], velocity[22:28] = position[22], 0.0
    velocity[700:720, 1] = velocity[50:60] = np.nan
    expected = MotionClock(3, 1e9 / 30).times(stamps, position, velocity)
    assert np.all(np.diff(expected) > 0)
    assert np.any(expected != stamps) == (late.start == 0)
    for size in (1, 7, 400):
        clock = MotionClock(3, 1e9 / 30)
        parts = [slice(begin, begin + size) for begin in range(0, len(stamps), size)]
        times = [clock.times(stamps[part], position[part], velocity[part]) for part in parts]
        np.testing.assert_array_equal(np.concatenate(times), expected)


WRONG_VELOCITIES = {
    "none": lambda v: v,
    "late": lambda v: np.roll(v, 3, axis=0),
    "degrees": np.degrees,
    "half": lambda v: 0.5 * v,
    "one reversed": lambda v: v * [1, -1, 1],
    "noisy": lambda v: v + 0.02 * np.random.default_rng(2).normal(size=v.shape),
}
WRONG_POSITIONS = {
    "none": lambda p: p,
    "noisy": lambda p: p + 1e-3 * np.random.default_rng(3).normal(size=p.shape),
    "coarse": lambda p: 1e-3 * np.rint(1e3 * p),
}
MOVING = {"all": np.eye(3), "alike": np.outer([1, 0, 0], [1, 2, 3]), "one": np.diag([0, 1, 0])}


@pytest.mark.parametrize("velocities", WRONG_VELOCITIES)
def test_right_stamps_are_kept_whatever_else_is_wrong(velocities: str) -> None:
    stamps, motion = regular(0.01, 20.0), Motion()
    for positions, moving in product(WRONG_POSITIONS, MOVING):
        position = WRONG_POSITIONS[positions](motion.derivative(stamps, 0) @ MOVING[moving])
        velocity = WRONG_VELOCITIES[velocities](motion.derivative(stamps, 1) @ MOVING[moving])
        clock = MotionClock(3, PERIOD)
        np.testing.assert_array_equal(clock.times(stamps, position, velocity), stamps, err_msg=f"{positions} {moving}")
        assert not clock.is_used, (positions, moving)


def test_right_stamps_are_kept_where_velocities_are_differences_over_a_nominal_period() -> None:
    """Then velocities would explain every stamp away: positions, which are smooth in the stamps, say that these are
    right."""
    rng = np.random.default_rng(4)
    stamps = regular(1 / 30, 30.0) + rng.integers(-6 * MS, 6 * MS, 900)
    position = Motion().derivative(stamps, 0) + 1e-4 * rng.normal(size=(900, 3))
    velocity = np.diff(position, axis=0, prepend=position[:1]) * 30.0
    np.testing.assert_array_equal(MotionClock(3, 1e9 / 30).times(stamps, position, velocity), stamps)


def test_late_times_do_not_drift_away_from_the_stamps() -> None:
    """Velocities that are 3 % too large do not move them, and noise of velocities at rest hardly does."""
    messages = republished(0.0327, 1 / 30, 120.0)
    stamps, position, velocity = arrays(messages)
    still = np.arange(len(stamps)) > 2000
    position[still] = position[2000]
    velocity = np.where(still[:, None], 0.02 * np.random.default_rng(5).normal(size=position.shape), 1.03 * velocity)
    clock = MotionClock(3, 1e9 / 30)
    lags = stamps - clock.times(stamps, position, velocity)
    assert np.any(lags != 0)
    assert np.max(np.abs(lags)) < 35 * MS
