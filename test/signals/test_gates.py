"""What neighbours and limits do not allow is refused, and what is real passes; in blocks of any size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from files.recordings import BAGS

from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.gates import (
    CLOCK_SET,
    EARLY,
    FROM_THE_FUTURE,
    LEAP,
    NOT_LATER,
    PAUSE,
    SET_BACK,
    SPIKE_OR_CONTACT,
    TOO_OLD,
    Gate,
    ReorderBuffer,
    _chi_square,
    _edge_state,
)
from geomid_ros.signals.message_batch import NO_MESSAGES, MessageBatch
from geomid_ros.signals.messages import JOINT_STATES, Block, Decoder
from geomid_ros.signals.pipeline import UNDECIDED
from geomid_ros.signals.sampler import IN_BURSTS
from geomid_ros.signals.settings import MESSAGES_UNTIL_DECISION
from geomid_ros.types import FloatArray, IntArray

from .feeding import START, blocks, joint_messages, regular, wrench_messages
from .spoiled import pipeline

SHARED = Path(__file__).parents[3] / "shared" / "data"
RECORDINGS = {
    "simulated": (BAGS / "arm7", BAGS / "arm7.urdf"),
    "ur10": (SHARED / "ur10_unisa_rosbag2/ur10_exciting_trajectory", SHARED / "ur10_unisa_rosbag2/ur10.urdf"),
}
FIRST = 300  # message that is spoiled


@cache
def recorded(name: str) -> tuple[Session, Block]:
    """The robot of a bag, and its joint messages."""
    bag, urdf = RECORDINGS[name]
    if not bag.exists():
        pytest.skip(f"{bag} is absent")
    with Bag(bag) as opened:
        raw = [(JOINT_STATES, message.data) for message in opened.raw_messages(["/joint_states"])]
    (block,) = [block for block in Decoder().blocks(raw, lambda *_: None) if len(block.stamps) > 1]
    return Session(read_urdf(urdf), Configuration(), urdf.name), block


class Recording:
    """The joint messages of a bag as arrays."""

    def __init__(self, name: str) -> None:
        self.session, block = recorded(name)
        self.names = block.names
        self.stamps: IntArray = block.stamps.copy()
        self.position, self.velocity, self.effort = (array.copy() for array in block.arrays)
        self.period = float(np.median(np.diff(self.stamps))) * 1e-9
        self.joint = int(np.argmax(np.ptp(self.position, axis=0)))
        self.loaded = int(np.argmax(np.ptp(self.effort, axis=0)))
        self.range = float(np.ptp(self.effort[:, self.loaded]))

    def chosen(self, count: int) -> IntArray:
        """Messages to spoil, far from each other."""
        return np.linspace(min(FIRST, len(self.stamps) - 40), len(self.stamps) - 20, count).astype(np.int64)

    def thin_out(self, period: float) -> None:
        """Leave messages that are at least this period [s] apart."""
        self._keep(slice(None, None, int(np.ceil(period / self.period - 0.01))))

    def shorten(self, count: int) -> None:
        """Leave so many messages."""
        self._keep(slice(count))

    def _keep(self, kept: slice) -> None:
        self.stamps, self.position, self.velocity, self.effort = (
            array[kept] for array in (self.stamps, self.position, self.velocity, self.effort)
        )

    def read(self, size: int = 4096, without: IntArray | None = None) -> tuple[Samples, dict[str, int], dict[str, int]]:
        """Samples, why messages were refused, and what was noted."""
        kept = np.ones(len(self.stamps), dtype=bool)
        kept[[] if without is None else without] = False
        arrays = [array[kept] for array in (self.position, self.velocity, self.effort)]
        stamps, pipeline = self.stamps[kept], self.session.new_pipeline()
        for begin in range(0, len(stamps), size):
            part = slice(begin, begin + size)
            order = np.arange(len(stamps[part]))
            pipeline.push([Block(JOINT_STATES, order, stamps[part], self.names, tuple(a[part] for a in arrays))])
        pipeline.release()
        assert pipeline.waiting_count == 0
        samples, account = pipeline.collect(), pipeline.ledger.topics[JOINT_STATES]
        assert samples is not None
        assert account.received == len(stamps)
        return samples, dict(account.rejected), dict(account.noted)


@pytest.fixture(params=RECORDINGS)
def recording(request: pytest.FixtureRequest) -> Recording:
    return Recording(request.param)


def assert_equal(actual: Samples, expected: Samples) -> None:
    for name, array in expected.arrays.items():
        np.testing.assert_allclose(actual.arrays[name], array, rtol=0, atol=1e-9, err_msg=name)


def contact(recording: Recording, begin: int) -> FloatArray:
    """A collision of 40 ms, twice as high as all efforts together."""
    time = (recording.stamps - recording.stamps[begin]) * 1e-9
    return np.where((time >= 0.0) & (time <= 0.04), 2.0 * recording.range * np.sin(np.pi * time / 0.04), 0.0)


def far_off(recording: Recording, places: IntArray) -> None:
    recording.position[places, recording.joint] += 1.5


def jumps(recording: Recording, places: IntArray) -> None:
    recording.position[places, recording.joint] += 0.3


def spikes(recording: Recording, places: IntArray) -> None:
    recording.effort[places, recording.loaded] -= 3.0 * recording.range


def early(recording: Recording, places: IntArray) -> None:
    recording.stamps[places] += round((4.5 * recording.period + 0.02) * 1e9)


FAULTS: dict[str, tuple[Callable[[Recording, IntArray], None], str]] = {
    "positions far off": (far_off, "jumps, and back"),
    "positions off": (jumps, "jumps, and back"),
    "spikes of effort": (spikes, "is a spike"),
    "stamps ahead": (early, EARLY),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_refused_and_leaves_no_trace(fault: str, recording: Recording) -> None:
    """The samples are those of a recording without these messages; nothing else is refused."""
    spoil, reason = FAULTS[fault]
    places = recording.chosen(4)
    expected, before, _ = recording.read(without=places)
    spoil(recording, places)
    samples, refused, _ = recording.read()
    assert_equal(samples, expected)
    new = {why: count - before.get(why, 0) for why, count in refused.items() if count != before.get(why, 0)}
    assert sum(new.values()) == len(places)
    assert all(reason in why for why in new)


@pytest.mark.parametrize(
    ("recording", "leap"), [("simulated", 2.0 * np.pi - 0.8), ("ur10", 1.5)], indirect=["recording"]
)
def test_a_position_that_leaps_begins_a_segment(recording: Recording, leap: float) -> None:
    """As of a simulation that was reset: nothing is refused, what is far from the leap is as it was, and no sample
    moves across it. By nearly a turn is not by a turn."""
    expected, _, before = recording.read()
    recording.position[700:, recording.joint] += leap
    samples, refused, noted = recording.read()
    assert (refused, [note for note in noted if note not in before]) == ({}, [LEAP])
    shift = np.where(expected.stamps < recording.stamps[700], 0.0, leap)
    common, own, whole = np.intersect1d(samples.stamps, expected.stamps, return_indices=True)
    assert len(common) == len(samples) > 0.8 * len(expected)
    joint = recording.session.robot.joint_names.index(recording.names[recording.joint])
    apart = samples.position[own, joint] - expected.position[whole, joint]
    np.testing.assert_allclose(apart, shift[whole], atol=1e-9)
    np.testing.assert_allclose(samples.velocity[own], expected.velocity[whole], atol=1e-8)


def test_a_joint_that_moves_does_not_leap(recording: Recording) -> None:
    """Where messages are missing, or a joint is always faster than its limit."""
    assert LEAP not in recording.read(without=np.arange(700, 710))[2]
    recording.position *= 3.0
    assert LEAP not in recording.read()[2]


def test_a_driver_that_wraps_is_unwrapped(recording: Recording) -> None:
    """In the middle of the joint's way; no other number changes, and it is said."""
    expected, _, noted = recording.read()
    whole = recording.position[:, recording.joint]
    middle = float(np.median(whole))
    recording.position[:, recording.joint] = np.remainder(whole - middle, 2.0 * np.pi) + middle
    samples, _, now = recording.read()
    turns = (samples.position - expected.position) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[:1]) * np.ones_like(turns), atol=1e-9)
    np.testing.assert_allclose(samples.velocity, expected.velocity, atol=1e-8)
    assert [note for note in now if note not in noted] == [
        f"positions of '{recording.names[recording.joint]}' jump by whole turns: unwrapped"
    ]


def test_what_is_real_passes(recording: Recording) -> None:
    """A recording as it is, a collision of 40 ms, a payload, a joint that stops at once, and lost messages."""
    _, before, _ = recording.read()
    assert before == {}
    recording.effort[:, recording.loaded] += contact(recording, 700)
    assert recording.read()[1] == {}
    recording.effort[1000:] += 0.3 * np.ptp(recording.effort, axis=0)
    assert recording.read()[1] == {}
    stop = round(0.3 / recording.period)
    recording.position[900 : 900 + stop, recording.joint] = recording.position[900, recording.joint]
    assert recording.read()[1] == {}
    lost = np.flatnonzero(np.random.default_rng(1).random(len(recording.stamps)) < 0.05)
    assert recording.read(without=lost)[1] == {}


def test_what_is_over_sooner_than_a_collision_is_a_spike(recording: Recording) -> None:
    """Two messages of it."""
    recording.effort[700:702, recording.loaded] += 2.0 * recording.range
    refused = recording.read()[1]
    assert list(refused.values()) == [2]


@pytest.mark.parametrize(("recording", "period"), [("simulated", 0.02), ("ur10", 0.04)], indirect=["recording"])
def test_what_slow_messages_cannot_tell_is_said(period: float, recording: Recording) -> None:
    """At 50 Hz a contact of 40 ms is as short as a spike, and neither is the robot's effort; at 25 Hz
    it may be motion."""
    recording.thin_out(period)
    refused, noted = recording.read()[1:]
    assert refused == {}
    assert not any(note.endswith(": kept") for note in noted)
    recording.shorten(400)
    places = recording.chosen(4)
    without = recording.read(without=places)[0]
    spikes(recording, places)
    samples, refused, noted = recording.read()
    name = recording.names[recording.loaded]
    if period < 0.03:
        assert refused == {f"effort of '{name}' {SPIKE_OR_CONTACT}": 4}
        assert_equal(samples, without)
    else:
        assert refused == {}
        assert noted[f"effort of '{name}' {SPIKE_OR_CONTACT}: kept"] == 4
    again = recording.read(size=1)
    assert_equal(again[0], samples)
    assert again[1:] == (refused, noted)


@pytest.mark.parametrize("size", [2, 5])
def test_the_period_of_bursts_and_pairs_is_that_of_their_span(size: int) -> None:
    recording = Recording("simulated")
    period = recording.read()[0].stamps[:2]
    places = np.arange(len(recording.stamps))
    recording.stamps = recording.stamps[places // size * size] + 1000 * (places % size)
    samples, _, noted = recording.read()
    assert np.diff(samples.stamps[:2]) == np.diff(period)
    assert IN_BURSTS in noted


@pytest.mark.parametrize(("recording", "step"), [("simulated", 0.06), ("ur10", -0.2)], indirect=["recording"])
def test_a_clock_that_is_set_begins_a_segment(step: float, recording: Recording) -> None:
    """Told by the motion; samples never mix what came before and after. Messages that are lost are no clock."""
    place, count = int(np.argmax(np.abs(np.gradient(recording.position[:, recording.joint])[300:-300]))) + 300, 0.06
    clean = recording.read()[0]
    recording.stamps[place:] += round(step * 1e9)
    samples, refused, noted = recording.read()
    assert (refused, CLOCK_SET in noted) == ({}, True)
    before = samples.stamps < recording.stamps[place - 1] - 1_000_000_000
    first = int(np.argmax(~before))
    for name in ("position", "effort"):
        np.testing.assert_array_equal(samples.arrays[name][:first], clean.arrays[name][:first])
        order = [recording.names.index(joint) for joint in recording.session.robot.joint_names]
        low, high = (bound(getattr(recording, name)[:, order], axis=0) for bound in (np.min, np.max))
        margin = 0.02 * (high - low)
        assert np.all((samples.arrays[name] >= low - margin) & (samples.arrays[name] <= high + margin))
    recording.stamps[place:] -= round(step * 1e9)
    lost = np.arange(place, place + round(count / recording.period))
    assert CLOCK_SET not in recording.read(without=lost)[2]


def test_a_publisher_that_ends_holds_nothing_for_ever() -> None:
    """Its last message is off, and no more come: it passes, and so does what came behind it on other topics."""
    joints = joint_messages(regular(0.01, 3.0))
    off = replace(joints[-1], position=joints[-1].position + 2.0)
    wrench = wrench_messages(regular(0.001, 6.0, offset=2.99))
    target = pipeline(merge=False)
    for begin in range(0, len(joints), 100):
        target.push(blocks([*joints[:-1], off][begin : begin + 100]))
    for message in wrench[: MESSAGES_UNTIL_DECISION - 1]:
        target.push(message)
    assert "/wrench" not in target.ledger.topics
    for message in wrench[MESSAGES_UNTIL_DECISION - 1 : MESSAGES_UNTIL_DECISION + 20]:
        target.push(message)
    assert target.waiting_count == 0
    assert target.ledger.topics[JOINT_STATES].accepted == len(joints)
    assert target.ledger.topics["/wrench"].accepted == MESSAGES_UNTIL_DECISION + 20


def test_what_is_held_at_the_end_is_dropped_and_counted() -> None:
    joints = joint_messages(regular(0.01, 3.0))
    target = pipeline(merge=False)
    target.push(blocks([*joints[:-3], replace(joints[-3], stamp=joints[-3].stamp + 200_000_000)]))
    assert target.waiting_count == 1
    target.release()
    assert target.waiting_count == 0
    assert target.ledger.topics[JOINT_STATES].dropped == {UNDECIDED: 1}


def test_what_is_decided_anew_is_noted_once() -> None:
    """A sensor's pause after the joints' clock was set: it is looked at again with the new time."""
    back, gap = 100_000_000_000, 3_000_000_000
    joints, wrench = joint_messages(regular(0.01, 1.0)), wrench_messages(regular(0.01, 1.0))
    messages = [m for pair in zip(joints, wrench, strict=True) for m in pair]
    again = [replace(m, stamp=m.stamp - back + (gap if m.topic == "/wrench" else 0)) for m in messages]
    later = [replace(m, stamp=m.stamp + 10_000_000_000) for m in again]
    notes = []
    for size in (1, len([*messages, *again, *later])):
        target = pipeline(merge=False)
        every = [*messages, *again, *later]
        for begin in range(0, len(every), size):
            target.push(blocks(every[begin : begin + size]))
        target.release()
        notes.append(target.ledger.topics["/wrench"].noted)
    assert notes[0] == notes[1]


def test_at_the_end_what_waited_behind_others_is_used() -> None:
    """A sensor that says one wrong stamp and dies costs no message of the joints."""
    joints, (wrench, *_) = joint_messages(regular(0.01, 3.0)), wrench_messages(regular(0.01, 3.0))
    target = pipeline(merge=False)
    target.push(blocks([wrench, replace(wrench, stamp=wrench.stamp + 50_000_000_000), *joints]))
    assert target.waiting_count == 1 + len(joints)
    target.release()
    assert target.waiting_count == 0
    assert target.ledger.topics["/wrench"].dropped == {UNDECIDED: 1}
    assert target.ledger.topics[JOINT_STATES].accepted == len(joints)


def test_where_a_motion_ends_is_as_sure_as_it_scatters() -> None:
    """Place and speed at the end of noisy parabolas, and what is said of their variances."""
    rng, stamps, sigma = np.random.default_rng(0), 10_000_000 * np.arange(-19, 1), 1e-3
    time = 1e-9 * stamps[:, None]
    true = rng.normal(size=(3, 2000))
    found, variances = _edge_state(
        stamps, true[0] + true[1] * time + true[2] * time**2 + sigma * rng.normal(size=(20, 2000))
    )
    np.testing.assert_allclose(np.var(found - true[:2], axis=1), np.mean(variances, axis=1), rtol=0.1)
    assert np.mean(variances[0]) < sigma**2


def test_the_time_between_two_pieces_of_a_motion_is_the_likely_one() -> None:
    """Of a motion with a constant acceleration, whose speed changes between them: that time and no other."""
    noise, start, time = np.full((2, 3), 1e-6), np.array([[0.1, -0.2, 0.3], [0.4, 0.1, -0.3]]), 0.7
    slope = np.array([0.2, -0.1, 0.3])
    end = np.array([start[0] + start[1] * time + 0.5 * slope * time**2, start[1] + slope * time])
    assert _chi_square((start, noise), (end, noise), time) == pytest.approx(0.0, abs=1e-12)
    assert _chi_square((start, noise), (end, noise), time + 0.1) > 100.0


MAX_GAP = 500_000_000
PERIOD = 10_000_000
LATE = START - 100 * MAX_GAP


def judged(*stamps: int, others: int = 0) -> tuple[list[int], list[str], list[str], int]:
    """What passes, why the others are refused, the turns that time takes, and how many are held after so many
    messages of other topics."""
    notes: list[str] = []
    gate, used, refused, turns = Gate(MAX_GAP), [], [], []
    for place, stamp in enumerate([*stamps, *[None] * (others > 0)]):
        new = NO_MESSAGES
        if stamp is not None:
            new = MessageBatch(np.array([place]), np.array([stamp]), np.zeros((1, 6)), np.full(1, None))
        messages, noted = gate.decide(new, place if len(new) else place - 1 + others)
        used += messages.stamps[messages.is_usable].tolist()
        refused += messages.refusals[~messages.is_usable].tolist()
        turns += [answer.noted for answer in noted.values() if answer.begins]
        notes += [answer.noted for answer in noted.values() if not answer.begins]
    return used, refused, [*turns, *notes], len(gate.waiting)


def run(begin: int, count: int, period: int = PERIOD) -> list[int]:
    return [begin + period * index for index in range(count)]


BEFORE, AFTER, LATER = run(START, 20), run(START + 20 * PERIOD, 5), START + 10 * MAX_GAP
FAR, SLOW = START + 2 * MAX_GAP, run(START + 2 * MAX_GAP, 8, 2 * MAX_GAP)
JUDGED = {
    **{  # a few late messages are no clock that was set back
        f"{count} late": ([*BEFORE, *run(LATE, count), *AFTER], 0, (BEFORE + AFTER, [TOO_OLD] * count, [], 0))
        for count in (1, 2, 5, 9)
    },
    "a clock that was set back": (BEFORE + run(LATE, 30), 0, (BEFORE + run(LATE, 30), [], [SET_BACK], 0)),
    "one from the future": ([*BEFORE, LATER, *AFTER], 0, (BEFORE + AFTER, [FROM_THE_FUTURE], [], 0)),
    "two in the future": ([*BEFORE, *run(LATER, 2)], 0, (BEFORE + run(LATER, 2), [], [PAUSE], 0)),
    **{  # a topic slower than the longest gap takes two more messages to tell
        f"{count} slow": (
            [START, *SLOW[:count]], 0, ([START, *SLOW[:settled]], [], [PAUSE] * settled, count - settled)
        )
        for count, settled in ((1, 0), (2, 0), (3, 1), (8, 6))
    },
    "nearly decided": ([START, FAR], MESSAGES_UNTIL_DECISION - 1, ([START], [], [], 1)),
    "decided without more": ([START, FAR], MESSAGES_UNTIL_DECISION, ([START, FAR], [], [PAUSE], 0)),
    "one late, no more": ([START, LATE], MESSAGES_UNTIL_DECISION, ([START], [TOO_OLD], [], 0)),
    "two late, no more": (
        [START, *run(LATE, 2)], MESSAGES_UNTIL_DECISION, ([START, *run(LATE, 2)], [], [SET_BACK], 0)
    ),
    "the longest gap": ([START, START + MAX_GAP], 0, ([START, START + MAX_GAP], [], [], 0)),
    "a longer gap": ([START, START + MAX_GAP + 1], 0, ([START], [], [], 1)),
    "as far back": ([START, START - MAX_GAP], 0, ([START], [NOT_LATER], [], 0)),
    "farther back": ([START, START - MAX_GAP - 1], 0, ([START], [], [], 1)),
    "a pause is shown within the longest gap": (
        [START, LATER, LATER + MAX_GAP], 0, ([START, LATER, LATER + MAX_GAP], [], [PAUSE], 0)
    ),
    "and not beyond": ([START, LATER, LATER + MAX_GAP + 1], 0, ([START], [], [], 2)),
    "late and future ones confirm nothing": (
        [START, LATE, LATER, LATE], 0, ([START], [TOO_OLD, FROM_THE_FUTURE], [], 1)
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", JUDGED)
def test_which_stamps_pass(case: str) -> None:
    stamps, others, expected = JUDGED[case]
    assert judged(*stamps, others=others) == expected


@pytest.mark.parametrize("earlier", [0, 1, MAX_GAP])
def test_one_that_comes_again_or_late_confirms_no_pause(earlier: int) -> None:
    later = START + 10 * MAX_GAP
    used, refused, turns, held = judged(START, later, later - earlier)
    assert (used, turns, held + len(refused)) == ([START], [], 2)
    after = run(later + PERIOD, 3)
    assert judged(START, later, later - earlier, *after) == ([START, later, *after], [NOT_LATER], [PAUSE], 0)


def test_sources_go_on_in_the_order_in_which_they_came_first() -> None:
    """Whatever their names are: what is told of them, and what they wait for each other, does not change by chance."""
    sources = [(f"/wrench{number}", ()) for number in range(12)]
    admission = ReorderBuffer(lambda _: Gate(MAX_GAP), lambda *_: None)
    for begin in range(0, len(sources), 6):
        new = {
            source: MessageBatch(np.array([place]), np.array([START]), np.zeros((1, 6)), np.full(1, None))
            for place, source in enumerate(sources[begin : begin + 6], begin)
        }
        (admitted,) = admission.take(new, begin + 5)
    assert list(admitted) == sources
