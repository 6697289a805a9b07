"""Joints that nobody publishes: the node locks them as the command line does, and lets them go when they are heard."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from commands.test_robot_options import with_gripper

from geomid_ros.live import supervisor as module
from geomid_ros.live.inbox import Received
from geomid_ros.live.status import Listener
from geomid_ros.live.supervisor import Supervisor
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.session.configuration import Configuration
from geomid_ros.signals.ledger import Ledger

from .stage import NO_CHOICE, messages
from .waiting import PATIENCE, wait_until

STATES = [item for item in messages() if item.topic == "/joint_states"][:300]
ARM, FINGER = ("joint1", "joint2", "joint3"), "finger_joint1"


class Clock(SimpleNamespace):
    """Stands still until it is put forward."""

    now = 10_000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


class Carrying(Listener):
    """Notes what is carried."""

    def __init__(self, said: list[str]) -> None:
        self._said = said

    def on_payload(self, carried: CarriedPayload | None) -> None:
        self._said.append(f"carries {carried}")


@pytest.fixture
def node() -> Iterator[tuple[Supervisor, list[str]]]:
    """What a node does without ROS, with a gripper on its arm, and what it logs."""
    said: list[str] = []
    log = SimpleNamespace(info=said.append, warning=said.append, error=said.append)
    supervisor = Supervisor(
        Configuration({**NO_CHOICE, "solve_period": 3600.0}),
        Ledger(),
        log,
        Carrying(said),
        None,
    )
    supervisor.build(with_gripper(), "test")
    yield supervisor, said
    with suppress(AttributeError):
        supervisor.worker.close(PATIENCE)  # type: ignore[union-attr]


def feed(supervisor: Supervisor, finger: bool = False) -> int:
    """Let a supervisor's worker take messages of the arm; returns how many rows it has then."""
    worker = supervisor.worker
    assert worker is not None
    for item in STATES:
        message = item.message
        fields = {key: np.append(getattr(message, key), 0.01) for key in ("position", "velocity", "effort")}
        taken = item.changed(name=[*message.name, FINGER], **fields) if finger else item
        worker.enqueue([Received(*taken.raw, time.perf_counter())])
    all_taken = Event()
    worker.request_estimate(lambda _: all_taken.set())
    assert all_taken.wait(PATIENCE)
    return worker.session.identifier.counts.taken


def joints(supervisor: Supervisor) -> tuple[str, ...]:
    assert supervisor.worker is not None
    return supervisor.worker.session.robot.joint_names


def test_they_are_locked_when_all_had_the_time_to_be_heard(node: tuple[Supervisor, list[str]], clock: Clock) -> None:
    supervisor, said = node
    supervisor.lock_absent_joints()
    assert feed(supervisor) == 0
    supervisor.lock_absent_joints()
    assert joints(supervisor) == (*ARM, FINGER)
    clock.now += 2.0 * module.PUBLISHERS_START
    supervisor.lock_absent_joints()
    assert joints(supervisor) == ARM
    assert any(f"no message names '{FINGER}': locked at zero" in line for line in said)
    assert said.count("carries None") == 1, "what the robot before carried is taken back"
    assert supervisor.worker is not None
    (note,) = supervisor.worker.session.notes
    assert note in said, "what is saved has it, too"
    assert feed(supervisor) > 100
    clock.now += 2.0 * module.PUBLISHERS_START
    supervisor.lock_absent_joints()
    assert supervisor.worker is not None
    assert supervisor.worker.session.identifier.counts.taken > 100, "all is settled: no rows are lost"


def test_they_stay_locked_after_a_crash(tmp_path: Path, clock: Clock) -> None:
    """The rows are of the robot with these joints locked. An empty checkpoint of another robot is in nobody's way."""
    said: list[str] = []
    log = SimpleNamespace(info=said.append, warning=lambda _: None, error=lambda line: said.append(f"error: {line}"))
    parameters = {**NO_CHOICE, "solve_period": 3600.0, "checkpoint.folder": str(tmp_path), "checkpoint.period": 0.1}
    for life in range(2):
        supervisor = Supervisor(Configuration(parameters), Ledger(), log, Listener(), None)
        supervisor.build(with_gripper(), "test")
        for _ in range(2):
            if not life:
                feed(supervisor)
            supervisor.lock_absent_joints()
            clock.now += 2.0 * module.PUBLISHERS_START
        if not life:
            kept = feed(supervisor)
            assert supervisor.checkpoints is not None
            wait_until(lambda of=supervisor.checkpoints, rows=kept: of.status.values["rows"] == rows)
        assert supervisor.checkpoints is not None
        assert supervisor.worker is not None
        assert supervisor.worker.session.identifier.rows == kept > 100
        assert joints(supervisor) == ARM
        supervisor.worker.close(PATIENCE)
        supervisor.checkpoints.close(PATIENCE)
    assert not [line for line in said if line.startswith("error")]


def test_failures_are_counted_on_though_another_worker_takes_over(node: tuple[Supervisor, list[str]]) -> None:
    """Else diagnostics, which tell what is new since the last ones, would tell nothing of the next one."""
    supervisor, _ = node
    for count in (1, 2):
        supervisor.build(with_gripper(), "test")
        assert supervisor.worker is not None
        with supervisor.worker.failures.counted("this failed"):
            raise ZeroDivisionError
        assert supervisor.worker.status(active=True).failures == {"this failed: ZeroDivisionError: ": count}


def test_they_move_again_when_they_are_heard(node: tuple[Supervisor, list[str]], clock: Clock) -> None:
    supervisor, _ = node
    for finger, expected in ((False, ARM), (True, (*ARM, FINGER))):
        supervisor.lock_absent_joints()
        feed(supervisor, finger)
        clock.now += 2.0 * module.PUBLISHERS_START
        supervisor.lock_absent_joints()
        assert joints(supervisor) == expected
    assert feed(supervisor, finger=True) > 100
