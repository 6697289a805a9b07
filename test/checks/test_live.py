"""The node says what a recording seems to be in the words of the command line."""

from __future__ import annotations

import queue
import re
import time

from files.recordings import BAGS, recorded

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live.inbox import Received
from geomid_ros.live.status import Failures, Listener
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


def test_it_is_an_error_in_the_same_words_until_a_reset() -> None:
    of_bag = session(effort_gain=-1.0)
    read_bags(of_bag, Bags(fitted=[BAGS / "arm3"]), lambda _: None)
    worker = Worker(session(effort_gain=-1.0), 3600.0, Listener(), Failures())
    try:
        fed(worker)
        assert isinstance(solved(worker), Estimate)
        (sentence,) = worker.status(active=True).problems
        assert sentence == of_bag.review.findings[0].sentence
        assert "effort_gain: 1.0" in sentence
        worker.reset()
        assert isinstance(solved(worker), GeomidError)
        assert worker.status(active=True).problems == ()
    finally:
        worker.close()


def test_a_remark_is_a_warning_in_the_same_words_until_a_reset() -> None:
    tilted = [1.5, -0.8, -9.66]
    of_bag = session(gravity=tilted)
    read_bags(of_bag, Bags(fitted=[BAGS / "arm3"]), lambda _: None)
    (remark,) = of_bag.review.recorded.remarks
    worker = Worker(session(gravity=tilted), 3600.0, Listener(), Failures())
    try:
        fed(worker)
        assert isinstance(solved(worker), Estimate)
        words = [re.sub(r"[\d.]+", "", warning) for warning in worker.status(active=True).warnings]
        assert re.sub(r"[\d.]+", "", remark) in words  # the numbers are without the last seconds, not yet judged
        assert worker.status(active=True).problems == ()
        worker.reset()
        assert isinstance(solved(worker), GeomidError)
        assert not any("gravity" in warning for warning in worker.status(active=True).warnings)
    finally:
        worker.close()
