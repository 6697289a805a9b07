"""Which rows of wrench sensors a worker takes, of an arm with two sensors in its chain."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from files.recordings import BAGS, Recorded
from signals.feeding import completed

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live import worker as module
from geomid_ros.live.status import Failures, Listener, Status
from geomid_ros.live.threads import Received
from geomid_ros.live.worker import Worker
from geomid_ros.model.samples import Samples
from geomid_ros.ros.diagnostics import Diagnostics
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session

from .in_motion import SECOND, START, InMotion, in_time, noisy
from .stage import NO_CHOICE
from .waiting import PATIENCE, final_estimate, wait_until

SECONDS, RATE = 42.0, 50.0
TARED, BACK = 26.0, 33.0  # [s]
BLOCK = 40  # instants that are judged together
LATE = 2 * BLOCK
AT_ONCE = 60  # messages
URDF = BAGS / "arm3.urdf"
AXES, CHANNELS = 6, 15
SENSORS = ("/elbow", "/wrist")
VALUES = {
    **NO_CHOICE,
    "wrenches": ["elbow", "wrist"],
    "wrench.elbow.topic": "/elbow",
    "wrench.elbow.frame": "link2",
    "wrench.wrist.topic": "/wrist",
    "wrench.wrist.frame": "wrist_ft",
}
SAME = 1e-8
Change = Callable[[float, np.ndarray], np.ndarray]  # of a wrench, or efforts, at a time


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine may be busy."""
    monkeypatch.setattr(module, "PATIENCE", PATIENCE)


@cache
def arm() -> tuple[InMotion, dict[str, np.ndarray], np.ndarray]:
    """The arm, what its sensors and its joints measure."""
    robot = InMotion(
        read_urdf(URDF), duration=SECONDS, rate=RATE, seed=2, cuts=["link2", "wrist_ft"], swing=0.8, error=0.1
    )
    wrenches = {"/elbow": robot.carried("link2"), "/wrist": robot.carried("wrist_ft")}
    noisy_ones = {topic: noisy(values, 0.05, seed) for seed, (topic, values) in enumerate(wrenches.items())}
    return robot, noisy_ones, noisy(robot.efforts(), 0.05, seed=7)


def messages(seconds: float = SECONDS, **changes: Change) -> list[Recorded]:
    """What is measured, changed by sensor, or at the ``joints``."""
    robot, wrenches, efforts = arm()
    times = (np.array(robot.stamps) - START * SECOND) / SECOND

    def changed(name: str, values: np.ndarray) -> np.ndarray:
        change = changes.get(name, lambda _, value: value)
        return np.array([change(*pair) for pair in zip(times, values, strict=True)])

    streams = [
        robot.wrenches("/elbow", "link2", changed("elbow", wrenches["/elbow"])),
        robot.wrenches("/wrist", "wrist_ft", changed("wrist", wrenches["/wrist"])),
        robot.joint_states(changed("joints", efforts)),
    ]
    return [item for item in in_time(*streams) if item.time < (START + seconds) * SECOND]


def biased(bias: Sequence[float], begin: float = TARED, end: float = np.inf) -> Change:
    return lambda time, value: value + np.array(bias) * (begin <= time < end)


def session(**values: Any) -> Session:
    return Session(read_urdf(URDF), Configuration({**VALUES, **values}), "arm3.urdf")


class Working:
    """A worker that judges and solves when asked, or every so many seconds."""

    def __init__(self, period: float = 3600.0, **values: Any) -> None:
        self.session = session(**values)
        self.worker = Worker(self.session, period, Listener(), Failures())

    def close(self) -> None:
        self.worker.close()

    def feed(self, items: list[Recorded]) -> Status:
        """Take messages; the status once all that can be judged is."""
        self.take(items)
        self.final()
        assert self.session.identifier.sample_count - self.worker.solver.detector.searched_until < BLOCK
        return self.status()

    def take(self, items: list[Recorded]) -> None:
        """Take messages. At any time, all rows are accounted for."""
        for begin in range(0, len(items), AT_ONCE):
            for item in items[begin : begin + AT_ONCE]:
                self.worker.enqueue([Received(*item.raw, time.perf_counter())])
            self.status()
            while self.worker._inbox.unfinished:  # what has no room is dropped
                time.sleep(2e-3)
                self.status()

    def judge(self) -> None:
        """All rows so far, in the thread that judges: another one would judge beside it."""
        self.worker.solver.request_change_search()
        judged = threading.Event()
        self.worker.solver._requests.put(judged.set)
        assert judged.wait(PATIENCE)

    def status(self) -> Status:
        status = self.worker.status(active=True)
        assert status.rows_made == status.rows + status.rows_rejected.total()
        return status

    def final(self) -> Estimate:
        """From all messages so far."""
        answer = final_estimate(self.worker)
        assert isinstance(answer, Estimate), answer
        return answer


@pytest.fixture
def working() -> Iterator[Working]:
    with closing(Working()) as working:
        yield working


def samples(items: list[Recorded]) -> Samples:
    """All that messages complete."""
    return Samples.concatenate(list(completed(session().pipeline, (item.parsed for item in items))))


def silent(of: Samples, topic: str, begin: int = 0, end: int | None = None) -> Samples:
    """As if a sensor had said nothing between two of the instants."""
    wrenches = of.wrenches.copy()
    wrenches[begin:end, SENSORS.index(topic)] = np.nan
    return replace(of, wrenches=wrenches)


def first(of: Samples, count: int) -> Samples:
    return of.select(slice(count))


def assert_same(estimate: Estimate, of: Samples, **values: Any) -> None:
    """As that of a run with these."""
    twin = session(**values).identifier
    twin.add(of)
    expected = twin.solve()
    assert estimate.rows_accepted == expected.rows_accepted
    for ours, theirs in zip(estimate.links, expected.links, strict=True):
        np.testing.assert_allclose(ours.parameters, theirs.parameters, rtol=0, atol=SAME * abs(theirs.parameters).max())


def said(status: Status) -> str:
    return str(Diagnostics("geomid").array(status).status[0].message)


def first_suspect(status: Status, *channels: str) -> int:
    """The number of the first instant of the open gaps, which are at these channels and others of the same sensors."""
    opened = [gap for gap in status.gaps if gap.since is not None]
    assert set(channels) <= {gap.channel for gap in opened}
    assert {gap.channel.split("/")[0] for gap in opened} == {channel.split("/")[0] for channel in channels}
    return min(gap.first_sample for gap in opened)


def split(items: list[Recorded], seconds: float) -> tuple[list[Recorded], list[Recorded]]:
    """What is measured before and after."""
    at = next(k for k, item in enumerate(items) if item.time >= (START + seconds) * SECOND)
    return items[:at], items[at:]


@pytest.fixture
def busy() -> Iterator[Working]:
    with closing(Working(0.02)) as working:
        yield working


def test_what_was_solved_for_from_bad_rows_is_forgotten(busy: Working, monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimate, where the next one begins, and the prior's weight."""
    items = messages(8.0, wrist=lambda _, value: -value)
    before, after = split(items, 1.5)
    busy.feed(before)
    assert not busy.worker._wrenches._check.ended
    wait_until(lambda: busy.session.warm_start is not None)
    starts: list[Any] = []
    solve = busy.session.identifier.solve
    known = busy.session.identifier

    def note(warm: Any = None) -> Estimate:
        starts.append((warm, known.counts.rejected["wrench doubtful: /wrist"]))
        return solve(warm)

    monkeypatch.setattr(known, "solve", note)
    status = busy.feed(after)
    assert status.rows_rejected["wrench doubtful: /elbow"] == 0
    first_after = next(warm for warm, doubtful in starts if doubtful)
    assert first_after is None
    assert_same(busy.final(), silent(samples(items), "/wrist"))


def test_only_the_sensor_that_changed_loses_its_rows_and_only_until_it_is_as_before(working: Working) -> None:
    """Equal to a run in which it said nothing from before it was tared until the gap had closed. What was solved for
    before that was noticed chooses neither where the next solve begins nor the prior's weight."""
    items = messages(wrist=biased([0.0, 0.0, 2.0, 0.0, 0.0, 0.0], TARED, BACK))
    of, spared = samples(items), samples(messages())
    touched = np.flatnonzero(np.any(np.abs(of.wrenches - spared.wrenches) > 1e-9, axis=(1, 2)))
    before, after = split(items, BACK)
    sound, bad = split(before, TARED)
    working.feed(sound)
    assert working.session.warm_start is not None
    noticed, bad = split(bad, TARED + 6.0)
    working.take(noticed)
    working.judge()
    assert working.worker.solver.changed_sensors == ("/wrist",)
    assert working.worker.solver._warm_start() is None
    assert working.worker.estimate is not None, "there is none better yet"
    status = working.feed(bad)
    begin = first_suspect(status, "wrist/fz") - LATE
    assert begin <= touched[0], "all that is bad is left out"
    assert status.rows_rejected["wrench changed: /wrist"] == AXES * (status.rows_made // CHANNELS - begin)
    assert "Rows of /wrist are left out until" in said(status)
    assert_same(working.final(), silent(first(of, status.rows_made // CHANNELS), "/wrist", begin))
    status = working.feed(after)
    end = begin + status.rows_rejected["wrench changed: /wrist"] // AXES
    assert touched[-1] < end <= touched[-1] + 10 * BLOCK
    assert "gap" not in said(status)
    assert not status.changed_sensors
    assert_same(working.final(), silent(of, "/wrist", begin, end))


def test_a_load_that_the_joints_feel_is_no_fault_of_the_sensor(working: Working) -> None:
    """Though they may feel it only when the sensor's rows are left out already."""
    felt = TARED + 5.0
    items = messages(
        felt + 6.0,
        wrist=biased([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]),
        joints=lambda t, efforts: efforts + 3.0 * np.sin(3.0 * t) * (t >= felt),
    )
    before, after = split(items, felt)
    assert working.feed(before).changed_sensors == ("/wrist",)
    status = working.feed(after)
    opened = {gap.channel for gap in status.gaps if gap.since is not None}
    assert {"wrist/fz", "joint1"} <= opened
    assert "Its rows are used" in said(status)
    assert not status.changed_sensors
    assert_same(working.final(), samples(items))


def test_who_forgets_in_time_takes_what_has_changed() -> None:
    """That is what was asked for; but not what was wrong from the beginning."""
    items = messages(35.0, wrist=biased([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]))
    wrong = messages(8.0, wrist=lambda _, value: -value)
    with closing(Working(forgetting_time=20.0)) as working:
        status = working.feed(items)
        first_suspect(status, "wrist/fz")
        assert "Its rows are used" in said(status)
        assert_same(working.final(), samples(items), forgetting_time=20.0)
    with closing(Working(forgetting_time=20.0)) as working:
        working.feed(wrong)
        assert_same(working.final(), silent(samples(wrong), "/wrist"), forgetting_time=20.0)
