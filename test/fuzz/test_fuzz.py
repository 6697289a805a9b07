"""The first inputs of each target, and workers that bound them; ``python -m benchmarks.fuzz`` tries many more."""

from __future__ import annotations

import resource
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.fuzz import worker
from benchmarks.fuzz.running import Outcome, run
from benchmarks.fuzz.table import TARGETS, made
from benchmarks.fuzz.target import numbers

ROOT = Path(__file__).parents[2]
INPUTS = {"messages": 20, "effects": 20}
USUAL_INPUTS = 60


@pytest.fixture(autouse=True)
def _paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """For the workers."""
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'test'}")


def outcome_of(target: str, inputs: int, folder: Path) -> Outcome:
    outcome = Outcome()
    for _ in run(target, 0, inputs, folder, outcome):
        pass
    return outcome


@pytest.fixture
def bounded() -> Iterator[None]:
    """With a worker's limits on the time and the memory of an input."""
    limits, size = resource.getrlimit(resource.RLIMIT_AS), worker._memory("VmSize") + worker.MEMORY
    before = signal.signal(signal.SIGPROF, worker._stop)
    resource.setrlimit(resource.RLIMIT_AS, (size, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)
    signal.signal(signal.SIGPROF, before)


@pytest.mark.usefixtures("bounded")
@pytest.mark.parametrize("name", TARGETS)
def test_only_our_own_errors_come_out(name: str, tmp_path: Path) -> None:
    """In this process: those of workers would import what is here already."""
    target, inputs = made(name, tmp_path), INPUTS.get(name, USUAL_INPUTS)
    tried = [worker._try(target, name, index) for index in range(inputs)]
    counts = Counter(result for result, _ in tried)
    assert counts.keys() <= {"accepted", "refused"}
    assert counts["accepted"] > 0.02 * inputs, "inputs so wrong that nothing but the beginning is tried"
    assert counts["refused"] > 0.2 * inputs or name == "messages"


def test_what_is_broken_is_found(tmp_path: Path) -> None:
    outcome = outcome_of("fuzz.broken:Broken", 12, tmp_path)
    assert [index for index, _ in outcome.failures] == [3, 5, 7]
    for (_, failure), part in zip(outcome.failures, ("KeyError", "took more than", "MemoryError"), strict=True):
        assert part in failure
    assert outcome.counts == {"accepted": 8, "refused": 1, "failed": 3}


def test_a_process_that_dies_is_found_and_the_rest_is_tried(tmp_path: Path) -> None:
    """An input is always the same: else nothing that was found could be tried again."""
    dying = [index for index in range(6) if numbers("fuzz.broken:Dying", index).random() < 0.5]
    outcome = outcome_of("fuzz.broken:Dying", 6, tmp_path)
    assert [index for index, _ in outcome.failures] == dying
    assert 0 < len(dying) < 6
    assert outcome.counts.total() == 6
