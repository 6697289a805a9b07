"""A few samples of a recording, spread over all of it, whatever its length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.samples import REST_SPEED, Samples
from geomid_ros.types import AnyArray, IntArray

FEWEST = 30
"""Fewest samples on which a recording is checked."""
MOST = 250
"""Most samples on which a recording is checked."""
STEP = 20_000_000
"""Samples so far apart show everything that passes the filter [ns]."""
_APART = 100_000_000  # [ns]; nearer samples are redundant


@dataclass(frozen=True, eq=False)
class KeptSamples:
    """Kept ``samples``; the next sample after each, ``next_samples``, or itself if none followed soon; the index of
    each one's recording, ``recordings (N,)``; and the name of each one's bag, ``bags (N,)``."""

    samples: Samples
    next_samples: Samples
    recordings: IntArray
    bags: AnyArray

    def then(self, later: KeptSamples) -> KeptSamples:
        """Append those of ``later`` recordings."""
        return KeptSamples(
            Samples.concatenate([self.samples, later.samples]),
            Samples.concatenate([self.next_samples, later.next_samples]),
            np.append(self.recordings, self.recordings[-1] + 1 + later.recordings),
            np.append(self.bags, later.bags),
        )


class SampleReservoir:
    """Keep at most 250 samples, at least 0.1 s apart and evenly over the whole time.

    When there are too many, every other one is dropped, and later ones are taken half as often. The choice depends on
    the stamps alone, not on the batches in which the samples come.
    """

    def __init__(self) -> None:
        self._kept: list[tuple[Samples, Samples, int]] = []  # sample, next sample, index of the recording
        self._awaits_next = False
        self._bags = [""]  # of the recordings so far
        self._apart = _APART
        self.taken = 0.0
        """Time that the kept samples stand for, in units of the least distance."""
        self._last: int | None = None

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, samples: Samples) -> None:
        """Add samples, in the order of time; where the clock is set back another recording begins."""
        for index, stamp in enumerate(samples.stamps.tolist()):
            if self._awaits_next:
                self._follow(samples.select(np.array([index])))
            if self._last is not None and stamp < self._last:
                self.begin_recording()
            elif self._last is not None and stamp < self._last + self._apart:
                continue
            self._keep(samples.select(np.array([index])))  # a copy: a view would keep all of the samples

    def _keep(self, instant: Samples) -> None:
        self._last = int(instant.stamps[0])
        self._kept.append((instant, instant, len(self._bags) - 1))
        self._awaits_next = True
        self.taken += self._apart / _APART
        if len(self._kept) > MOST:
            self._kept = self._kept[::2]
            self._apart *= 2

    def _follow(self, instant: Samples) -> None:
        """Store the sample after the last kept one, unless it is of another recording or much later."""
        last, _, recording = self._kept[-1]
        self._awaits_next = False
        if 0 < instant.stamps[0] - last.stamps[0] < 2 * STEP:
            self._kept[-1] = (last, instant, recording)

    def begin_recording(self, bag: str | None = None) -> None:
        """Begin another recording, in another ``bag`` or in the same."""
        self._bags.append(self._bags[-1] if bag is None else bag)

    @property
    def kept(self) -> KeptSamples | None:
        """All kept samples; None if there are none."""
        kept = list(self._kept)  # a copy: another thread replaces it or appends to it
        if not kept:
            return None
        samples, later, recordings = ([*parts] for parts in zip(*kept, strict=True))
        bags = np.array(self._bags)[recordings]
        return KeptSamples(Samples.concatenate(samples), Samples.concatenate(later), np.array(recordings), bags)


class RecentMotion:
    """Keep the last samples in motion, one per 20 ms: enough to identify a delay."""

    def __init__(self) -> None:
        self.samples: Samples | None = None
        """All kept samples; None if there are none."""
        self._last = -1  # 20 ms since the epoch

    def add(self, samples: Samples) -> None:
        """Add samples, in the order of time; where the clock is set back another recording begins."""
        if not len(samples):
            return
        if self.samples is not None and samples.stamps[0] <= self.samples.stamps[-1]:
            self.samples = None
        steps = samples.stamps // STEP
        is_first = np.diff(steps, prepend=self._last) != 0
        self._last = int(steps[-1])
        moving = samples.select(is_first & np.any(np.abs(samples.velocity) > REST_SPEED, axis=1))
        if len(moving):
            before = [] if self.samples is None else [self.samples]
            self.samples = Samples.concatenate([*before, moving]).select(slice(-3 * MOST, None))
