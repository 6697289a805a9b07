"""The first inputs of each target, in processes of bounded memory; ``python -m benchmarks.fuzz`` tries many more."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.fuzz.running import Outcome, run
from benchmarks.fuzz.table import TARGETS
from benchmarks.fuzz.target import numbers
from benchmarks.fuzz.targets.messages import MessagesTarget
from benchmarks.fuzz.worker import MEMORY, SECONDS

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


@pytest.mark.parametrize("target", TARGETS)
def test_only_our_own_errors_come_out(target: str, tmp_path: Path) -> None:
    inputs = INPUTS.get(target, USUAL_INPUTS)
    outcome = outcome_of(target, inputs, tmp_path)
    assert outcome.failures == []
    assert outcome.counts.total() == inputs
    assert outcome.counts["accepted"] > 0.02 * inputs, "inputs so wrong that nothing but the beginning is tried"
    assert outcome.counts["refused"] > 0.2 * inputs or target == "messages"
    assert outcome.slowest[0] < SECONDS
    assert outcome.memory < MEMORY


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> MessagesTarget:
    return MessagesTarget(tmp_path_factory.mktemp("messages"))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(random=st.randoms(use_true_random=False))
def test_the_ledger_balances(random: Random, messages: MessagesTarget) -> None:
    """The same sequences, found by hypothesis, which finds the shortest one that fails."""
    messages.attempt(random)


def test_what_is_broken_is_found(tmp_path: Path) -> None:
    outcome = outcome_of("fuzz.broken:Broken", 12, tmp_path)
    assert [index for index, _ in outcome.failures] == [3, 5, 7]
    for (_, failure), part in zip(outcome.failures, ("KeyError", "took more than", "MemoryError"), strict=True):
        assert part in failure
    assert outcome.counts == {"accepted": 8, "refused": 1, "failed": 3}


def test_a_process_that_dies_is_found_and_the_rest_is_tried(tmp_path: Path) -> None:
    dying = [index for index in range(6) if numbers("fuzz.broken:Dying", index).random() < 0.5]
    outcome = outcome_of("fuzz.broken:Dying", 6, tmp_path)
    assert [index for index, _ in outcome.failures] == dying
    assert 0 < len(dying) < 6
    assert outcome.counts.total() == 6


def test_an_input_is_always_the_same() -> None:
    """Else nothing that was found could be tried again."""
    assert numbers("urdf", 7).random() == numbers("urdf", 7).random() != numbers("urdf", 8).random()
