"""The one object that node and command line drive: what it takes, what it leaves, and two threads at once."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimator import EstimatorSettings, WarmStart
from geomid_ros.estimation.identifier import NOT_MEASURED, STANDING_STILL, BufferSettings, Identifier
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.types import FloatArray

from .arms import Case, Motion, arm, samples


def content(summary: RowSummary) -> FloatArray:
    """The least-squares content, as squared errors at a few points."""
    points = np.random.default_rng(0).normal(size=(5, max(int(c.columns.max()) for c in summary.channels) + 1))
    return np.array(
        [
            [sum(np.sum((part.factor @ np.append(x[channel.columns], -1.0)) ** 2) for part in parts) for x in points]
            for channel, parts in zip(summary.groups, summary.parts(), strict=True)
        ]
    )


def still(case: Case, seconds: float, drift: float = 0.0, velocity: float = 0.0) -> Case:
    """Standing at the last pose, or drifting away from it at so many rad/s while no velocity is seen."""
    times = np.arange(round(100 * seconds))[:, None] / 100.0
    position = case.samples.position[-1] + drift * times
    zero = np.zeros_like(position)
    moving = Motion(position, zero + velocity, zero)
    return replace(case, samples=samples(moving, np.broadcast_to(case.samples.effort[-1], position.shape)))


def fed(case: Case, *more: Case, **buffer: float) -> Identifier:
    identifier = Identifier(case.model, buffer=BufferSettings(**buffer))
    for one in (case, *more):
        identifier.add(one.samples)
    return identifier


def test_standing_still_adds_nothing_and_pushes_nothing_out() -> None:
    case = arm("arm3", 0, seconds=5)
    before = fed(case)
    after = fed(case, still(case, 30.0), forgetting_time=10.0)
    assert after.counts.rejected[STANDING_STILL] >= 3 * 2999
    assert after.rows - before.rows <= 3
    without = fed(case, forgetting_time=10.0)
    np.testing.assert_allclose(content(after.snapshot()), content(without.snapshot()), rtol=0.02)


def test_one_instant_of_every_pose_is_taken_however_often_it_comes_back_in_a_row() -> None:
    case = arm("arm3", 0, seconds=1)
    poses = [still(replace(case, samples=case.samples.select(slice(0, k))), 2.0) for k in (1, 50, 100)]
    identifier = fed(poses[0], *poses[1:])
    assert identifier.rows == 3 * 3


def test_what_counts_as_still_is_configured() -> None:
    case = still(arm("arm3", 0, seconds=1), 1.0, velocity=0.01)
    assert fed(case).rows == 300
    assert fed(case, still_speed=0.02).rows == 3
    assert fed(case, still_speed=0.02, still_distance=0.0).rows == 300


def test_what_is_not_measured_is_counted_channel_by_channel() -> None:
    case = arm("arm3", 0, seconds=2)
    effort = case.samples.effort.copy()
    effort[:50, 0], effort[100:, 1] = np.nan, np.inf
    identifier = fed(case.with_efforts(effort))
    assert identifier.counts.rejected[NOT_MEASURED] == 150
    assert identifier.rows == 600 - 150


def test_reset_forgets_everything() -> None:
    case, other = arm("arm3", 0, seconds=5), arm("arm3", 1, seconds=5)
    identifier = fed(case, still(case, 1.0))
    identifier.reset()
    assert identifier.rows == 0
    assert not +identifier.counts.rejected
    identifier.add(case.with_efforts(np.full_like(case.samples.effort, np.nan)).samples)
    with pytest.raises(InputError, match="no usable rows"):
        identifier.solve()
    identifier.reset()
    identifier.add(other.samples)
    np.testing.assert_array_equal(identifier.solve().parameters, fed(other).solve().parameters)


def test_efforts_of_no_robot_are_an_error_that_says_what_to_check(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr("geomid_ros.estimation.identifier.estimate", fail)
    with pytest.raises(InputError, match="check their unit"):
        fed(arm("arm3", 0, seconds=1)).solve()


def test_adding_while_another_thread_solves_loses_nothing() -> None:
    case, forgetting_time = arm("arm3", 0, seconds=10), 10.0
    identifier = Identifier(case.model, EstimatorSettings(gamma=1e-2), BufferSettings(forgetting_time=forgetting_time))
    identifier.add(case.samples.select(slice(0, 10)))
    done, failures, solves = threading.Event(), [], []

    def solve() -> None:
        warm: WarmStart | None = None
        while not done.is_set():
            try:
                found = identifier.solve(warm)
                identifier.snapshot().rms(found.parameters)
                warm = WarmStart(found.parameters)
                solves.append(found.rows_accepted)
            except Exception as error:  # noqa: BLE001  what a thread dies of must fail the test
                failures.append(error)
                return

    solvers = [threading.Thread(target=solve) for _ in range(2)]
    for thread in solvers:
        thread.start()
    for start in range(10, len(case.samples), 15):
        identifier.add(case.samples.select(slice(start, start + 15)))
    done.set()
    for thread in solvers:
        thread.join(timeout=30.0)
        assert not thread.is_alive()
    assert failures == []
    assert solves
    quiet = Identifier(case.model, buffer=BufferSettings(forgetting_time=forgetting_time))
    quiet.add(case.samples)
    np.testing.assert_allclose(content(identifier.snapshot()), content(quiet.snapshot()), rtol=1e-10)
    assert identifier.rows == quiet.rows == 3000


@pytest.mark.parametrize(
    ("forgetting_time", "before", "not_yet", "then"), [(np.inf, 400, 600, 601), (3.0, 2000, 2099, 2103)]
)
def test_rows_are_outgrown_by_a_third(forgetting_time: float, before: int, not_yet: int, then: int) -> None:
    """Without forgetting once half as many came again; with it in a third of the forgetting time: long after the start
    the rows of a time t weigh ``t / forgetting_time`` of all when they are new."""
    case = arm("arm3", 0, seconds=25)
    identifier = fed(replace(case, samples=case.samples.select(slice(before))), forgetting_time=forgetting_time)
    chosen = identifier.rows
    identifier.add(case.samples.select(slice(before, not_yet)))
    assert not identifier.has_grown_beyond(chosen, 1.0 / 3.0)
    identifier.add(case.samples.select(slice(not_yet, then)))
    assert identifier.has_grown_beyond(chosen, 1.0 / 3.0)


def test_forgetting_follows_a_payload_that_changes() -> None:
    before, after = arm("arm3", 0, seconds=20), arm("arm3", 9, seconds=20)
    errors = []
    for forgetting_time in (np.inf, 5.0):
        identifier = fed(before, after, forgetting_time=forgetting_time)
        errors.append(float(np.sqrt(np.mean(after.error(identifier.solve().parameters) ** 2))))
    assert errors[1] < 0.15 * errors[0]


@pytest.mark.parametrize(("stride", "pause"), [(1, 0.0), (5, -50.0), (5, 3600.0)])
def test_what_is_forgotten_depends_on_the_time_in_motion_alone(stride: int, pause: float) -> None:
    """Not on the rate, nor on when another recording was made: of a pause one second counts."""
    parts = []
    for seed, start in ((0, 0.0), (1, 8.0 + pause)):
        case = arm("arm3", seed, seconds=8)
        stamps = case.samples.stamps + round(start * 1e9)
        parts.append(replace(case, samples=replace(case.samples, stamps=stamps).select(slice(None, None, stride))))
    step = 0.01 * stride
    age = 8.0 - step + min(max(0.0, step + pause), 1.0)
    first, second, both = (
        sum(part.count for channel in fed(*cases, forgetting_time=4.0).snapshot().parts() for part in channel)
        for cases in (parts[:1], parts[1:], parts)
    )
    assert both == pytest.approx(first * np.exp(-age / 4.0) + second, rel=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [{"forgetting_time": 0.0}, {"forgetting_time": -1.0}, {"forgetting_time": np.nan}, {"folds": 0}, {"block": 0}],
)
def test_a_buffer_that_cannot_work_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        BufferSettings(**wrong)
