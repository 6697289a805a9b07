"""The catalogue's faults of a wrench sensor that speaks another language than its declaration, or changes its mind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from files.recordings import Recorded

from geomid_ros.model.samples import Samples

from .direct import Direct
from .rig import ERROR, GOOD, Twin
from .spoiling import later, stamp_of

SECOND = 1_000_000_000


def with_wrench(item: Recorded, change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Recorded:
    """A wrench message with other forces and torques."""
    if item.topic != "/wrench":
        return item
    wrench = item.message.wrench
    parts = (wrench.force, wrench.torque)
    values = change(*(np.array([part.x, part.y, part.z]) for part in parts))
    force, torque = (
        replace(part, **dict(zip("xyz", map(float, new), strict=True))) for part, new in zip(parts, values, strict=True)
    )
    return item.changed(wrench=replace(wrench, force=force, torque=torque))


AXES = 6
PART = 900  # messages, which do not wait for so long that some are dropped, on a busy machine either


def silenced(samples: Samples, since: int = 0) -> Samples:
    """What no wrench says from a stamp on."""
    wrenches = samples.wrenches.copy()
    wrenches[samples.stamps >= since] = np.nan
    return replace(samples, wrenches=wrenches)


def test_35_a_sensor_that_is_declared_wrongly_is_named(direct: Direct) -> None:
    """The estimate is that of a run in which it said nothing; after ~/reset it may speak again."""
    says = "check the sign"
    before, after = direct.begin()
    begin = len(direct.arrays)
    wrong = [with_wrench(item, lambda force, torque: (-force, -torque)) for item in before + after]
    direct.send(wrong)
    moving, *_ = direct.twin.session.identifier.add(silenced(direct.twin.samples(wrong)))
    direct.says(begin, ERROR, "/wrench: ", says, "Its rows are left out, including earlier ones, until ~/reset")
    direct.settled(begin)
    direct.assert_same_as_twin()
    left_out = {"rows rejected: wrench doubtful: /wrench": str(AXES * len(moving))}
    direct.told("all its rows left out", begin, lambda values, _: left_out.items() <= values.items())
    before, after = direct.begin()
    begin = len(direct.arrays)
    direct.feed(before + after)
    direct.settled(begin)
    direct.assert_same_as_twin()
    assert says not in direct.stream(direct.arrays[-1]).message


def biased(item: Recorded, bias: float) -> Recorded:
    return with_wrench(item, lambda force, torque: (force + np.array([0.0, 0.0, bias]), torque))


def test_40_a_sensor_that_drifts_is_named(direct: Direct) -> None:
    """Once it is known what is normal: two rounds of the motion. The estimate is that of a run in which it said nothing
    since."""
    direct.begin()
    rounds = [direct.shifted(later(item, k * 9 * SECOND) for item in GOOD) for k in range(3)]
    begin, origin = len(direct.arrays), stamp_of(rounds[2][0])
    bad = [biased(item, 0.6e-9 * (stamp_of(item) - origin)) for item in rounds[2]]
    messages = rounds[0] + rounds[1] + bad
    for part in range(0, len(messages), PART):
        direct.send(messages[part : part + PART])
        direct.settled()
    direct.says(begin, ERROR, "gap at wrench/fz", "the sensor was tared", "Rows of /wrench are left out until")
    rows = direct.saved()["rows"]  # what waits is judged by now
    left_out = rows["rejected"]["wrench changed: /wrench"]
    samples = direct.twin.samples(messages)
    made = len(samples) * len(direct.twin.session.model.channels)
    assert rows["accepted"] + sum(rows["rejected"].values()) == made, "all messages have come"
    since = samples.stamps[Twin().session.identifier.add(samples)[0]][-left_out // AXES]
    direct.twin.session.identifier.add(silenced(samples, since))
    direct.assert_same_as_twin()
    spared = Twin().samples(rounds[0] + rounds[1] + rounds[2])
    touched = samples.stamps[np.any(np.abs(samples.wrenches - spared.wrenches) > 1e-9, axis=(1, 2))]
    assert touched[0] > origin - SECOND
    assert since > origin - 4 * SECOND, "not much more is left out"
