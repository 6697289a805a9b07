"""A few instants of a recording, spread over all of it, whatever its length."""

from __future__ import annotations

from collections import deque

import numpy as np

from geomid_ros.model.moving import STILL
from geomid_ros.model.samples import Samples
from geomid_ros.types import IntArray

FEWEST = 30
"""Instants that a recording is judged on."""
_MOST = 250
_LONG = 800
STEP = 20_000_000
"""[ns] between the instants of a stretch, at least: of what is behind the filter they show all."""
_APART = 100_000_000  # [ns] nearer instants say the same twice


def elapsed(stamps: IntArray, place: float) -> float:
    """When a place is, since the first instant [s]; of recordings one after the other, all of theirs."""
    return float(np.sum(np.maximum(np.diff(stamps), 0)[: int(place * len(stamps))])) * 1e-9


class Instants:
    """Keeps at most 250 instants of what it is given, at least 0.1 s apart and evenly over the whole time.

    When there are too many, every other one is let go and those to come are taken half as often: the choice depends on
    the stamps alone, not on the batches in which the samples come.
    """

    def __init__(self) -> None:
        self._kept: list[tuple[int, Samples]] = []  # of one instant each, with the number of its recording
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

    def _keep(self, instant: Samples) -> None:
        self._last = int(instant.stamps[0])
        self._kept.append((self._recording, instant))
        self.taken += self._apart / _APART
        if len(self._kept) > _MOST:
            self._kept = self._kept[::2]
            self._apart *= 2

    def begin_recording(self) -> None:
        """The samples to come are of another recording."""
        self._recording += 1

    @property
    def samples(self) -> Samples | None:
        """All that are kept; None if there are none."""
        return None if (kept := self.kept) is None else kept[0]

    @property
    def kept(self) -> tuple[Samples, IntArray] | None:
        """All that are kept, and the number of the recording that each is of ``(N,)``; None if there are none."""
        kept = list(self._kept)  # replaced or appended to by another thread
        if not kept:
            return None
        return Samples.concatenate([instant for _, instant in kept]), np.array([number for number, _ in kept])


class Stretch:
    """Keeps the last instants at which something moved, one of each 20 ms: as many as tell a delay."""

    def __init__(self) -> None:
        self._kept: deque[Samples] = deque()
        self._count = 0
        self._last = -1  # 20 ms since the epoch

    def add(self, samples: Samples) -> None:
        """Take samples, in the order of time; where the clock is set back another recording begins."""
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
        while self._count - len(self._kept[0]) >= _LONG if self._kept else False:
            self._count -= len(self._kept.popleft())

    @property
    def samples(self) -> Samples | None:
        """All that are kept; None if there are none."""
        return Samples.concatenate(list(self._kept)) if self._kept else None
