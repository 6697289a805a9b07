"""The node's worker, fed as the node feeds it, but as fast as it goes: what counts is the recording's time."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass

from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.threads import Received
from geomid_ros.live.worker import Worker
from geomid_ros.monitoring.change_detection import PART, ChannelGap
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session

TOGETHER = 0.1
"""[s] between looks at messages and gaps: so often the node looks for messages."""
_NEVER = 3600.0  # [s] between solves: what is normal is learned from rows, not from estimates
_PATIENCE = 60.0  # [s]
_PAUSE = 2e-4  # [s]


@dataclass(frozen=True)
class Watched:
    """The monitored channels, and the payload, at a ``time`` since the beginning of the recording [s]."""

    time: float
    gaps: tuple[ChannelGap, ...]
    carried: CarriedPayload | None


def watched(urdf: str, messages: Iterable[tuple[float, Received]], solve_period: float = _NEVER) -> Iterator[Watched]:
    """What the node's status shows of gaps and payloads, ten times a second."""
    worker = Worker(Session(urdf, Configuration(), "robot.urdf"), solve_period, Listener(), Failures())
    with closing(worker):
        for end, batch in _batches(messages):
            worker.enqueue(batch)
            _wait(worker)
            status = worker.status(active=True)
            yield Watched(end, status.gaps, status.payload)


def _batches(messages: Iterable[tuple[float, Received]]) -> Iterator[tuple[float, list[Received]]]:
    """What came meanwhile, and when the node looks."""
    end, batch = TOGETHER, list[Received]()
    for stamp, message in messages:
        while stamp > end:
            if batch:
                yield end, batch
            end, batch = end + TOGETHER, []
        batch.append(message)
    yield end, batch


def _wait(worker: Worker) -> None:
    """Until all is taken, and all rows are judged."""
    begin, session = time.monotonic(), worker.session
    detector = worker.solver.detector
    while worker.status(active=True).queue > session.pipeline.waiting_count or (
        session.identifier.sample_count - detector.searched_until >= PART
    ):
        if time.monotonic() - begin > _PATIENCE:
            raise RuntimeError(f"not judged within {_PATIENCE:g} s: {worker.status(active=True).failures}")
        time.sleep(_PAUSE)
