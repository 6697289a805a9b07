"""The catalogue's faults of a wrench sensor that speaks another language than its declaration, or changes its mind."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from files.recordings import Recorded

from .rig import ERROR, GOOD, Rig, Twin
from .spoiling import later, stamp_of

SECOND = 1_000_000_000


def with_wrench(item: Recorded, change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Recorded:
    """A wrench message with other forces and torques."""
    if item.topic != "/wrench":
        return item
    message = copy.deepcopy(item.message)
    parts = [message.wrench.force, message.wrench.torque]
    changed = change(*(np.array([part.x, part.y, part.z]) for part in parts))
    for part, values in zip(parts, changed, strict=True):
        part.x, part.y, part.z = map(float, values)
    return replace(item, message=message)


TURN = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

SPOKEN: dict[str, tuple[Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], str]] = {
    "35-sign-flipped": (lambda f, t: (-f, -t), "is the sign reversed?"),
    "36-another-frame": (lambda f, t: (TURN @ f, TURN @ t), "is the frame another one?"),
    "38-millinewtons": (lambda f, t: (1e3 * f, 1e3 * t), "is the unit another one?"),
}


JUDGED = 60  # instants in motion, after which a sensor is judged


def feed_without_wrenches(twin: Twin, messages: list[Recorded], since: int) -> None:
    """What no wrench says counts, after so many instants."""
    count = 0
    for item in messages:
        samples = twin.feed_pipeline(item)
        if samples is not None:
            if count >= since:
                samples = replace(samples, wrenches=np.full_like(samples.wrenches, np.nan))
            moving, _ = twin.session.identifier.add(samples)
            count += len(moving)


@pytest.mark.parametrize("name", SPOKEN)
def test_a_sensor_that_is_declared_wrongly_is_named(name: str, rig: Rig) -> None:
    """Its rows are left out from then on; after ~/reset, nothing is left of those before."""
    change, says = SPOKEN[name]
    before, after = rig.begin()
    begin = len(rig.arrays)
    wrong = [with_wrench(item, change) for item in before + after]
    rig.send(wrong)
    feed_without_wrenches(rig.twin, wrong, JUDGED)
    rig.settled(begin)
    rig.says(begin, ERROR, "/wrench: ", says, "Its rows are left out until ~/reset")
    assert rig.node.running
    rig.assert_same_as_twin()
    before, after = rig.begin()
    begin = len(rig.arrays)
    rig.feed(before + after)
    rig.settled(begin)
    rig.assert_same_as_twin()
    assert says not in rig.stream(rig.arrays[-1]).message


def biased(item: Recorded, bias: float) -> Recorded:
    return with_wrench(item, lambda force, torque: (force + np.array([0.0, 0.0, bias]), torque))


CHANGES: dict[str, Callable[[float], float]] = {
    "39-tared": lambda _: 3.0,
    "40-drifting": lambda seconds: 0.6 * seconds,
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_sensor_that_changes_is_named(name: str, rig: Rig) -> None:
    """Once it is known what is normal: two rounds of the motion. The rows are taken: a new load looks the same."""
    bias = CHANGES[name]
    rig.begin()
    rounds = [rig.shifted(later(item, k * 9 * SECOND) for item in GOOD) for k in range(3)]
    rig.feed(rounds[0] + rounds[1])
    rig.assert_same_as_twin()
    begin, origin = len(rig.arrays), stamp_of(rounds[2][0])
    rig.feed([biased(item, bias(1e-9 * (stamp_of(item) - origin))) for item in rounds[2]])
    rig.says(begin, ERROR, "gap at wrench/fz", "was the sensor tared")
    rig.settled(begin)
    rig.assert_same_as_twin()
