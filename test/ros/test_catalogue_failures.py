"""The catalogue's faults of the node's own parts: solver, threads, disk, services. They are planted (``faulty.py``)."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from files.recordings import Recorded

from geomid_ros.estimation.identifier import Identifier
from geomid_ros.signals.pipeline import SignalPipeline

from .direct import Direct
from .faulty import VARIABLE, fail, not_a_number, of_wrenches, slowly, unconverged
from .observer import LATE
from .processes import SOON
from .rig import ERROR, GOOD, WARN, Rig, Twin, rigged
from .spoiling import later

SECOND = 1_000_000_000
WRITTEN = {"estimate.json", "identified.urdf", "posterior.npz"}


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


def begun_directly(direct: Direct) -> tuple[list[Recorded], int]:
    """The same without processes."""
    before, after = direct.begin()
    direct.feed(before)
    direct.published()
    direct.settled(len(direct.arrays))
    return after, len(direct.arrays)


SOLVER = {
    "49-not-converged": (unconverged, WARN, "no new estimate: planted: no step helps"),
    "49-not-a-number": (not_a_number, WARN, "no estimate: the solver's result is not finite"),
    "49-solver-fails": (fail, ERROR, "the solver failed: ZeroDivisionError: planted"),
    "50-solver-over-its-time": (slowly, WARN, "solving takes"),
}


@pytest.mark.parametrize("name", SOLVER)
def test_a_solver_that_fails_keeps_the_last_estimate(
    name: str, direct: Direct, monkeypatch: pytest.MonkeyPatch
) -> None:
    act, level, says = SOLVER[name]
    after, begin = begun_directly(direct)
    last, identifier = direct.worker.estimate, direct.session.identifier
    with monkeypatch.context() as patch:
        patch.setattr(identifier, "solve", partial(act, identifier.solve))
        direct.feed(after)
        direct.says(begin, level, says)
        assert direct.worker.estimate is last
        direct.settled(begin)
    direct.assert_same_as_twin()


MESSAGES: dict[str, tuple[Any, str, Any, str, str, str]] = {
    "52-worker": (
        SignalPipeline,
        "_use",
        of_wrenches(fail),
        "/wrench dropped: ZeroDivisionError while taking a message",
        "a message on /wrench could not be processed: ZeroDivisionError: planted",
        "/wrench",
    ),
    "52-rows": (
        Identifier,
        "add",
        fail,
        "rows rejected: ZeroDivisionError",
        "rows could not be computed: ZeroDivisionError: planted",
        "",
    ),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_an_exception_costs_the_messages_it_meets(name: str, direct: Direct, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or their rows, where the messages were accepted."""
    owner, method, act, counted, says, topic = MESSAGES[name]
    after, begin = begun_directly(direct)
    bad = [item for item in after[:100] if item.topic.startswith(topic)]
    before = direct.settled(begin - 1).get(counted, "0")
    with monkeypatch.context() as patch:
        healthy = getattr(owner, method)
        patch.setattr(owner, method, lambda *of: act(healthy, *of))
        direct.send(bad)
        values = direct.settled(len(direct.arrays))
        direct.says(begin, ERROR, says)
        assert int(values[counted]) - int(before) >= (len(bad) if topic else 1)
    if not topic:
        direct.twin.samples(bad)  # the twin loses the same rows
    direct.feed([item for item in after if item not in bad])
    direct.assert_same_as_twin()


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


def without_trace(values: dict[str, str]) -> dict[str, str]:
    """How many messages have not been taken so far."""
    return {key: value for key, value in values.items() if key.endswith(("dropped: queue full", " lost"))}


def test_96_a_burst_of_thousands_after_silence_is_taken(faulty: Faulty) -> None:
    """By a machine that needs four seconds for what comes in one: more than a subscription holds."""
    rig = faulty.rig
    _, after, begin, _ = begun(rig)
    missing = without_trace(rig.settled(begin - 1))
    rig.stage.observer.spin(2.0)
    whole = rig.shifted(GOOD)
    again = [later(item, seconds * SECOND) for seconds in (10, 20) for item in whole]
    burst = [*after, *again[:1200]]
    with faulty.has("machine slow"):
        for begins in range(0, len(burst), 750):
            rig.send(burst[begins : begins + 750], pause=0.0)
            rig.stage.observer.spin(0.5)
        rig.twin.feed(burst)
        values = rig.settled(begin)
    assert without_trace(values) == missing
    rig.assert_same_as_twin()


def test_53_a_solver_that_hangs_is_replaced(faulty: Faulty) -> None:
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    with faulty.has("solver computes for ever"):
        rig.feed(after)
        rig.says(begin, None, "solving takes")  # a warning, until there is an error
        rig.says(begin, ERROR, "the solver hung and was restarted")
        assert len(rig.inertias) == heard
    rig.stage.observer.wait_for(lambda: len(rig.inertias) > heard, "estimates of a solver that does not hang")
    rig.assert_same_as_twin()
    assert rig.node.running


# The service that is asked while the node has the fault, whether it succeeds, what it answers, and what is said.
SERVICES = {
    "64-disk-full": ("disk full", "save", False, "No space left on device", "the estimate could not be saved"),
    "65-read-only": ("disk read-only", "save", False, "Read-only file system", "the estimate could not be saved"),
    "66-unwritable": ("saving fails", "save", False, "planted", "the estimate could not be saved"),
    "67-disk-slow": ("disk slow", "save", False, "saving has not ended after 4.8 s", "saving into"),
    "69-service-fails": ("service fails", "find_gap", False, "ZeroDivisionError: planted", "~/find_gap failed: Zero"),
    "101-solver-busy": ("solver waits", "save", True, LATE, ""),
}


def test_what_fails_is_answered_and_stops_nothing(faulty: Faulty) -> None:
    """One fault after the other, in all of which messages come; first one in a callback, which costs the messages."""
    rig = faulty.rig
    _, after, begin, heard = begun(rig)
    bad = [item for item in after[:40] if item.topic == "/wrench"]
    with faulty.has("callback fails"):
        rig.send(bad)
        values = rig.settled(len(rig.arrays))
        rig.says(begin, ERROR, "a message on /wrench could not be processed: ZeroDivisionError: planted")
        assert values["/wrench dropped: ZeroDivisionError in a callback"] == str(len(bad))
        assert len(rig.inertias) == heard
    rig.feed([item for item in after[:60] if item not in bad])
    for place, (fault, service, succeeds, answer, says) in enumerate(SERVICES.values()):
        begin, heard, written = len(rig.arrays), len(rig.inertias), (rig.out / "estimate.json").read_text()
        with faulty.has(fault):
            asked = rig.ask(service)
            rig.feed(after[60 + 40 * place : 100 + 40 * place])
            rig.stage.observer.wait_for(asked.done, "the answer")
            assert asked.result().success == succeeds
            assert answer in asked.result().message
            rig.says(begin, ERROR if says else None, says)
            if "could not be saved" in says:
                assert (rig.out / "estimate.json").read_text() == written, "what was saved before is kept"
                assert {path.name for path in rig.out.iterdir()} == WRITTEN
        rig.stage.observer.wait_for(lambda heard=heard: len(rig.inertias) > heard, "estimates that go on")
        rig.settled(begin)
    assert rig.node.running
    rig.assert_same_as_twin()


def test_53_an_intake_that_hangs_is_replaced_so_many_times(faulty: Faulty) -> None:
    """Every time the rows are lost; the messages that waited are accounted for. Then somebody is to look: ~/reset."""
    rig = faulty.rig
    _, _, begin, _ = begun(rig)
    with faulty.has("intake hangs"):
        for attempt, reason in enumerate(("hung and was restarted, 1 of at most 1", "hangs again after 1 restarts")):
            rig.send(rig.shifted(later(item, (5 + 3 * attempt) * SECOND) for item in GOOD[300:600]))
            rig.says(begin, ERROR, f"message processing {reason}")
    assert rig.node.running
    again = len(rig.arrays)
    assert rig.trigger("reset")[0]
    rig.says(again, ERROR, "1 of at most 1 times")
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
