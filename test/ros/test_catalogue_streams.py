"""The catalogue's faults of whole streams: clocks that jump, motions that say little, robots in parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

import numpy as np
import pytest
from files.recordings import Recorded

from .direct import Direct
from .in_motion import InMotion, in_time, noisy
from .rig import AFTER, BEFORE, GOOD, OK, WARN, Rig
from .spoiling import later, stamp_of
from .stage import description

SECOND = 1_000_000_000
BACK = (": clock set back: a new segment begins",)
PAUSE = tuple(f"{topic}: pause: a new segment begins" for topic in ("joint_states", "/wrench"))


def of_a_bag_in_a_loop(before: list[Recorded], after: list[Recorded]) -> list[Recorded]:
    return [*after, *before, *after]


def of_a_reset_simulation(_: list[Recorded], after: list[Recorded]) -> list[Recorded]:
    """Its clock begins at nothing."""
    begin = stamp_of(after[0]) - SECOND
    return [later(item, -begin) for item in after]


def after_a_pause(_: list[Recorded], after: list[Recorded]) -> list[Recorded]:
    return [later(item, 2 * SECOND) for item in after]


JUMPS: dict[str, tuple[Callable[[list[Recorded], list[Recorded]], list[Recorded]], tuple[str, ...]]] = {
    "24-simulation-reset": (of_a_reset_simulation, BACK),
    "25-bag-loop": (of_a_bag_in_a_loop, BACK),
    "27-gap-forward": (after_a_pause, PAUSE),
}


@pytest.mark.parametrize("name", JUMPS)
def test_time_that_jumps_begins_a_segment_and_costs_nothing(name: str, direct: Direct) -> None:
    jump, says = JUMPS[name]
    before, after = direct.begin()
    direct.feed(before)
    direct.published()
    begin, rows = len(direct.arrays), direct.twin.session.identifier.rows
    rejected = refused(direct)
    direct.feed(jump(before, after))
    direct.names_at_once(begin, WARN, *says)
    assert refused(direct) == rejected, "a jump is no reason to refuse anything"
    direct.assert_same_as_twin()
    assert direct.twin.session.identifier.rows > rows, "information is kept, and more comes"


def refused(rig: Rig) -> int:
    values = rig.settled(len(rig.arrays))
    return sum(int(value) for key, value in values.items() if " rejected: " in key or " dropped: " in key)


REPEATED: dict[str, Callable[[list[Recorded]], list[Recorded]]] = {
    "26-clock-back-a-little": lambda before: before[-60:],
    "28-paused-simulation": lambda before: before[-2:] * 100,
}


@pytest.mark.parametrize("name", REPEATED)
def test_what_comes_again_is_waited_out(name: str, direct: Direct) -> None:
    before, after = direct.begin()
    direct.feed(before)
    direct.published()
    begin = len(direct.arrays)
    direct.send(REPEATED[name](before))
    direct.settled(begin)
    direct.says(begin, None, "joint_states rejected: stamp not later than the one before")
    direct.feed(after)
    direct.assert_same_as_twin()


def of_one_robot(duration: float, begin: float, swing: Sequence[float]) -> list[Recorded]:
    """Of the small arm with other bodies: each joint swings so far."""
    arm = InMotion(
        description("arm3"), duration=duration, rate=100, seed=48, begin=begin, cuts=["wrist_ft"], swing=np.array(swing)
    )
    return in_time(
        arm.joint_states(noisy(arm.efforts(), 0.02, 1)),
        arm.wrenches("/wrench", "wrist_ft", noisy(arm.carried("wrist_ft"), 0.02, 2)),
    )


def test_48_a_motion_of_one_joint_leaves_links_untold_and_names_them(direct: Direct) -> None:
    """The last joint alone shows nothing of the link before it; the motion of all joints does."""
    direct.begin()
    alone = of_one_robot(4.0, 0.0, [0.0, 0.0, 0.8])
    direct.feed(alone)
    direct.assert_same_as_twin()  # the last estimate is of all rows, from scratch
    begin = len(direct.arrays)
    direct.link_says(begin, "link2", OK, "identifiable only in combination")
    direct.link_says(begin, "link3", OK, "mass")
    direct.feed(of_one_robot(4.0, 6.0, [0.8, 0.8, 0.8]))
    direct.assert_same_as_twin()
    begin = len(direct.arrays)
    direct.link_says(begin, "link2", OK, "mass")


# --- Left and right arm in messages of their own, on one topic ---


def part(item: Recorded, places: slice) -> Recorded:
    """A joint message with some of its joints."""
    numbers = {key: getattr(item.message, key)[places] for key in ("position", "velocity", "effort")}
    return item.changed(name=item.message.name[places], **numbers)


def test_16_two_arms_are_put_together() -> None:
    """As if one had sent all joints: the twin is fed whole messages."""
    with closing(Direct(merge_joint_states=True)) as direct:
        for item in BEFORE + AFTER:
            parts = [slice(0, 2), slice(2, None)] if item.topic == "/joint_states" else []
            direct.send([part(item, each) for each in parts] or [item])
        direct.twin.feed(BEFORE + AFTER)
        values = direct.settled()
        assert values["joint_states accepted"] == values["joint_states received"]
        direct.assert_same_as_twin()


def test_88_a_slow_gripper_does_not_slow_down_the_arm() -> None:
    """The last joint comes twice per second: the others' rows are those at the arm's rate, and it is told."""
    sent = []
    for place, item in enumerate(BEFORE + AFTER):
        if item.topic == "/joint_states":
            sent += [part(item, slice(0, -1))] + ([part(item, slice(-1, None))] if place % 100 < 2 else [])
        else:
            sent.append(item)
    with closing(Direct(merge_joint_states=True)) as direct:
        direct.send(sent)
        direct.twin.feed(sent)
        values = direct.settled()
        assert values["joint_states accepted"] == values["joint_states received"]
        direct.says(0, None, "messages per second of")
        direct.assert_same_as_twin()
        assert len(direct.twin.session.pipeline.unmeasured) == 1


def test_89_a_part_that_falls_silent_is_named() -> None:
    """Though all that comes is accepted; and it goes on when the part is back."""
    with closing(Direct(merge_joint_states=True)) as direct:
        for begin, end, places in ((0, 400, (0, 2)), (400, 1000, (0,)), (1000, len(GOOD), (0, 2))):
            before = len(direct.arrays)
            for item in GOOD[begin:end]:
                parts = [slice(place, 2 if place == 0 else None) for place in places]
                direct.send([part(item, each) for each in parts] if item.topic == "/joint_states" else [item])
            if places == (0,):
                silent = next(item for item in GOOD if item.topic == "/joint_states").message.name[2]
                direct.says(before, WARN, f"joint_states: no data of '{silent}'")
            direct.settled(before)
        direct.told("rows", before, lambda _, status: "no data of" not in status.message)
