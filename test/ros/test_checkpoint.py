"""What the node says is safe survives it, whatever ends it; a disk that fails costs checkpoints and nothing else."""

from __future__ import annotations

import errno
import itertools
import json
import logging
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from signals.feeding import completed

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.files.archive import decoded
from geomid_ros.files.checkpoints import Checkpoint
from geomid_ros.live import saving, supervisor, threads
from geomid_ros.live.saving import Checkpoints
from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.supervisor import Supervisor
from geomid_ros.live.worker import Worker
from geomid_ros.model.samples import Samples
from geomid_ros.ros.diagnostics import Diagnostics
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import Ledger

from .observer import latched
from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages, staged
from .waiting import PATIENCE, final_estimate, wait_until

ARM3 = {**WRIST, **NO_CHOICE, "robot_description": description("arm3"), "solve_period": 0.5}
FLAT = {**NO_CHOICE, "wrenches": ["wrist"], "wrench.wrist.topic": "/wrench", "wrench.wrist.frame": "wrist_ft"}
MESSAGES = messages()
HALF = len(MESSAGES) // 2
EACH = HALF // 2  # messages of either topic in half of the bag
SOON = 0.05  # [s]


def keeping(folder: Path, period: float = 0.5) -> dict[str, Any]:
    return {**ARM3, "checkpoint": {"folder": str(folder), "period": period}}


def session(robot: str = "arm3") -> Session:
    return Session(description(robot), Configuration(FLAT), robot)


def fed(of: Session, begin: int, end: int) -> Session:
    """A session with this part of the bag, as a node has it that has heard nothing before."""
    part = (item.parsed for item in MESSAGES[begin:end])
    of.identifier.add(Samples.concatenate(list(completed(of.new_pipeline(), part))))
    return of


def generations(folder: Path) -> list[Checkpoint]:
    """All checkpoints in a folder, the newest last; each must be whole."""
    of = session()
    files = sorted(folder.glob("checkpoint-*"))
    found = [decoded(Checkpoint, file.read_bytes(), of.meaning) for file in files]
    return sorted(found, key=lambda checkpoint: checkpoint.number)


def rows(folder: Path) -> int:
    """Those of the newest checkpoint."""
    return generations(folder)[-1].memory.summary.rows


def told(stage: Stage, look: Callable[[DiagnosticStatus, dict[str, str]], bool], what: str) -> dict[str, str]:
    """Values of the first diagnostics of checkpoints from now on that satisfy ``look``."""
    arrays = stage.observer.collect(DiagnosticArray, "/diagnostics")

    def find() -> dict[str, str]:
        for status in itertools.chain.from_iterable(array.status for array in arrays):
            values = {pair.key: pair.value for pair in status.values}
            if status.name.endswith(": checkpoints") and look(status, values):
                return values
        arrays.clear()
        return {}

    return stage.observer.wait_for(find, what)


def test_killed_and_told_to_end_it_goes_on_with_what_was_safe(tmp_path: Path) -> None:
    """With an estimate before any message has come, and counting on; told to end, it keeps everything. Each life in a
    domain of its own: in the same one a killed node is known for some seconds."""
    folder, out = tmp_path / "kept", tmp_path / "out"
    for life in ("killed", "ended"):
        (tmp_path / life).mkdir()
    with staged(tmp_path / "killed") as stage:
        node = stage.node(keeping(folder))
        assert "resumed from" not in told(stage, lambda *_: True, "a node")["beginning"]
        stage.observer.publish(MESSAGES[:HALF], KINDS)
        safe = int(told(stage, lambda _, values: int(values["rows"]) > 0, "rows that are safe")["rows"])
        at = int(np.random.default_rng(0).integers(HALF))
        stage.observer.publish(killing(node, MESSAGES[HALF:], at), KINDS)
        assert node.status() == -signal.SIGKILL
    newest = generations(folder)[-1]
    assert newest.memory.summary.rows >= safe
    assert 0 < newest.accounts["joint_states"].accepted <= 2 * EACH
    alone = session()
    alone.restore(newest)
    fed(alone, HALF, len(MESSAGES))
    with staged(tmp_path / "ended") as stage:
        inertias = stage.observer.collect(InertiaStamped, "/geomid/inertias", latched())
        node = stage.node({**keeping(folder, 3600.0), "output_folder": str(out)})
        known = told(stage, lambda *_: True, "a node")
        assert int(known["rows"]) == newest.memory.summary.rows
        assert "resumed from" in known["beginning"]
        stage.observer.wait_for(lambda: inertias, "an estimate")
        stage.observer.publish(MESSAGES[HALF:], KINDS)
        stage.fed({topic: account.received + EACH for topic, account in newest.accounts.items()})
        assert stage.observer.trigger("/geomid/save")[0]
        assert node.end(signal.SIGTERM) == 0
    last, saved, expected = generations(folder)[-1], json.loads((out / "estimate.json").read_text()), alone.identifier
    assert last.memory.summary.rows == saved["rows"]["accepted"] == expected.rows
    masses = [link.mass for link in expected.solve().links]
    assert [link["mass"] for link in saved["links"]] == pytest.approx(masses, rel=1e-6)
    assert {topic: account.accepted for topic, account in last.accounts.items()} == {
        topic: account.accepted + EACH for topic, account in newest.accounts.items()
    }


def killing(node: Any, part: list[Any], at: int) -> Iterator[Any]:
    """Messages, in the midst of which a node is killed."""
    for index, item in enumerate(part):
        if index == at:
            node.send(signal.SIGKILL)
        yield item


def supervised(**parameters: Any) -> Supervisor:
    """What a node does without ROS, with a robot, as it solves only when it is asked."""
    configuration = Configuration({**FLAT, "solve_period": 3600.0, **parameters})
    node = Supervisor(configuration, Ledger(), logging.getLogger(), Listener(), None)
    node.build(description("arm3"), "arm3.urdf")
    return node


def test_without_a_place_for_checkpoints_it_estimates(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    node: Any = supervised(**{"checkpoint.folder": str(tmp_path / "file")})
    with closing(node):
        fed(node.worker.session, 0, HALF)
        assert isinstance(final_estimate(node.worker), Estimate)
        status = node.worker.status(active=True)
        _, told, *_ = Diagnostics("geomid").array(status, checkpoints=node.checkpoints.status).status
    assert (told.name, told.level) == ("geomid: checkpoints", DiagnosticStatus.ERROR)
    assert str(tmp_path / "file") in told.message
    assert (tmp_path / "file").read_text() == "in the way"


def rows_safe(checkpoints: Checkpoints) -> object:
    return checkpoints.status.values["rows"]


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time of checkpoints, which stands still: a busy machine makes no disk slow."""
    time_of_day = [1000.0]
    for module in (saving, threads):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: time_of_day[0]))
    return time_of_day


@pytest.mark.usefixtures("now")
def test_a_disk_that_fails_is_reported_and_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    of = session()
    with closing(Checkpoints(session(), tmp_path / "idle", SOON)), closing(Checkpoints(of, tmp_path, SOON)) as kept:
        fed(of, 0, HALF)
        wait_until(lambda: rows_safe(kept) == of.identifier.rows > 0)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", fail)
            fed(of, HALF, len(MESSAGES))
            wait_until(lambda: "No space left on device" in kept.status.problem)
            assert rows_safe(kept) < of.identifier.rows
        wait_until(lambda: rows_safe(kept) == of.identifier.rows)
        assert kept.status.problem == ""
        assert rows(tmp_path) == of.identifier.rows
        of.identifier.reset()
        wait_until(lambda: rows_safe(kept) == 0)
    assert not list((tmp_path / "idle").glob("checkpoint*")), "there was nothing to write"
    assert rows(tmp_path) == 0, "what was to be forgotten is"


def test_a_disk_that_is_slow_is_reported_and_waited_for_by_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, now: list[float]
) -> None:
    writing, may_go_on = threading.Event(), threading.Event()
    monkeypatch.setattr(os, "fsync", lambda _: writing.set() or may_go_on.wait(PATIENCE))
    of = session()
    with closing(Checkpoints(of, tmp_path, SOON)) as kept:
        fed(of, 0, HALF)
        assert writing.wait(PATIENCE)
        assert kept.status.problem == ""
        now[0] += 2.0 * SOON
        assert "the disk is slow" in kept.status.problem
        fed(of, HALF, len(MESSAGES))
        kept.close()
        assert rows_safe(kept) == 0
        may_go_on.set()
        wait_until(lambda: rows_safe(kept) == of.identifier.rows and not kept.status.problem)


def test_the_next_session_waits_for_a_slow_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It needs the folder, which the one before has until its last checkpoint is written."""
    node = supervised(**{"checkpoint.folder": str(tmp_path), "checkpoint.period": 3600.0})
    monkeypatch.setattr(supervisor, "HANDOVER", PATIENCE)
    assert node.worker is not None
    rows = fed(node.worker.session, 0, HALF).identifier.rows
    with monkeypatch.context() as slow:
        slow.setattr(os, "fsync", lambda _: time.sleep(saving.PATIENCE))
        node.build(description("arm3"), "arm3.urdf")
    assert node.checkpoints is not None
    assert node.checkpoints.status.problem == ""
    assert f"with {rows} rows" in node.checkpoints.beginning
    node.close()


@pytest.mark.parametrize(("ends", "said"), [(True, "written: "), (False, "may not be saved: .* after 0.[3-9] s")])
def test_what_is_saved_late_is_reported_as_it_is(
    ends: bool, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Another one may be saved at the same time; and saving goes on while the last checkpoint is written."""
    node = supervised(output_folder=str(tmp_path))
    assert node.worker is not None
    fed(node.worker.session, 0, HALF)
    final_estimate(node.worker)
    monkeypatch.setattr(supervisor, "PATIENCE", 0.3)
    other = node.saving._one_at_a_time
    other.acquire()

    def end() -> None:
        if ends:
            other.release()
            wait_until(lambda: not any(thread.name == "geomid-saving" for thread in threading.enumerate()))

    monkeypatch.setattr(node, "checkpoints", SimpleNamespace(close=end))
    caplog.set_level(logging.INFO)
    node.close()
    assert re.search(said, caplog.messages[-1])
    assert ends or other.release() is None


def test_the_first_solve_begins_where_the_last_ended(tmp_path: Path) -> None:
    """Large robots take long to find the prior's weight; and it would be another estimate."""
    with closing(Checkpoints(of := session(), tmp_path, 3600.0)), closing(working(of)[0]) as worker:
        fed(of, 0, HALF)
        wait_until(lambda: worker.solver.estimate is not None)
        last = worker.solver.estimate
    with closing(Checkpoints(of := session(), tmp_path, 3600.0)):
        worker, starts = working(of)
        with closing(worker):
            wait_until(lambda: worker.solver.estimate is not None)
            first = worker.solver.estimate
    assert len(starts) >= 1
    assert starts[0] is not None
    np.testing.assert_array_equal(starts[0].parameters, last.parameters)
    # Noise and spreads settle to 1e-7.
    np.testing.assert_allclose(first.parameters, last.parameters, rtol=1e-6, atol=1e-9)
    assert first.gamma == pytest.approx(last.gamma, rel=1e-6)


def working(of: Session) -> tuple[Worker, list[WarmStart | None]]:
    """A worker of a session, and where its solves begin."""
    starts: list[WarmStart | None] = []
    solve = of.identifier.solve
    of.identifier.solve = lambda warm=None: starts.append(warm) or solve(warm)  # type: ignore[method-assign]
    return Worker(of, SOON, Listener(), Failures()), starts
