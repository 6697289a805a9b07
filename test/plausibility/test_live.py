"""The node says what a recording seems to be in the words of the command line."""

from __future__ import annotations

import queue

from files.recordings import BAGS, recorded

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live.worker import Worker
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session

PATIENCE = 120.0


def session() -> Session:
    configuration = Configuration({"effort_gain": -1.0, "candidates": []})
    return Session(read_urdf(BAGS / "arm3.urdf"), configuration, "arm3.urdf")


def test_it_is_an_error_in_the_same_words_until_a_reset() -> None:
    of_bag = session()
    read_bags(of_bag, Bags(fitted=[BAGS / "arm3"]))
    worker = Worker(session(), 3600.0, lambda *_: None, lambda *_: None)
    try:
        for item in recorded(BAGS / "arm3"):
            if item.topic == "/joint_states":
                worker.take(*item.raw)
        answers: queue.Queue[Estimate | GeomidError] = queue.Queue()
        worker.final_estimate(answers.put)
        assert isinstance(answers.get(timeout=PATIENCE), Estimate)
        (sentence,) = worker.status(active=True).problems
        assert sentence == of_bag.findings[0].sentence
        assert "effort_gain: 1.0" in sentence
        worker.reset()
        worker.final_estimate(answers.put)
        assert isinstance(answers.get(timeout=PATIENCE), GeomidError)
        assert worker.status(active=True).problems == ()
    finally:
        worker.close()
