"""Cases depend on kind and seed alone, cover everything, and share no code with the workflow."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from benchmarks.blind import case as cases
from benchmarks.blind.case import LIBRARY, OUTSIDE, Case, draw

BENCH = Path(cases.__file__).parent


def test_a_case_of_today_is_that_of_tomorrow() -> None:
    """Else figures of one seed could not be compared."""
    case = draw("single", 10_003)
    assert case.simulator == "mujoco"
    assert hidden(case) == ["effort_gain"]
    assert case.held_out.inertia_error == pytest.approx(0.19926625779033957)
    assert case.held_out.motion_speed == pytest.approx(0.42006587006692)


def hidden(case: Case) -> list[str]:
    return [request.effect for request in case.held_out.hide or ()]


def test_every_effect_has_its_turn() -> None:
    seeds = range(10_000, 10_028)
    assert {effect for seed in seeds for effect in hidden(draw("single", seed))} == set(LIBRARY)
    assert {effect for seed in seeds for effect in hidden(draw("outside", seed))} == set(OUTSIDE)
    assert all(len(set(hidden(draw("double", seed)))) == 2 for seed in seeds)
    assert not any(hidden(draw("none", seed)) for seed in seeds)


def test_the_bench_shares_no_code_with_the_workflow() -> None:
    for path in BENCH.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                room = f"{name}.".split(".")[1]
                ours = name.split(".")[0] == "geomid_ros"
                assert not ours or room in ("simulation", "errors", "types"), f"{path.name} imports {name}"
