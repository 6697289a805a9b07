"""A few instants of a recording, spread over all of it, whatever its length."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.samples import STILL, Samples
from geomid_ros.types import IntArray

FEWEST = 30
"""Instants that a recording is judged on."""
MOST = 250
"""The same, at most."""
STEP = 20_000_000
"""[ns] of what is behind the filter, instants as far apart show all."""
_APART = 100_000_000  # [ns] nearer instants say the same twice


def elapsed(stamps: IntArray, place: float) -> float:
    """When a place is, since the first instant [s]; of recordings one after the other, all of theirs."""
    return float(np.sum(np.maximum(np.diff(stamps), 0)[: int(place * len(stamps))])) * 1e-9


@dataclass(frozen=True, eq=False)
class Kept:
    """Instants that are kept, ``samples``; what was next after each, at the same instant if nothing followed soon,
    ``later``; and the number of each one's recording ``recordings (N,)``."""

    samples: Samples
    later: Samples
    recordings: IntArray


class Instants:
    """Keeps at most 250 instants of what it is given, at least 0.1 s apart and evenly over the whole time.

    When there are too many, every other one is let go and those to come are taken half as often: the choice depends on
    the stamps alone, not on the batches in which the samples come.
    """

    def __init__(self) -> None:
        self._kept: list[tuple[Samples, Samples, int]] = []  # each instant, the next one of all, its recording
        self._awaits_next = False
        self._recording = 0
        self._apart = _APART
        self.taken = 0.0
        """How long the kept instants stand for, in least distances."""
        self._last: int | None = None

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, samples: Samples) -> None:
        """Take samples, in the order of time; where the clock is set back another recording begins."""
        stamps = samples.stamps
        if self._awaits_next and len(stamps):
            self._follow(samples.select(np.array([0])))
        index = 0
        while index < len(stamps):
            if self._last is not None and stamps[index] < self._last:
                self.begin_recording()
            elif self._last is not None:
                index += int(np.searchsorted(stamps[index:], self._last + self._apart))
                if index == len(stamps):
                    return
            self._keep(samples.select(np.array([index])))  # a copy: a view would keep all of the samples
            index += 1
            if self._awaits_next and index < len(stamps):
                self._follow(samples.select(np.array([index])))

    def _keep(self, instant: Samples) -> None:
        self._last = int(instant.stamps[0])
        self._kept.append((instant, instant, self._recording))
        self._awaits_next = True
        self.taken += self._apart / _APART
        if len(self._kept) > MOST:
            self._kept = self._kept[::2]
            self._apart *= 2

    def _follow(self, instant: Samples) -> None:
        """The instant after the last one that was kept, perhaps of another recording or much later."""
        last, _, recording = self._kept[-1]
        self._awaits_next = False
        if 0 < instant.stamps[0] - last.stamps[0] < 2 * STEP:
            self._kept[-1] = (last, instant, recording)

    def begin_recording(self) -> None:
        """The samples to come are of another recording."""
        self._recording += 1

    @property
    def kept(self) -> Kept | None:
        """All that are kept; None if there are none."""
        kept = list(self._kept)  # replaced or appended to by another thread
        if not kept:
            return None
        samples, later, recordings = ([*parts] for parts in zip(*kept, strict=True))
        return Kept(Samples.concatenate(samples), Samples.concatenate(later), np.array(recordings))


class Stretch:
    """Keeps the last instants at which something moved, one of each 20 ms: as many as tell a delay."""

    def __init__(self) -> None:
        self._kept: deque[Samples] = deque()
        self._count = 0
        self._last = -1  # 20 ms since the epoch

    def add(self, samples: Samples) -> None:
        """Take samples, in the order of time; where the clock is set back another recording begins."""
        if not len(samples):
            return
        if self._kept and samples.stamps[0] <= self._kept[-1].stamps[-1]:
            self._kept.clear()
            self._count = 0
        steps = samples.stamps // STEP
        new = np.diff(steps, prepend=self._last) != 0
        self._last = int(steps[-1])
        moving = samples.select(new & np.any(np.abs(samples.velocity) > STILL, axis=1))
        if len(moving):
            self._kept.append(moving)
            self._count += len(moving)
        while self._count - len(self._kept[0]) >= 3 * MOST if self._kept else False:
            self._count -= len(self._kept.popleft())

    @property
    def samples(self) -> Samples | None:
        """All that are kept; None if there are none."""
        return Samples.concatenate(list(self._kept)) if self._kept else None
