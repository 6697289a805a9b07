"""A named number that is changed is changed everywhere, and only lines that read it are said to."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import pytest

from benchmarks.ablation.constants import Constant
from benchmarks.ablation.running import Case, Figures, baseline, changed_by
from geomid_ros.estimation import estimate
from geomid_ros.monitoring import change_detection

BLOCK = Constant("geomid_ros.monitoring.change_detection", "", "BLOCK")
SURE = Constant("geomid_ros.estimation.estimate", "", "STDS_OF_95")


@pytest.fixture
def changed() -> Iterator[tuple[int, float]]:
    """The block and the interval are three times as long."""
    usual = change_detection.BLOCK, estimate.STDS_OF_95
    for constant, value in zip((BLOCK, SURE), usual, strict=True):
        constant.change(3 * value)
    yield usual
    for constant, value in zip((BLOCK, SURE), usual, strict=True):
        constant.change(value)


def test_importers_and_computed_numbers_follow(changed: tuple[int, float]) -> None:
    block, sure = changed
    assert 3 * block == change_detection.BLOCK
    assert 6 * block == change_detection.LATE
    assert 3 * sure == estimate.STDS_OF_95 == vars(change_detection)["STDS_OF_95"]


def test_lines_that_read_it() -> None:
    text, first = inspect.getsourcelines(change_detection.ChangeDetector.test)
    lines = {line for path, line in BLOCK.lines if path == change_detection.__file__}
    reading = {first + number for number, line in enumerate(text) if "BLOCK" in line}
    assert reading <= lines
    changed, first = inspect.getsourcelines(change_detection.changed_sensors)
    assert {first + number for number, line in enumerate(changed) if "LATE" in line} <= lines, "through LATE"
    assert {path for path, _ in SURE.lines} >= {change_detection.__file__}


def test_a_case_notices_what_it_depends_on_and_nothing_else() -> None:
    def run() -> Figures:
        return {"late": float(change_detection.LATE), "verdict": "as it was"}

    case = Case("a bench", "a robot", run)
    known = {case.name: baseline(case)}
    assert changed_by(BLOCK, 3 * BLOCK.value, [case], known) == {case.name: ["late"]}
    other = Constant("geomid_ros.monitoring.change_detection", "", "_LAGS")
    assert not changed_by(other, 0, [case], known)
