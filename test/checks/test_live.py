"""The node says what a recording seems to be in the words of the command line."""

from __future__ import annotations

import queue
import re
import time
from typing import Any

import pytest
from files.recordings import BAGS, recorded

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.threads import Received
from geomid_ros.live.worker import Worker
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session

PATIENCE = 120.0


def session(**settings: object) -> Session:
    return Session(read_urdf(BAGS / "arm3.urdf"), Configuration({"candidates": [], **settings}), "arm3.urdf")


def fed(worker: Worker) -> None:
    """Let a worker take a recording."""
    for item in recorded(BAGS / "arm3"):
        if item.topic == "/joint_states":
            worker.enqueue([Received(*item.raw, time.perf_counter())])


def solved(worker: Worker) -> Estimate | GeomidError:
    """What it finds."""
    answers: queue.Queue[Estimate | GeomidError] = queue.Queue()
    worker.request_estimate(answers.put)
    return answers.get(timeout=PATIENCE)


@pytest.mark.parametrize("settings", [{"effort_gain": -1.0}, {"gravity": [1.5, -0.8, -9.66]}], ids=["error", "remark"])
def test_it_is_said_in_the_same_words_until_a_reset(settings: dict[str, Any]) -> None:
    """But for numbers, which are without the last seconds, not yet judged."""
    of_bag = session(**settings)
    read_bags(of_bag, Bags(fitted=[BAGS / "arm3"]), lambda _: None)
    review = of_bag.review
    (said,) = [*(finding.sentence for finding in review.findings), *review.recorded.remarks]
    assert ("effort_gain: 1.0" in said) == bool(review.findings)
    worker = Worker(session(**settings), 3600.0, Listener(), Failures())
    try:
        fed(worker)
        assert isinstance(solved(worker), Estimate)
        status = worker.status(active=True)
        sentences = status.problems if review.findings else status.warnings
        assert re.sub(r"[\d.]+", "", said) in [re.sub(r"[\d.]+", "", sentence) for sentence in sentences]
        assert len(status.problems) == len(review.findings)
        worker.reset()
        assert isinstance(solved(worker), GeomidError)
        assert worker.status(active=True).problems == ()
        assert not any("gravity" in warning for warning in worker.status(active=True).warnings)
    finally:
        worker.close()
