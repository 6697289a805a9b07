"""The bench of exchanged recordings: what is tested on is never trained on."""

from __future__ import annotations

import numpy as np

from benchmarks.exchanged import splits
from geomid_ros.model.samples import Samples

COUNT, PERIOD = 1000, 20_000_000  # 20 s


def recording(begin: int, speed: np.ndarray) -> Samples:
    """One joint's motion at a ``speed (N,)``."""
    stamps = begin + PERIOD * np.arange(len(speed))
    column, none = speed[:, None], np.zeros((len(speed), 0))
    return Samples(stamps, column, column, column, column, none, none, none, np.zeros((len(speed), 0, 6)))


def stamps(parts: tuple[Samples, ...]) -> set[int]:
    return {int(stamp) for part in parts for stamp in part.stamps}


def test_nothing_is_trained_and_tested_on() -> None:
    """Thirds and bags are tested once each, and fast windows where speeds differ."""
    faster = np.where(np.arange(COUNT) // 100 % 2, 1.0, 0.4)
    bags = {"one": recording(0, faster), "two": recording(10**12, np.ones(COUNT)), "three": recording(10**13, faster)}
    found = {split.name: split for split in splits(bags)}
    assert len(found) == 3 + 3 * 5 + 2
    for split in found.values():
        assert not stamps(split.train) & stamps(split.test), split.name
        assert all(map(len, (*split.train, *split.test))), split.name
    for words in ("third", "+"):
        tested = [stamp for name, split in found.items() if words in name for stamp in stamps(split.test)]
        assert len(tested) == len(set(tested)) == 3 * COUNT
    by_speed = {name: split for name, split in found.items() if "slow" in name}
    assert set(by_speed) == {"one: slow -> fast", "three: slow -> fast"}
    for split in by_speed.values():
        slow, fast = (np.concatenate([part.velocity for part in parts]) for parts in (split.train, split.test))
        assert np.all(slow == 0.4)
        assert np.all(fast == 1.0)
