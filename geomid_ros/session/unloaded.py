"""Recordings without what the robot carried for a while, which a running node leaves out, too."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from geomid_ros.model.measurement_model import Rows
from geomid_ros.model.samples import Samples, regimes
from geomid_ros.monitoring.change_detection import BLOCK, PART
from geomid_ros.monitoring.payload_watch import CarriedPayload, PayloadWatch
from geomid_ros.session.payload import change_detector
from geomid_ros.session.review import LeftOut
from geomid_ros.session.session import Session


class Unloaded:
    """Leaves out the samples of recordings from when a payload is picked up until it is put down."""

    def __init__(self, session: Session) -> None:
        """``session``: the robot."""
        self._model = session.model
        self.left_out: list[LeftOut] = []
        """What was left out so far."""
        self._detector = change_detector(session, pace=BLOCK // PART)  # nobody waits for the payload
        self._first: int | None = None  # stamp of the first sample of a recording
        self._last = 0  # stamp of its last sample
        self._count = 0  # samples so far
        self._waiting: deque[tuple[int, Samples]] = deque()  # with the number of the first
        self._carried: dict[int, CarriedPayload] = {}  # since the last pick-up, by the stamps of their beginnings
        self._begin = 0  # stamp of the first sample to leave out since then

    def __call__(self, path: Path, recording: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the samples, in the order of time, of the recording at a ``path``, without those to leave out."""
        if (watch := self._detector.payload) is None:
            yield from recording
            return
        self._first = None
        for samples in recording:
            for piece in samples.in_pieces():
                self._add(piece)
                more = True
                while more:
                    more = self._detector.test()
                    yield from self._sorted(path, watch)
        if self._carried:
            self._report(path, self._last)
            self._take(self._count)
        yield from self._take(self._count)

    def kept(self, path: Path, recording: Samples) -> Samples:
        """Return what is left of a whole recording."""
        return Samples.concatenate([*self(path, [recording]), recording.select(slice(0))])

    def _add(self, samples: Samples) -> None:
        self._first = int(samples.stamps[0]) if self._first is None else self._first
        self._last = int(samples.stamps[-1])
        rows, efforts = self._model.rows(samples), self._model.layout.efforts
        slow = np.zeros(rows.targets.shape, dtype=bool)
        if efforts:
            slow[:, efforts] = regimes(samples) > 0
        settled = Rows(rows.coefficients, np.where(slow, np.nan, rows.targets))
        self._detector.add(self._count, samples.stamps, settled)
        self._waiting.append((self._count, samples))
        self._count += len(samples)

    def _sorted(self, path: Path, watch: PayloadWatch) -> list[Samples]:
        """Return the samples that are known to be without a payload, and discard those with one."""
        carried, searched = watch.payload, self._detector.searched_until
        if carried is None and self._carried:  # it was just put down
            self._report(path, self._detector.searched_stamp)
            self._take(searched)
        known = self._take(self._detector.weighed_before)
        if carried is not None:
            if not self._carried:
                self._begin = int(self._waiting[0][1].stamps[0]) if self._waiting else carried.picked_up
            if (earlier := watch.exchanged) is not None and earlier.since in self._carried:
                self._carried[earlier.since] = earlier
            self._carried[carried.since] = carried
            self._take(searched)
        return known

    def _take(self, end: int) -> list[Samples]:
        """Remove and return the waiting samples with smaller numbers."""
        taken = []
        while self._waiting and self._waiting[0][0] < end:
            begin, samples = self._waiting.popleft()
            taken.append(samples.select(slice(end - begin)))
            if begin + len(samples) > end:
                self._waiting.appendleft((end, samples.select(slice(end - begin, None))))
        return taken

    def _report(self, path: Path, last: int) -> None:
        """Note what was carried in the recording at this ``path``; ``last``: stamp of the last sample to leave out."""
        first = self._first or 0
        begins = [(max(0.0, 1e-9 * (since - first)), load.mass) for since, load in self._carried.items()]
        loads = [f"{mass:.2f} kg from {begin:.1f} s on" for begin, mass in begins]
        link, until = next(iter(self._carried.values())).link, 1e-9 * (last - first)
        sentence = f"{path.name}: '{link}' carries {', '.join(loads)}, until {until:.1f} s: these samples are left out"
        self.left_out.append(LeftOut(path, self._begin, last + 1, sentence))
        self._carried = {}
