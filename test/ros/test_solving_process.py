"""Solving in a process of its own: the same estimates, and an end with its node, or before it."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from files.recordings import BAGS
from signals.feeding import completed

from geomid_ros.checks import recording_check
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.identifier import EstimationTask, Identifier
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live import solving_process as module
from geomid_ros.live.solving_process import SolvingProcess
from geomid_ros.live.status import Listener
from geomid_ros.live.supervisor import Supervisor
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import Ledger

from .stage import NO_CHOICE, messages
from .waiting import PATIENCE, wait_until

pytestmark = pytest.mark.filterwarnings("ignore:This process .* is multi-threaded")  # the tests', not the node's
MESSAGES = messages()


def children(process: int) -> list[int]:
    """The processes that one has started from its first thread."""
    return [int(child) for child in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def parent(process: int) -> int:
    """The process that has started one, from whatever thread."""
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])


def session(messages: int = 400, **parameters: object) -> Session:
    """The small arm's, with rows of so many messages."""
    result = Session(read_urdf(BAGS / "arm3.urdf"), Configuration({**NO_CHOICE, **parameters}), "arm3.urdf")
    for samples in parts(messages, result):
        result.identifier.add(samples)
        result.review.check.add(samples)
    return result


def parts(messages: int, of: Session) -> Iterator[Samples]:
    """The samples of so many messages."""
    joints = (item.parsed for item in MESSAGES[: 2 * messages] if item.topic == "/joint_states")
    return completed(of.pipeline, joints)


def assert_same(ours: Estimate | GeomidError, theirs: Estimate) -> None:
    assert isinstance(ours, Estimate)
    np.testing.assert_array_equal(ours.parameters, theirs.parameters)
    assert (ours.rows_accepted, ours.gamma, ours.steps) == (theirs.rows_accepted, theirs.gamma, theirs.steps)
    for link, other in zip(ours.links, theirs.links, strict=True):
        np.testing.assert_array_equal(link.std_inertia, other.std_inertia)
        assert link.inertia.flags.writeable == other.inertia.flags.writeable


@pytest.fixture
def solving() -> Iterator[SolvingProcess]:
    with closing(SolvingProcess()) as process:
        yield process


def test_the_estimates_are_those_of_one_process(solving: SolvingProcess) -> None:
    """Of one session and of another one; after its end it is solved here."""
    for effects in (["viscous_friction"], [""]):
        ours, theirs = session(effects=effects), session(effects=effects)
        ours.identifier.solve_with(solving.remote(EstimationTask.solve))
        assert_same(ours.identifier.solve(), theirs.identifier.solve())
    assert solving.warning == ""
    solving.close()
    assert_same(ours.identifier.solve(), theirs.identifier.solve())


def test_recordings_are_judged_there_and_alike(solving: SolvingProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    """By what the supervisor builds; here, judging would fail."""
    faulty = {"effort_gain": -1.0}
    alone = session(2000, **faulty)
    alone.review.judge()
    (expected,) = alone.review.findings
    assert "effort_gain: 1.0" in expected.sentence
    supervisor = Supervisor(
        Configuration(faulty),
        Ledger(),
        logging.getLogger(),
        Listener(),
        solving,
    )
    supervisor.build(read_urdf(BAGS / "arm3.urdf"), "arm3.urdf")
    assert supervisor.worker is not None
    with closing(supervisor.worker) as worker:
        monkeypatch.setattr(recording_check, "check_efforts", None)
        for joints in parts(2000, worker.session):
            worker.session.review.check.add(joints)
        worker.session.review.judge()
        assert worker.session.review.findings == (expected,)


def pid(solving: SolvingProcess) -> int:
    """The present process."""
    return solving._process.pid or 0


def test_a_process_that_is_killed_is_replaced(solving: SolvingProcess) -> None:
    """Idle, and then in the middle of a solve, which is done again."""
    ours, expected = session(), session().identifier.solve()
    ours.identifier.solve_with(solving.remote(EstimationTask.solve))
    first = pid(solving)
    os.kill(first, signal.SIGKILL)
    wait_until(lambda: "died" in solving.warning)
    assert_same(ours.identifier.solve(), expected)
    assert "restarted, time 1" in solving.warning
    second = pid(solving)
    os.kill(second, signal.SIGSTOP)
    thread, results = in_thread(ours.identifier)
    wait_until(solving._solving.locked)
    os.kill(second, signal.SIGKILL)
    thread.join(PATIENCE)
    assert_same(results[0], expected)
    assert "restarted, time 2" in solving.warning
    assert len({first, second, pid(solving)}) == 3
    assert parent(pid(solving)) == os.getpid()


def test_one_that_ends_in_every_solve_is_started_after_pauses(
    solving: SolvingProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for lack of memory. Meanwhile, nothing is solved here; and in the end it works again."""
    now = [1000.0]
    monkeypatch.setattr(
        module, "time", SimpleNamespace(monotonic=lambda: now[0])
    )  # not for all of Python, which waits by it
    ours = session()
    ours.identifier.solve_with(solving.remote(EstimationTask.solve))
    answer, begun = solving._answer, []
    begin = solving._begin

    def ends(*_: object) -> Estimate:
        solving._process.kill()
        raise EOFError

    monkeypatch.setattr(solving, "_answer", ends)
    monkeypatch.setattr(solving, "_begin", lambda method: (begun.append(now[0]), begin(method)))
    for _ in range(500):
        with pytest.raises(GeomidError, match="the solver process died"):
            ours.identifier.solve()
        now[0] += 1.0
    pauses = np.diff(begun)
    assert len(begun) < 15
    assert pauses[-1] == pytest.approx(60.0, abs=1.0)
    assert np.all(np.diff(pauses[1:]) >= -1.0)
    monkeypatch.setattr(solving, "_answer", answer)
    now[0] += 100.0
    assert_same(ours.identifier.solve(), session().identifier.solve())


def in_thread(identifier: Identifier) -> tuple[threading.Thread, list[Estimate | GeomidError]]:
    """A thread that solves, and what comes of it."""
    results: list[Estimate | GeomidError] = []

    def solve() -> None:
        try:
            results.append(identifier.solve())
        except GeomidError as error:
            results.append(error)

    thread = threading.Thread(target=solve)
    thread.start()
    return thread, results


def test_a_solve_of_another_session_is_waited_for(solving: SolvingProcess) -> None:
    """The process goes on with what is asked for next: here, rows of another session."""
    ours, theirs = session(effects=["viscous_friction"]), session()
    for each in (ours, theirs):
        each.identifier.solve_with(solving.remote(EstimationTask.solve))
    os.kill(solving._process.pid or 0, signal.SIGSTOP)
    first, given_up = in_thread(ours.identifier)
    wait_until(solving._solving.locked)
    second, wanted = in_thread(theirs.identifier)
    os.kill(solving._process.pid or 0, signal.SIGCONT)
    first.join(PATIENCE)
    second.join(PATIENCE)
    assert_same(given_up[0], session(effects=["viscous_friction"]).identifier.solve())
    assert_same(wanted[0], session().identifier.solve())
    assert solving.warning == ""


def test_a_solve_that_is_given_up_ends_with_an_error(solving: SolvingProcess) -> None:
    """The next one is made by another process, at once however many were given up; while there is none, nothing is."""
    solving.give_up()
    ours, theirs = session(), session()
    ours.identifier.solve_with(solving.remote(EstimationTask.solve))
    os.kill(solving._process.pid or 0, signal.SIGSTOP)
    thread, given_up = in_thread(ours.identifier)
    wait_until(solving._solving.locked)
    assert solving.warning == ""
    solving.give_up()
    thread.join(PATIENCE)
    assert str(given_up[0]) == "the solve was aborted"
    before = pid(solving)
    thread, given_up = in_thread(ours.identifier)
    wait_until(lambda: pid(solving) != before)
    assert solving.give_up()
    thread.join(PATIENCE)
    assert str(given_up[0]) == "the solve was aborted"
    assert_same(ours.identifier.solve(), theirs.identifier.solve())
    assert "restarted" in solving.warning
