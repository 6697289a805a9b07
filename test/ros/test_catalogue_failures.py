"""The catalogue's faults of the node's own parts: solver, threads, disk, services. They are planted (``faulty.py``)."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from files.recordings import Recorded

from .direct import Direct
from .faulty import VARIABLE
from .observer import LATE
from .processes import SOON
from .rig import ERROR, GOOD, WARN, Rig, Twin, rigged
from .spoiling import later

SECOND = 1_000_000_000


class Faulty:
    """A rig whose node has one fault after the other."""

    def __init__(self, rig: Rig, switch: Path) -> None:
        self.rig = rig
        self._switch = switch

    @contextmanager
    def has(self, fault: str) -> Iterator[None]:
        """While the node has this fault."""
        self._switch.write_text(fault)
        try:
            yield
        finally:
            self._switch.write_text("")


@contextmanager
def planted(folder: Path, **parameters: Any) -> Iterator[Faulty]:
    """A node whose faults are to be chosen."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, str(folder / "fault"))
        patch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]))
        with rigged(folder, "ros.faulty", **parameters) as rig:
            yield Faulty(rig, folder / "fault")


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Faulty]:
    with planted(tmp_path_factory.mktemp("faulty")) as faulty:
        yield faulty


def begun(rig: Rig) -> tuple[list[Recorded], list[Recorded], int, int]:
    """A case in which half of the messages have come; those that are left, and how much was told and published."""
    before, after = rig.begin()
    rig.feed(before)
    rig.published()
    rig.settled(len(rig.arrays))
    return before, after, len(rig.arrays), len(rig.inertias)


SOLVER = {
    "49-not-converged": ("not converged", WARN, "no new estimate: planted: no step helps"),
    "49-not-a-number": ("not a number", WARN, "no estimate: the solver's result is not finite"),
    "49-solver-fails": ("solver fails", ERROR, "the solver failed: ZeroDivisionError: planted"),
    "50-solver-over-its-time": ("solver slow", WARN, "solving takes"),
}


@pytest.mark.parametrize("name", SOLVER)
def test_a_solver_that_fails_keeps_the_last_estimate(name: str, faulty: Faulty) -> None:
    fault, level, says = SOLVER[name]
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    with faulty.has(fault):
        rig.feed(after)
        rig.says(begin, level, says)
        assert len(rig.inertias) == heard
        rig.settled(begin)
    assert rig.node.running
    rig.assert_same_as_twin()


def test_47_standing_still(direct: Direct) -> None:
    """The arm stops where it is; the first link only ever turns about its vertical axis, and shows nothing else."""
    before, _ = direct.begin()
    direct.feed(before)
    direct.published()
    begin = len(direct.arrays)
    last = before[-2:]
    still = [
        later(item.changed(velocity=0.0 * item.message.velocity) if k % 2 == 0 else item, (1 + k // 2) * 10_000_000)
        for k in range(400)
        for item in [next(m for m in last if m.topic == ("/joint_states", "/wrench")[k % 2])]
    ]
    direct.feed(still[:260])
    direct.settled(begin)  # 1.3 s: the filter, 0.56 s long on either side, has forgotten the motion
    direct.feed(still[260:])
    values = direct.settled(len(direct.arrays))
    assert int(values["rows rejected: standing still"]) > 100
    assert "standing still" not in direct.stream(direct.arrays[-1]).message, "a robot that is known may rest"
    direct.assert_same_as_twin()


def test_31_what_does_not_fit_into_the_queue_is_dropped(faulty: Faulty) -> None:
    """Every wrench ten times, and the last one until it has no room: of those that fit one each is as good as ever."""
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    wrenches = [item for item in after if item.topic == "/wrench"][:20]
    rig.twin.feed(wrenches)
    sent = 0

    def dropped() -> bool:
        nonlocal sent
        rig.send(wrenches[-1:])
        sent += 1
        assert sent < 5000, "there is room for as many"
        status = rig.stream(rig.arrays[-1])
        return "/wrench dropped: queue full" in {pair.key for pair in status.values}

    with faulty.has("intake stands still"):
        rig.send([item for item in wrenches for _ in range(10)], pause=0.0)
        rig.stage.observer.wait_for(dropped, "messages that are dropped")
        rig.says(begin, None, "/wrench dropped: queue full")  # with the standstill, an error
        assert len(rig.inertias) == heard
    assert 0 < int(rig.settled(len(rig.arrays))["/wrench dropped: queue full"]) <= sent
    rig.feed([item for item in after if item not in wrenches])
    rig.assert_same_as_twin()


def without_trace(values: dict[str, str]) -> dict[str, str]:
    """How many messages have not been taken so far."""
    return {key: value for key, value in values.items() if key.endswith(("dropped: queue full", " lost"))}


def test_96_a_burst_of_thousands_after_silence_is_taken(faulty: Faulty) -> None:
    """By a machine that needs nine seconds for what comes in two."""
    rig = faulty.rig
    _, after, begin, _ = begun(rig)
    missing = without_trace(rig.settled(begin - 1))
    rig.stage.observer.spin(2.0)
    whole = rig.shifted(GOOD)
    again = [later(item, seconds * SECOND) for seconds in (10, 20) for item in whole]
    burst = [*after, *again[:2700]]
    assert len(burst) == 3000
    with faulty.has("machine slow"):
        for begins in range(0, len(burst), 750):
            rig.send(burst[begins : begins + 750], pause=0.0)
            rig.stage.observer.spin(0.5)
        rig.twin.feed(burst)
        values = rig.settled(begin)
    assert without_trace(values) == missing
    rig.assert_same_as_twin()


FAILURES = {
    "51-callback": (
        "callback fails",
        "/wrench dropped: ZeroDivisionError in a callback",
        "a message on /wrench could not be processed: ZeroDivisionError: planted",
    ),
    "52-worker": (
        "messages fail",
        "/wrench dropped: ZeroDivisionError while taking a message",
        "a message on /wrench could not be processed: ZeroDivisionError: planted",
    ),
}


@pytest.mark.parametrize("name", FAILURES)
def test_an_exception_costs_the_messages_it_meets(name: str, faulty: Faulty) -> None:
    fault, dropped, says = FAILURES[name]
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    bad = [item for item in after[:40] if item.topic == "/wrench"]
    before = rig.settled(begin).get(dropped, "0")
    with faulty.has(fault):
        rig.send(bad)
        values = rig.settled(len(rig.arrays))
        rig.says(begin, ERROR, says)
        assert int(values[dropped]) - int(before) == len(bad)
        assert len(rig.inertias) == heard
    rig.feed([item for item in after if item not in bad])
    rig.assert_same_as_twin()


def test_52_rows_that_cannot_be_made_are_counted(faulty: Faulty) -> None:
    """The messages were accepted, their rows are lost."""
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    with faulty.has("rows fail"):
        rig.send(after[:100])
        values = rig.settled(len(rig.arrays))
        rig.says(begin, ERROR, "rows could not be computed: ZeroDivisionError: planted")
        assert int(values["rows rejected: ZeroDivisionError"]) > 0
        assert len(rig.inertias) == heard
    rig.twin.samples(after[:100])  # the twin loses the same rows
    rig.feed(after[100:])
    rig.assert_same_as_twin()


@pytest.mark.parametrize("fault", ["solver hangs", "solver computes for ever"])
def test_53_a_solver_that_hangs_is_replaced(fault: str, faulty: Faulty) -> None:
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    with faulty.has(fault):
        rig.feed(after)
        rig.says(begin, WARN, "solving takes")
        rig.says(begin, ERROR, "the solver hung and was restarted")
        assert len(rig.inertias) == heard
    rig.stage.observer.wait_for(lambda: len(rig.inertias) > heard, "estimates of a solver that does not hang")
    rig.assert_same_as_twin()
    assert rig.node.running


DISK = {
    "64-disk-full": ("disk full", "No space left on device"),
    "65-read-only": ("disk read-only", "Read-only file system"),
    "66-unwritable": ("saving fails", "planted"),
}


@pytest.mark.parametrize("name", DISK)
def test_a_disk_that_cannot_be_written_stops_nothing(name: str, faulty: Faulty) -> None:
    fault, says = DISK[name]
    rig = faulty.rig
    _, after, begin, _ = begun(rig)
    written = (rig.out / "estimate.json").read_text()
    with faulty.has(fault):
        success, message = rig.trigger("save")
        assert not success
        assert says in message
        rig.says(begin, ERROR, "the estimate could not be saved", says)
        assert (rig.out / "estimate.json").read_text() == written, "what was saved before is kept"
        assert {path.name for path in rig.out.iterdir()} == {"estimate.json", "identified.urdf", "posterior.npz"}
        middle = len(after) // 2
        for part in (after[:middle], after[middle:]):
            heard = len(rig.inertias)
            rig.feed(part)
            rig.stage.observer.wait_for(lambda: len(rig.inertias) > heard, "estimates that go on")  # noqa: B023
    rig.assert_same_as_twin()
    rig.settled(begin)


def test_67_a_slow_disk_keeps_nobody_waiting(faulty: Faulty) -> None:
    rig = faulty.rig
    _, after, begin, _ = begun(rig)
    with faulty.has("disk slow"):
        answer = rig.ask("save")
        rig.feed(after)
        rig.says(begin, ERROR, f"saving into {rig.out} takes")
        rig.settled(begin)
        rig.stage.observer.wait_for(answer.done, "the answer")
    assert (answer.result().success, answer.result().message) == (False, "saving has not ended after 4.8 s")
    rig.assert_same_as_twin()


def test_101_saving_under_load_is_answered(faulty: Faulty) -> None:
    """With the last estimate, while no solve comes to its end."""
    rig = faulty.rig
    _, after, _, _ = begun(rig)
    with faulty.has("solver waits"):
        rig.feed(after)
        success, message = rig.trigger("save")
        assert success, message
        assert LATE in message
    rig.assert_same_as_twin()


def test_69_an_exception_in_a_service_is_answered(faulty: Faulty) -> None:
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    with faulty.has("service fails"):
        assert rig.trigger("find_gap") == (False, "ZeroDivisionError: planted")
    rig.says(begin, ERROR, "~/find_gap failed: ZeroDivisionError: planted")
    assert len(rig.inertias) == heard
    rig.feed(after)
    rig.settled(begin)
    rig.assert_same_as_twin()


def test_53_an_intake_that_hangs_is_replaced_three_times(faulty: Faulty) -> None:
    """Every time the rows are lost; the messages that waited are accounted for. Then somebody is to look: ~/reset."""
    rig = faulty.rig
    _, _, begin, _ = begun(rig)
    with faulty.has("intake hangs"):
        for attempt, reason in enumerate(
            [
                *(f"message processing hung and was restarted, {k} of at most 3 times" for k in (1, 2, 3)),
                "message processing hangs again after 3 restarts; no restart until ~/reset",
            ]
        ):
            rig.send(rig.shifted(later(item, (5 + 3 * attempt) * SECOND) for item in GOOD[300:600]))
            rig.says(begin, ERROR, reason)
    assert rig.node.running
    again = len(rig.arrays)
    assert rig.trigger("reset")[0]
    rig.says(again, ERROR, "1 of at most 3 times")
    rig.twin = Twin()
    _, _, begin, _ = begun(rig)
    rig.settled(begin)


def test_54_a_shutdown_from_a_callback_ends_the_node_well(faulty: Faulty) -> None:
    """Last, as it ends."""
    rig = faulty.rig
    _, after, _, _ = begun(rig)
    (rig.out / "estimate.json").unlink()
    with faulty.has("callback shuts down"):
        rig.send(item for item in after[:4] if item.topic == "/wrench")
        assert rig.node.seconds_to_end() <= SOON
        assert rig.node.status() == 0, rig.node.output
    saved = json.loads((rig.out / "estimate.json").read_text())
    assert saved["rows"]["accepted"] == rig.twin.session.identifier.rows


def test_57_a_node_ends_though_all_its_threads_hang(tmp_path: Path) -> None:
    """A disk that answers nothing, a solver that never comes back."""
    with planted(tmp_path, **{"checkpoint.folder": str(tmp_path / "checkpoints"), "checkpoint.period": 1.0}) as faulty:
        rig = faulty.rig
        _, after, begin, _ = begun(rig)
        with faulty.has("everything hangs"):
            rig.feed(after)
            rig.says(begin, WARN, "solving takes")
            assert rig.node.seconds_to_end(signal.SIGTERM) <= SOON
        assert rig.node.status() == 0, rig.node.output
        assert re.search(r"\[ERROR\].* the last estimate may not be saved: saving has not ended after", rig.node.output)
