"""Waiting for what must come some time: the machine may be busy."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.live.worker import Worker

PATIENCE = 300.0  # [s]


def wait_until(look: Callable[[], object]) -> None:
    """Wait until ``look`` finds something."""
    end = time.monotonic() + PATIENCE
    while not look():
        assert time.monotonic() < end
        time.sleep(0.005)


def final_estimate(worker: Worker) -> Estimate | GeomidError:
    """A worker's answer to a request for an estimate of all messages so far."""
    answers: queue.Queue[Estimate | GeomidError] = queue.Queue()
    worker.request_estimate(answers.put)
    return answers.get(timeout=PATIENCE)
