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

ROOT = Path(__file__).parents[2]
INPUTS = {"messages": 20, "effects": 20}
USUAL_INPUTS = 60


@pytest.fixture(autouse=True)
def _paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """For the workers."""
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'test'}")


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


def test_what_is_broken_is_found_and_the_rest_is_tried(tmp_path: Path) -> None:
    """Also where a process dies, as by a fault in a compiled library."""
    outcome = Outcome()
    list(run("fuzz.broken:Broken", 0, 14, tmp_path, outcome))
    assert [index for index, _ in outcome.failures] == [3, 5, 7, 11]
    parts = ("KeyError", "took more than", "MemoryError", "ended with status")
    for (_, failure), part in zip(outcome.failures, parts, strict=True):
        assert part in failure
    assert outcome.counts == {"untold": 11, "died": 1, "accepted": 2}
