"""The catalogue's faults that lie in single messages: each costs itself, is named, and leaves no trace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from files.recordings import Recorded

from .direct import Direct
from .rig import ERROR, GOOD, OK, WARN
from .spoiling import changed, entry, in_frame, later, stamp_of, stamped, with_force

NAN, INFINITY = float("nan"), float("inf")
SECOND = 1_000_000_000


@dataclass(frozen=True)
class Case:
    """``spoil`` makes bad messages of the last joint message and the last wrench, to be published right after them.

    The diagnostics' message must have every one of ``says``.
    """

    spoil: Callable[[Recorded, Recorded], list[Recorded]]
    says: tuple[str, ...]
    level: bytes = WARN


def joint(make: Callable[[Recorded], Recorded]) -> Callable[[Recorded, Recorded], list[Recorded]]:
    """A bad joint message."""
    return lambda joints, _: [make(joints)]


def wrench(make: Callable[[Recorded], Recorded]) -> Callable[[Recorded, Recorded], list[Recorded]]:
    """A bad wrench."""
    return lambda _, wrench: [make(wrench)]


def prefixed(item: Recorded) -> Recorded:
    return changed(item, name=[f"left_{name}" for name in item.message.name])


def twice(item: Recorded) -> Recorded:
    first, *_, last = item.message.name
    return changed(item, name=[first, first, last])


def misshapen(item: Recorded) -> Recorded:
    """A nanosecond part of a billion and more."""
    message = stamped(item, stamp_of(item))
    message.message.header.stamp.nanosec = 1_500_000_000
    return message


EFFORT = "joint_states rejected: effort of 'joint3' missing or not finite"  # the second of the messages
POSITION = "joint_states rejected: position of 'joint2' not finite"
STAMP = "joint_states rejected: stamp"
DRIVER = "joint_states rejected: driver error:"


CASES = {
    "1-nan-effort": Case(joint(lambda m: entry(m, "effort", 1, NAN)), (EFFORT,)),
    "2-nan-position": Case(joint(lambda m: entry(m, "position", 0, NAN)), (POSITION,)),
    "3-infinite": Case(
        lambda m, w: [
            entry(m, "position", 0, INFINITY),
            entry(m, "effort", 1, -INFINITY),
            with_force(w, y=INFINITY),
        ],
        (POSITION, EFFORT, "/wrench rejected: wrench not finite"),
    ),
    "4-1e308": Case(
        lambda m, w: [entry(m, "position", 0, 1e308), entry(m, "effort", 1, -1e308), with_force(w, y=1e308)],
        (POSITION, EFFORT, "/wrench rejected: wrench not finite"),
    ),
    "95-infinite-speed": Case(
        lambda m, _: [entry(m, "velocity", 1, INFINITY), entry(m, "velocity", 0, -INFINITY)],
        tuple(f"joint_states rejected: velocity of '{name}' not finite" for name in ("joint3", "joint2")),
    ),
    "6-effort-empty": Case(
        joint(lambda m: changed(m, effort=m.message.effort[:0])),
        (f"{DRIVER} no effort of 'joint1' or any other",),
        ERROR,
    ),
    "7-unequal-lengths": Case(
        lambda m, _: [
            changed(m, effort=m.message.effort[:2]),
            changed(m, position=m.message.position[:1]),
            changed(m, velocity=m.message.velocity[:1]),
        ],
        tuple(f"{DRIVER} {what} entries for 3 names" for what in ("effort has 2", "position has 1", "velocity has 1")),
        ERROR,
    ),
    "8-zero-efforts-in-motion": Case(
        joint(lambda m: changed(m, effort=0.0 * m.message.effort)),
        (f"{DRIVER} effort of 'joint1' and of all others is zero while the robot moves",),
        ERROR,
    ),
    "10-a-joint-missing": Case(
        joint(lambda m: changed(m, name=["joint2", "joint3", "other"])),
        ("joint_states rejected: joint 'joint1' is missing",),
    ),
    "12-a-name-twice": Case(joint(twice), (f"{DRIVER} joint 'joint2' is named twice",), ERROR),
    "13-no-names": Case(joint(lambda m: changed(m, name=[])), (f"{DRIVER} no joint names",), ERROR),
    "15-prefixed-names": Case(
        joint(prefixed), ("joint_states rejected: joint 'joint1' is missing: the messages' names have the prefix",)
    ),
    "18-stamp-0": Case(joint(lambda m: stamped(m, 0)), (f"{STAMP} is zero",)),
    "19-duplicate": Case(joint(lambda m: m), (f"{STAMP} not later than the one before",)),
    "20-out-of-order": Case(joint(lambda m: later(m, -1)), (f"{STAMP} not later than the one before",)),
    "21-from-the-future": Case(
        lambda m, w: [later(m, 3600 * SECOND), later(w, SECOND)],
        (f"{STAMP} from the future", "/wrench rejected: stamp from the future"),
    ),
    "22-nanoseconds": Case(joint(misshapen), (f"{STAMP} is not valid",)),
    "23-older-than-a-second": Case(
        lambda m, w: [later(m, -3 * SECOND), later(w, -2 * SECOND)],
        (f"{STAMP} too old", "/wrench rejected: stamp too old"),
    ),
    "36-wrong-frame": Case(
        wrench(lambda m: later(in_frame(m, "tool"), 3_000_000)),
        ("/wrench rejected: frame 'tool' is not the declared 'wrist_ft'",),
    ),
    "42-frozen": Case(
        lambda joints, _: [later(joints, k * 3_000_000) for k in (1, 2, 3)],
        ("joint_states rejected: frozen: all numbers are those of the message before, though the robot moves",),
    ),
}


def test_a_bad_message_is_named_and_leaves_no_trace(direct: Direct) -> None:
    """One case after the other, each between good messages, and each named in its turn."""
    before, after = direct.begin()
    direct.feed(before)
    direct.published()
    good = before[-2:]
    for place, case in enumerate(CASES.values()):
        last, begin = {item.topic: item for item in good}, len(direct.arrays)
        direct.send(case.spoil(last["/joint_states"], last["/wrench"]))
        good = after[2 * place : 2 * place + 2]
        direct.feed(good)  # they tell that a stamp was wrong
        direct.names_at_once(begin, case.level, *case.says)
    direct.feed(after[2 * len(CASES) :])
    direct.assert_same_as_twin()


@dataclass(frozen=True)
class Stream:
    """``alter`` makes of every good message, and of its place, what the node is sent for 1.5 s.

    The twin is fed what ``spare`` makes of it, None for what it is spared: without it, what the node is sent.
    """

    alter: Callable[[Recorded, int], Recorded]
    says: tuple[str, ...]
    level: bytes = WARN
    spare: Callable[[Recorded, int, int], Recorded | None] | None = None


def joints_only(change: Callable[[Recorded, int], Recorded]) -> Callable[[Recorded, int], Recorded]:
    return lambda item, place: change(item, place) if item.topic == "/joint_states" else item


def with_numbers(item: Recorded, key: str, place: int, value: float) -> Recorded:
    """Another number in one place, on the same stamp."""
    values = getattr(item.message, key).copy()
    values[place] = value
    return item.changed(**{key: values})


def with_others(item: Recorded) -> Recorded:
    """A gripper in the same message, broken."""
    numbers = {key: np.append(getattr(item.message, key), [NAN, 1e308]) for key in ("position", "velocity", "effort")}
    return item.changed(name=[*item.message.name, "finger", "thumb"], **numbers)


def reordered(item: Recorded, place: int) -> Recorded:
    """The joints in another order in every message."""
    order = np.roll(np.arange(3), place // 2)
    numbers = {key: getattr(item.message, key)[order] for key in ("position", "velocity", "effort")}
    return item.changed(name=[item.message.name[index] for index in order], **numbers)


def after_half_a_second(
    altered: Callable[[Recorded, int], Recorded],
) -> Callable[[Recorded, int, int], Recorded | None]:
    """What fails for half a second, ``filter.max_gap``, is rejected; then its equations are left out."""

    def spare(item: Recorded, place: int, since: int) -> Recorded | None:
        bad = item.topic == "/joint_states" and since <= 500_000_000
        return None if bad else altered(item, place)

    return spare


no_effort_of_one = joints_only(lambda item, _: with_numbers(item, "effort", 1, NAN))
no_effort = joints_only(lambda item, _: item.changed(effort=item.message.effort[:0]))
zero_effort = joints_only(lambda item, _: item.changed(effort=0.0 * item.message.effort))
LEFT_OUT = "joint_states: no effort of 'joint3'; its equation is left out"
NONE_LEFT = "joint_states: no effort is measured at any joint, no joint equation is used: 'joint1', 'joint2', 'joint3'"


STREAMS = {
    "1-nan-effort-for-ever": Stream(no_effort_of_one, (LEFT_OUT,), spare=after_half_a_second(no_effort_of_one)),
    "5-velocity-empty": Stream(
        joints_only(lambda item, _: item.changed(velocity=item.message.velocity[:0])),
        ("joint_states: no velocities: positions are differentiated",),
    ),
    "6-effort-empty-for-ever": Stream(no_effort, (NONE_LEFT,), ERROR, spare=after_half_a_second(no_effort)),
    "8-zero-efforts-for-ever": Stream(zero_effort, (NONE_LEFT,), ERROR, spare=after_half_a_second(zero_effort)),
    "9-another-order": Stream(joints_only(reordered), ("",), OK, spare=lambda item, *_: item),
    "37-no-frame": Stream(
        lambda item, _: in_frame(item, "") if item.topic == "/wrench" else item,
        ("",),
        OK,
        spare=lambda item, *_: item,
    ),
    "11-extra-joints": Stream(
        joints_only(lambda item, _: with_others(item)),
        ("joint_states: ignored, no moving joints of the robot: 'finger', 'thumb'",),
        spare=lambda item, *_: item,
    ),
}


@pytest.mark.parametrize("name", STREAMS)
def test_a_bad_stream_is_named_and_leaves_no_trace(name: str, direct: Direct) -> None:
    case = STREAMS[name]
    before, after = direct.begin()
    direct.feed(before)
    direct.published()
    direct.settled(len(direct.arrays))  # the next diagnostics are of what is sent now alone
    begin = len(direct.arrays)
    last = stamp_of(before[-1])
    direct.send([case.alter(item, place) for place, item in enumerate(after)])
    spared = [
        case.spare(item, place, stamp_of(item) - last) if case.spare else case.alter(item, place)
        for place, item in enumerate(after)
    ]
    direct.twin.feed(item for item in spared if item)
    direct.settled(begin)
    direct.says(begin, case.level, *case.says)
    direct.assert_same_as_twin()
    direct.feed(direct.shifted(later(item, 2 * SECOND) for item in GOOD[900:1100]))
    direct.assert_same_as_twin()
