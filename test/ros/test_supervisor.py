"""What a node does without ROS: it locks joints that nobody publishes, as the command line does, and lets them go when
they are heard; what hangs begins anew; what saving takes is said."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from commands.test_robot_options import with_gripper

from geomid_ros.checks.verdict import DOUBTFUL, Verdict
from geomid_ros.errors import InputError
from geomid_ros.files.disk import write_text
from geomid_ros.live import saving, threads
from geomid_ros.live import supervisor as module
from geomid_ros.live.status import Listener
from geomid_ros.live.supervisor import HANGING, Supervisor
from geomid_ros.live.threads import Activity, Received
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.session.configuration import Configuration
from geomid_ros.signals.ledger import Ledger

from .stage import NO_CHOICE, messages
from .test_catalogue_console import Lines
from .waiting import PATIENCE, wait_until

STATES = [item for item in messages() if item.topic == "/joint_states"][:300]
ARM, FINGER = ("joint1", "joint2", "joint3"), "finger_joint1"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stands still until it is put forward."""
    clock = SimpleNamespace(now=10_000.0, monotonic=lambda: clock.now)
    monkeypatch.setattr(module, "time", clock)
    return clock


class Carrying(Listener):
    """Notes what is carried."""

    def __init__(self) -> None:
        self.said: list[CarriedPayload | None] = []

    def on_payload(self, carried: CarriedPayload | None) -> None:
        self.said.append(carried)


def begun(log: Any, **parameters: Any) -> Supervisor:
    """With a gripper on its arm."""
    supervisor = Supervisor(
        Configuration({**NO_CHOICE, "solve_period": 3600.0, **parameters}), Ledger(), log, Carrying(), None
    )
    supervisor.build(with_gripper(), "test")
    return supervisor


@pytest.fixture
def node() -> Iterator[tuple[Supervisor, Lines]]:
    """What a node does without ROS, and what it logs."""
    supervisor = begun(log := Lines())
    yield supervisor, log
    with suppress(AttributeError):
        supervisor.worker.close(PATIENCE)  # type: ignore[union-attr]


def worker(supervisor: Supervisor) -> Any:
    assert supervisor.worker is not None
    return supervisor.worker


def feed(supervisor: Supervisor, finger: bool = False) -> int:
    """Let a supervisor's worker take messages of the arm; returns how many rows it has then. None has the second
    finger, which mimics the first one."""
    for item in STATES:
        message = item.message
        fields = {key: np.append(getattr(message, key), 0.01) for key in ("position", "velocity", "effort")}
        taken = item.changed(name=[*message.name, FINGER], **fields) if finger else item
        worker(supervisor).enqueue([Received(*taken.raw, time.perf_counter())])
    all_taken = Event()
    worker(supervisor).request_estimate(lambda _: all_taken.set())
    assert all_taken.wait(PATIENCE)
    return int(worker(supervisor).session.identifier.counts.taken)


def joints(supervisor: Supervisor) -> tuple[str, ...]:
    names: tuple[str, ...] = worker(supervisor).session.robot.joint_names
    return names


def test_they_are_locked_when_all_had_the_time_to_be_heard(
    node: tuple[Supervisor, Lines], clock: SimpleNamespace
) -> None:
    """And move again when they are heard."""
    supervisor, log = node
    supervisor.lock_absent_joints()
    assert feed(supervisor) == 0
    supervisor.lock_absent_joints()
    assert joints(supervisor) == (*ARM, FINGER)
    clock.now += 2.0 * module.PUBLISHERS_START
    supervisor.lock_absent_joints()
    assert joints(supervisor) == ARM
    said = [line for _, line in log.lines]
    assert any(f"no message names '{FINGER}': locked at zero" in line for line in said)
    assert supervisor._listener.said == [None], "what the robot before carried is taken back"
    (note,) = worker(supervisor).session.notes
    assert note in said, "what is saved has it, too"
    assert feed(supervisor) > 100
    clock.now += 2.0 * module.PUBLISHERS_START
    supervisor.lock_absent_joints()
    assert worker(supervisor).session.identifier.counts.taken > 100, "all is settled: no rows are lost"
    feed(supervisor, finger=True)
    clock.now += 2.0 * module.PUBLISHERS_START
    supervisor.lock_absent_joints()
    assert joints(supervisor) == (*ARM, FINGER)
    assert feed(supervisor, finger=True) > 100


def test_they_stay_locked_after_a_crash(tmp_path: Path, clock: SimpleNamespace) -> None:
    """The rows are of the robot with these joints locked. An empty checkpoint of another robot is in nobody's way."""
    log = Lines()
    for life in range(2):
        supervisor = begun(log, **{"checkpoint.folder": str(tmp_path), "checkpoint.period": 0.1})
        for _ in range(2):
            if not life:
                feed(supervisor)
            supervisor.lock_absent_joints()
            clock.now += 2.0 * module.PUBLISHERS_START
        assert supervisor.checkpoints is not None
        if not life:
            kept = feed(supervisor)
            wait_until(lambda of=supervisor.checkpoints, rows=kept: of.status.values["rows"] == rows)
        assert worker(supervisor).session.identifier.rows == kept > 100
        assert joints(supervisor) == ARM
        worker(supervisor).close(PATIENCE)
        supervisor.checkpoints.close(PATIENCE)
    assert "error" not in dict(log.lines)


def test_failures_are_counted_on_though_another_worker_takes_over(node: tuple[Supervisor, Lines]) -> None:
    """Else diagnostics, which tell what is new since the last ones, would tell nothing of the next one."""
    supervisor, _ = node
    for count in (1, 2):
        supervisor.build(with_gripper(), "test")
        with worker(supervisor).failures.counted("this failed"):
            raise ZeroDivisionError
        assert worker(supervisor).status(active=True).failures == {"this failed: ZeroDivisionError: ": count}


# --- What hangs -------------------------------------------------------------------------------------------------------


class Hanging:
    """As much of a solving process as hangs."""

    def __init__(self) -> None:
        self.restarts, self.solves = 0, True

    def give_up(self) -> bool:
        self.restarts += self.solves
        return self.solves


def watching(**of_worker: Any) -> tuple[Supervisor, Any, Any]:
    """A supervisor of a worker whose results nobody hears, its solving process and its solver."""
    solving: Any = Hanging()
    solver = SimpleNamespace(activity=Activity(), solves=7, close=lambda _: None, estimate=None)
    watched = Supervisor(Configuration({}), Ledger(), Lines(), Listener(), solving)
    watched.worker = SimpleNamespace(**{"activity": Activity(), "solver": solver, **of_worker})  # type: ignore[assignment]
    return watched, solving, solver


def test_92_what_hung_is_told_until_there_is_an_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solve that hangs is ended, however often that happens."""
    monkeypatch.setattr(Activity, "current", ("solving", 1e6))
    watched, solving, solver = watching(activity=SimpleNamespace(current=("", 0.0)))
    for _ in range(20):
        watched.restart_hung_threads()
    assert solving.restarts == 20
    with monkeypatch.context() as well:
        well.setattr(Activity, "current", ("", 0.0))
        watched.restart_hung_threads()
        assert watched.problems[0] == "the solver hung and was restarted"
        solver.solves += 1
        watched.restart_hung_threads()
        assert watched.problems[0] == ""
    solving.solves = False  # it hangs in something else, which nobody can end
    watched.restart_hung_threads()
    assert watched.problems[0] == "the solver thread hangs outside a solve; restart the node"
    monkeypatch.setattr(Activity, "current", ("", 0.0))  # nor does it for ever
    watched.restart_hung_threads()
    assert not any(watched.problems)


def test_92_messages_that_nobody_processes_any_more_hide_no_solver_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Activity, "current", ("solving", 1e6))
    monkeypatch.setattr(module, "MOST_RESTARTS", 0)
    watched, solving, _ = watching()
    watched.restart_hung_threads()
    assert solving.restarts == 1
    again, hung, *_ = watched.problems
    assert again.startswith("message processing hangs again")
    assert hung == "the solver hung and was restarted"


def test_92_a_hang_is_known_though_nothing_can_begin_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """And forgotten with the worker that it was of."""
    monkeypatch.setattr(Activity, "current", ("taking", 1e6))
    none = SimpleNamespace(urdf="<no robot", pipeline=SimpleNamespace(period=0.0))
    watched, *_ = watching(session=none, close=lambda _: None, estimate=None)
    watched._solving = None
    with pytest.raises(InputError):
        watched.restart_hung_threads()
    assert watched.problems[0] == "message processing hung and was restarted, 1 of at most 3 times"
    watched.close()
    assert not any("hung" in problem for problem in watched.problems)


def test_92_what_goes_on_after_a_hang_has_its_own_time(clock: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was held up counts from the end of what held it up: the next solve is not ended with it."""
    monkeypatch.setattr(threads, "time", clock)
    watched, solving, solver = watching()
    begin = clock.now
    with solver.activity.doing("solving"):
        for passed, restarts in ((HANGING + 1.0, 1), (HANGING + 2.0, 1), (2.0 * HANGING, 1), (3.0 * HANGING, 2)):
            clock.now = begin + passed
            watched.restart_hung_threads()
            assert solving.restarts == restarts


# --- What saving takes ------------------------------------------------------------------------------------------------

VERDICT = Verdict(word=DOUBTFUL, reasons=("it weighs 2464 kg", "it is of another robot"))
ESTIMATED = Mock(rows_accepted=7)


class Slow:
    """As much of a worker as saving asks: it has an estimate, or none, and never another one."""

    def __init__(self, estimate: Any) -> None:
        self.session = SimpleNamespace(
            review=SimpleNamespace(verdict=lambda _: VERDICT), pipeline=SimpleNamespace(period=0.0)
        )
        self.estimate, self.saved = estimate, list[Any]()
        self.close = self.request_estimate = lambda _: None

    def save(self, _: Any, folder: Path, estimate: Any, verdict: Any) -> list[Path]:
        assert verdict is VERDICT
        self.saved.append(estimate)
        return [folder / "estimate.json"]


def test_66_a_folder_that_cannot_be_written_is_told_at_the_start_and_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    watched = Supervisor(Configuration({"output_folder": "/proc/nope"}), Ledger(), log := Lines(), Listener(), None)
    assert any(problem.startswith("output_folder /proc/nope: cannot be written") for problem in watched.problems)
    monkeypatch.setattr(saving, "save", lambda *_, **__: write_text(Path("/proc/nope/estimate.json"), ""))
    watched.worker = Slow(ESTIMATED)  # type: ignore[assignment]
    watched.close()
    ((level, line),) = log.lines
    assert level == "error"
    assert line.startswith("the last estimate is not saved: /proc/nope/estimate.json: cannot be written")


@pytest.mark.parametrize("estimate", [None, ESTIMATED], ids=["none", "an old one"])
def test_101_what_takes_too_long_is_said(estimate: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert saving._LATE < saving._LATEST < 5.0
    monkeypatch.setattr(saving, "_LATE", 0.2)
    monkeypatch.setattr(saving, "_LATEST", 1.0 if estimate is None else 20.0)
    answers: queue.SimpleQueue[tuple[bool, str]] = queue.SimpleQueue()
    slow: Any = Slow(estimate)
    monkeypatch.setattr(saving, "save", slow.save)
    saving.Saving(str(tmp_path)).begin_when_solved(slow, answers.put)
    success, message = answers.get(timeout=30.0)
    written = f"DOUBTFUL: it weighs 2464 kg; DOUBTFUL: it is of another robot; written: {tmp_path}/estimate.json; it "
    assert success == (estimate is not None)
    assert message.startswith(written if estimate else "no estimate yet: the first one takes more than 1 s; ask")
    assert slow.saved == [estimate] * (estimate is not None)
    with pytest.raises(queue.Empty):
        answers.get(timeout=0.5)


@pytest.mark.parametrize(("passed", "saved"), [(0.0, 2), (module.PATIENCE, 1)], ids=["in time", "late"])
def test_55_no_newer_estimate_is_saved_that_nobody_waits_for(
    passed: float, saved: int, clock: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The process would end in the middle of writing it."""

    def close(_: float) -> None:
        clock.now += passed
        working.estimate = Mock(rows_accepted=8)

    working: Any = Slow(ESTIMATED)
    working.close = close
    monkeypatch.setattr(saving, "save", working.save)
    monkeypatch.setattr(saving, "start_daemon", lambda _, act, *arguments: act(*arguments))
    watched = Supervisor(Configuration({"output_folder": str(tmp_path)}), Ledger(), Lines(), Listener(), None)
    watched.worker = working
    watched.close()
    assert working.saved[0] is ESTIMATED
    assert len(working.saved) == saved
