"""The worker's threads outlive errors, answer everybody, and agree on what was forgotten."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import pytest
from files.recordings import BAGS
from monitoring.test_payload_watch import AFTER, BEFORE, MASS, NOISE, RATE, Arm

from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.archive import decoded, encoded
from geomid_ros.files.checkpoints import Checkpoint
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live import threads
from geomid_ros.live import worker as module
from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.threads import Received
from geomid_ros.live.worker import Worker
from geomid_ros.model.measurement_model import Rows
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import BLOCK
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, AcceptedMessages, Decoder
from geomid_ros.types import IntArray

from .stage import NO_CHOICE, messages
from .waiting import PATIENCE, final_estimate, wait_until

STATES = [item for item in messages() if item.topic == "/joint_states"]
JOINTS = [item.raw for item in STATES]
SOON, NEVER = 0.01, 3600.0  # [s] periods of the solver


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine may be busy."""
    monkeypatch.setattr(module, "PATIENCE", PATIENCE)


class Watched(Listener):
    """A worker on the small arm, and what it tells."""

    def __init__(self, solve_period: float, resumed: Checkpoint | None = None, **parameters: Any) -> None:
        self.session = Session(read_urdf(BAGS / "arm3.urdf"), Configuration({**NO_CHOICE, **parameters}), "arm3.urdf")
        if resumed is not None:
            self.session.restore(resumed)
        self.estimates: queue.Queue[Estimate] = queue.Queue()
        self.samples = 0
        self.publish: Any = self.estimates.put
        self.worker = Worker(self.session, solve_period, self, Failures())

    def on_samples(self, session: Session, samples: Samples, estimate: Estimate) -> None:  # noqa: ARG002
        self.samples += len(samples)

    def on_estimate(self, session: Session, estimate: Estimate) -> None:  # noqa: ARG002
        self.publish(estimate)

    def close(self) -> None:
        self.worker.close()

    def feed(self, begin: int = 0, end: int = len(JOINTS)) -> None:
        for message in JOINTS[begin:end]:
            self.worker.enqueue([Received(*message, time.perf_counter())])

    def take(self, samples: Samples, begin: int, end: int) -> Estimate:
        """The estimate with such samples, too."""
        for first in range(begin, end, 10):
            self.worker._add(samples.select(np.arange(first, first + 10)), np.zeros(10))
        found = self.final()
        assert isinstance(found, Estimate)
        return found

    def final(self) -> Estimate | GeomidError:
        """The answer to a request for a final estimate."""
        return final_estimate(self.worker)


@pytest.fixture
def quiet() -> Iterator[Watched]:
    """Solves only when asked."""
    with closing(Watched(NEVER)) as watched:
        yield watched


@pytest.fixture
def busy() -> Iterator[Watched]:
    """Solves all the time."""
    with closing(Watched(SOON)) as watched:
        yield watched


def test_efforts_of_resting_joints_say_nothing_of_changes(quiet: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor those near a reversal: dry friction may be anything there. Those of fast joints do."""
    judged: dict[int, Any] = {}
    speeds: dict[int, Any] = {}
    add = quiet.worker.solver.detector.add

    def note(first: int, stamps: IntArray, rows: Rows) -> bool:
        judged.update(zip(stamps.tolist(), rows.targets, strict=True))
        return add(first, stamps, rows)

    monkeypatch.setattr(quiet.worker.solver.detector, "add", note)
    monkeypatch.setattr(
        quiet.session.review.check,
        "add",
        lambda samples: speeds.update(zip(samples.stamps.tolist(), abs(samples.velocity), strict=True)),
    )
    quiet.feed()
    assert isinstance(quiet.final(), Estimate)
    common = sorted(judged.keys() & speeds.keys())
    targets = np.array([judged[stamp] for stamp in common])
    speed = np.array([speeds[stamp] for stamp in common])
    slow, fast = speed < 0.005, speed > 0.8 * np.max(speed, axis=0)
    assert np.sum(slow) > 3
    assert np.all(np.isnan(targets[slow]))
    assert np.mean(np.isfinite(targets[fast])) > 0.9


def test_what_is_carried_is_neither_learned_nor_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even what came before it was noticed, and later searches do not have it. What was learned is not forgotten
    meanwhile."""
    arm, checked = Arm(), list[int]()
    measured = arm.measured(arm.loaded)
    with closing(Watched(NEVER, forgetting_time=5.0)) as watched:
        for block in measured.in_pieces():
            watched.session.recent(AcceptedMessages(JOINT_STATES, block.stamps, block.effort))
        monkeypatch.setattr(watched.session.review.check, "add", lambda part: checked.extend(part.stamps.tolist()))
        found, status = watched.take(measured, 0, len(measured)), watched.worker.status(active=True)
    assert found.sigmas == pytest.approx(NOISE, rel=0.2)
    left_out = status.rows_rejected["payload carried"] / len(watched.session.model.channels)
    assert (AFTER - BEFORE) * RATE < left_out < (AFTER - BEFORE + 4.0) * RATE
    for remembered in (watched.worker.recent_messages(), watched.worker.messages_before_gap()):
        for stamps in (checked, np.concatenate([block.stamps for block in remembered])):
            times = 1e-9 * np.array(stamps)
            assert np.min(times) < BEFORE < AFTER < np.max(times)
            assert not np.any((times > BEFORE) & (times < AFTER))


UNKNOWN = "no data that came after it have confirmed it yet"
WORSE = "the estimate before predicted later data worse than the URDF: 'joint2', 'joint3'"


def test_later_data_refute_an_estimate_or_confirm_one(quiet: Watched) -> None:
    """One from few data, spoiled here, may be worse than the URDF on those that follow: until these are known, and are
    not too few, it is doubtful. What is forgotten confirms nothing."""
    arm = Arm()
    measured = arm.measured(arm.truth)
    measured = replace(measured, effort=np.concatenate([-measured.effort[:60], measured.effort[60:]]))
    begin = 0
    for end, expected in ((60, [UNKNOWN]), (70, [UNKNOWN]), (500, [WORSE]), (1500, []), (2000, [UNKNOWN])):
        verdict = quiet.session.review.verdict(quiet.take(measured, begin, end))
        assert [reason for reason in verdict.reasons if reason in (UNKNOWN, WORSE)] == expected
        begin = end
        if not expected:
            quiet.worker.reset()


def test_what_is_carried_and_what_was_found_is_known_after_a_crash() -> None:
    arm, fault = Arm(), RecordingFault(cause=Cause(kind="sign", sentence="reversed", places=("joint1",)))
    measured, crash = arm.measured(arm.loaded), round(0.5 * (BEFORE + AFTER) * RATE)
    with closing(Watched(NEVER)) as watched:
        watched.take(measured, 0, crash)
        before = watched.worker.solver.payload
        watched.session.review.findings = (fault,)
        kept = watched.session.checkpoint()
        kept = decoded(Checkpoint, encoded(vars(kept), kept.accounts), watched.session.meaning)
    with closing(Watched(NEVER, kept)) as watched:
        after = watched.worker.solver.payload
        assert before is not None
        assert after is not None
        assert after.parameters == pytest.approx(before.parameters)
        assert (after.columns, after.since) == (before.columns, before.since)
        assert watched.worker._causes(sure=True) == ["reversed"]
        later = round(AFTER * RATE) - 100
        watched.take(measured, crash, later)
        after = watched.worker.solver.payload
        assert after is not None
        assert after.mass == pytest.approx(MASS, rel=0.05)
        assert watched.take(measured, later, len(measured)).sigmas == pytest.approx(NOISE, rel=0.2)
        assert watched.worker.solver.payload is None
        watched.worker.reset()
        wait_until(lambda: not watched.session.review.findings)


def test_what_was_picked_up_during_a_crash_is_noticed() -> None:
    """By what was known of the robot before; none of its rows is learned."""
    arm = Arm()
    measured, crash, later = arm.measured(arm.loaded), round((BEFORE - 5.0) * RATE), round((BEFORE + 1.0) * RATE)
    with closing(Watched(NEVER)) as watched:
        sound = watched.take(measured, 0, crash)
        kept = watched.session.checkpoint()
        kept = decoded(Checkpoint, encoded(vars(kept), kept.accounts), watched.session.meaning)
    with closing(Watched(NEVER, kept)) as watched:
        found = watched.take(measured, later, round(AFTER * RATE) - 50)
        payload = watched.worker.solver.payload
        assert payload is not None
        assert payload.mass == pytest.approx(MASS, rel=0.05)
        np.testing.assert_allclose(found.parameters, sound.parameters, rtol=1e-6, atol=1e-9)


def test_an_implausible_mass_is_told() -> None:
    with closing(Watched(NEVER, effort_gain=9.0)) as heavy:
        heavy.feed()
        assert isinstance(heavy.final(), Estimate)
        assert any("the total link mass is" in warning for warning in heavy.worker.status(active=True).warnings)


def test_changes_are_looked_for_as_soon_as_there_are_rows_enough(quiet: Watched) -> None:
    """Not at the end of a period: this one never ends."""
    quiet.feed()
    wait_until(
        lambda: 5 * BLOCK < quiet.session.identifier.sample_count < quiet.worker.solver.detector.searched_until + BLOCK
    )


def test_an_error_while_publishing_costs_no_thread(busy: Watched) -> None:
    def fail(_: Estimate) -> None:
        raise RuntimeError("nobody listens")

    busy.publish = fail
    busy.feed(0, 400)
    assert str(busy.final()) == "nobody listens"
    assert busy.worker.solver.problem == "no estimate: nobody listens"
    busy.publish = busy.estimates.put
    busy.feed(400)
    assert isinstance(busy.final(), Estimate)
    assert busy.worker.status(active=True).warnings == ()


Answers: TypeAlias = "queue.Queue[Estimate | GeomidError]"


@contextmanager
def solving(watched: Watched) -> Iterator[tuple[Answers, threading.Event]]:
    """In a solve of all messages: the answers to come, and an event that lets it end."""
    solve, begun, may_end = watched.session.identifier.solve, threading.Event(), threading.Event()
    answers: Answers = queue.Queue()

    def slowly(warm: Any) -> Estimate:
        estimate = solve(warm)
        begun.set()
        may_end.wait(PATIENCE)
        return estimate

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watched.session.identifier, "solve", slowly)
        watched.feed()
        watched.worker.request_estimate(answers.put)
        assert begun.wait(PATIENCE)
        yield answers, may_end


def test_what_is_forgotten_while_it_is_solved_for_stays_forgotten(quiet: Watched) -> None:
    with solving(quiet) as (answers, may_end):
        quiet.worker.reset()
        wait_until(lambda: quiet.worker.status(active=True).rows == 0)
        may_end.set()
        assert isinstance(answers.get(timeout=PATIENCE), Estimate), "who asked before has the answer"
    assert quiet.worker.estimate is None
    assert quiet.estimates.empty()


def test_what_is_forgotten_while_an_estimate_is_kept_stays_forgotten(
    quiet: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is kept and weighed against later data at once, so that nothing of it is left."""
    arm, solver = Arm(), quiet.worker.solver
    measured, forgetting = arm.measured(arm.truth), threading.Thread(target=solver.reset, daemon=True)

    def confirm(*_: object) -> None:
        forgetting.start()
        forgetting.join(0.2)

    quiet.take(measured, 0, 60)
    monkeypatch.setattr(quiet.session.review, "confirm", confirm)
    quiet.take(measured, 60, 500)
    forgetting.join(PATIENCE)
    assert (quiet.worker.estimate, solver.estimate_before(500), solver.problem) == (None, None, "")


def solved_for(watched: Watched) -> list[int]:
    """The rows of each estimate that was made since the last time."""
    return [watched.estimates.get_nowait().rows_accepted for _ in range(watched.estimates.qsize())]


def end_of_period(watched: Watched) -> int:
    """Let the solver look whether there is anything to do; returns the rows there are."""
    wait_until(lambda: not watched.worker._inbox.unfinished)
    watched.worker.solver._solve_for_new_rows()
    return watched.session.identifier.rows


def test_estimates_are_made_as_data_grow_by_a_tenth_or_cease(quiet: Watched) -> None:
    quiet.feed(0, 500)
    many = end_of_period(quiet)
    assert solved_for(quiet) == [many]
    quiet.feed(500, 520)
    assert many < end_of_period(quiet) < 1.1 * many
    assert solved_for(quiet) == []
    quiet.feed(520, 580)
    more = end_of_period(quiet)
    assert more > 1.1 * many
    assert solved_for(quiet) == [more]
    quiet.feed(580, 600)
    few = end_of_period(quiet)
    assert solved_for(quiet) == []
    assert end_of_period(quiet) == few
    assert solved_for(quiet) == [few]
    end_of_period(quiet)
    assert solved_for(quiet) == []


def test_effects_are_chosen_anew_once_half_of_what_is_remembered_is_new(
    quiet: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve, afresh = quiet.session.identifier.solve, []

    def noted(warm: Any = None) -> Estimate:
        afresh.append(warm is None or warm.effects_alone)
        return solve(warm)

    monkeypatch.setattr(quiet.session.identifier, "solve", noted)
    quiet.feed(0, 400)
    first = end_of_period(quiet)
    last = 400
    while len(afresh) < 2 or not afresh[-1]:
        last += 20
        quiet.feed(last - 20, last)
        rows = end_of_period(quiet)
        assert len(afresh) < 2 or afresh[-1] == (rows > 2 * first)
    assert afresh.count(True) == 2
    assert afresh.count(False) >= 5


def test_who_waits_when_it_closes_has_an_answer() -> None:
    watched = Watched(NEVER)
    watched.feed()
    answers: queue.Queue[Estimate | GeomidError] = queue.Queue()
    for _ in range(3):
        watched.worker.request_estimate(answers.put)
    watched.worker.close()
    assert [type(answers.get_nowait()) for _ in range(3)] == 3 * [Estimate]
    assert not watched.worker._intake.is_alive()
    assert not watched.worker.solver._thread.is_alive()


def test_closing_waits_for_no_solver_that_takes_long(quiet: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PATIENCE", 0.05)
    with solving(quiet) as (answers, may_end):
        quiet.close()
        assert quiet.worker.solver._thread.is_alive()
        may_end.set()
        assert isinstance(answers.get(timeout=PATIENCE), Estimate)
    assert quiet.worker.estimate is None
    assert quiet.estimates.empty(), "nothing is published after the end"


def test_a_recording_is_judged_before_it_is_solved(quiet: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    """A solve may take long, and nobody wants to wait for it to hear that signs are reversed."""
    done: list[str] = []
    solve = quiet.session.identifier.solve

    def solved(warm: Any) -> Estimate:
        done.append("solved")
        return solve(warm)

    monkeypatch.setattr(type(quiet.session.review.check), "due", property(lambda _: True))
    monkeypatch.setattr(quiet.session.review, "judge", lambda: done.append("judged"))
    monkeypatch.setattr(quiet.session.identifier, "solve", solved)
    quiet.feed()
    answers: queue.Queue[Estimate | GeomidError] = queue.Queue()
    quiet.worker.request_estimate(answers.put)
    assert isinstance(answers.get(timeout=PATIENCE), Estimate)
    assert done[: done.index("solved")].count("judged") > 0


def test_rows_are_counted_once_though_taking_them_fails(quiet: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some of those that were being taken are there, and some are not."""
    healthy = quiet.session.identifier.add

    def take_all_but_the_last(samples: Any, **_: Any) -> None:
        if len(samples) > 1:
            healthy(samples.select(slice(len(samples) - 1)))
        raise ZeroDivisionError

    quiet.feed(0, 200)
    quiet.final()
    monkeypatch.setattr(quiet.session.identifier, "add", take_all_but_the_last)
    quiet.feed(200)
    quiet.final()
    status = quiet.worker.status(active=True)
    assert status.rows_rejected["ZeroDivisionError"] > 0
    assert status.rows_made == status.rows + status.rows_rejected.total()


@contextmanager
def standing_still(watched: Watched) -> Iterator[None]:
    """The intake takes nothing."""
    stop, waiting = threading.Event(), threading.Event()

    def stand_still(_: Any) -> None:
        waiting.set()
        stop.wait(PATIENCE)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watched.worker.solver, "request", stand_still)
        watched.worker.request_estimate(lambda _: None)
        assert waiting.wait(PATIENCE)
    try:
        yield
    finally:
        stop.set()


def test_what_waits_is_bounded_by_number_and_bytes(quiet: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was taken out has room again."""
    monkeypatch.setattr(threads, "MOST_WAITING", 30)
    for _ in range(2):
        with standing_still(quiet):
            quiet.feed(0, 40)
        quiet.final()
    monkeypatch.setattr(threads, "MOST_WAITING_BYTES", 19 * len(JOINTS[0][1]))
    for _ in range(2):
        with standing_still(quiet):
            quiet.feed(0, 40)
        quiet.final()
    account = quiet.worker.status(active=True).accounts["joint_states"]
    assert (account.received, account.dropped) == (160, {"queue full": 2 * 10 + 2 * 20})


FAILING = {
    "message processing failed": lambda worker: worker.solver.detector,
    "a check of the recording failed": lambda worker: worker.session.review.check,
}


@pytest.mark.parametrize("failure", FAILING)
def test_what_fails_behind_a_message_costs_no_rows_and_nobody_who_asks(
    failure: str, quiet: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The messages were taken, and so are those to come. Of few instants a check waits for more, or for the next who
    asks for something: that must be done."""
    with monkeypatch.context() as patch:
        patch.setattr(FAILING[failure](quiet.worker), "add", lambda *_: 1 / 0)
        quiet.feed(0, 200)
        assert isinstance(quiet.final(), Estimate)
    quiet.feed(200, 400)
    quiet.final()
    status = quiet.worker.status(active=True)
    assert status.accounts["joint_states"].accepted == 400
    assert {*status.failures} == {f"{failure}: ZeroDivisionError: division by zero"}
    assert status.rows_made == status.rows + status.rows_rejected.total()


def test_what_is_asked_for_again_is_not_solved_again(quiet: Watched) -> None:
    """Who was told that it takes long asks again, and would wait for ever; new rows, or a reset, count."""
    quiet.feed(0, 200)
    first = quiet.final()
    solves = quiet.worker.solver.solves
    assert quiet.final() is first
    assert quiet.worker.solver.solves == solves
    quiet.feed(200, 400)
    assert quiet.final().rows_accepted > first.rows_accepted
    quiet.worker.reset()
    quiet.feed(0, 200)
    assert quiet.final() is not first


def test_the_time_from_receipt_to_row_counts_from_the_callback_on(quiet: Watched) -> None:
    """Once for every instant, with the wait before the intake takes the message."""
    begin = time.perf_counter()
    quiet.feed(0, 200)
    quiet.final()
    before = quiet.worker.status(active=True).receipt_to_row
    assert len(before) == quiet.session.identifier.rows / 3
    assert 0.0 < max(before) < time.perf_counter() - begin
    with standing_still(quiet):
        quiet.feed(200, 250)
        all_received = time.perf_counter()
        while time.perf_counter() < all_received + 0.2:
            time.sleep(0.01)
    quiet.final()
    later = quiet.worker.status(active=True).receipt_to_row[len(before) :]
    assert len(later) > 0
    assert min(later) > 0.2


def test_the_time_to_a_row_counts_from_the_message_that_completed_it(quiet: Watched) -> None:
    """Of messages that came one after the other and are taken together later instants have waited less: by as much as
    their stamps are later."""
    blocks = Decoder().blocks([("joint_states", data) for _, data in JOINTS[:200]], pytest.fail)
    pipeline = quiet.session.new_pipeline()
    pipeline.push(blocks)
    samples = pipeline.collect()
    assert samples is not None
    stamps = 1e-9 * (np.sort(np.concatenate([block.stamps for block in blocks])) - samples.stamps[0])
    now = time.perf_counter()
    quiet.worker.enqueue([Received(*raw, now + at - stamps[-1]) for raw, at in zip(JOINTS[:200], stamps, strict=True)])
    quiet.final()
    waited = quiet.worker.status(active=True).receipt_to_row
    apart = 1e-9 * np.diff(samples.stamps)
    np.testing.assert_allclose(-np.diff(waited), apart, atol=1.01 * float(np.max(np.diff(stamps))))
    assert waited[0] - waited[-1] > 0.9 * float(np.sum(apart))
    assert min(waited) < stamps[-1]
