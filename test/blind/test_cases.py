"""Cases depend on kind and seed alone, cover everything, and share no code with the workflow."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

from benchmarks.blind import case as cases
from benchmarks.blind.case import KINDS, LIBRARY, OUTSIDE, Case, draw

BENCH = Path(cases.__file__).parent


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_is_always_the_same_case(kind: str) -> None:
    for seed in (0, 7, 10_000):
        assert draw(kind, seed) == draw(kind, seed)
        assert json.dumps(draw(kind, seed).document()) == json.dumps(draw(kind, seed).document())


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


def test_the_draw_varies() -> None:
    drawn = [draw(kind, seed) for kind in KINDS for seed in range(40)]
    assert {case.simulator for case in drawn} == {"mujoco", "drake"}
    assert len({case.held_out.robot for case in drawn}) >= 3
    assert {case.held_out.wrench_frame is None for case in drawn} == {False, True}
    assert {case.held_out.noise_time > 0.0 for case in drawn} == {False, True}
    assert {case.held_out.position_step > 0.0 for case in drawn} == {False, True}
    assert {case.training[0].motion for case in drawn} == {"sines", "aperiodic", "points", "chirp"}
    shares = sum(case.simulator == "drake" for case in drawn) / len(drawn)
    assert 0.15 < shares < 0.35


def test_recordings_of_a_case_are_of_one_robot_in_different_motions() -> None:
    for seed in range(10):
        case = draw("single", seed)
        options = [*case.training, case.held_out]
        assert len({(each.robot, each.seed, each.inertia_error, str(each.hide)) for each in options}) == 1
        assert len({each.motion_seed for each in options}) == len(options)


def test_large_errors_are_three_times_the_usual() -> None:
    assert draw("large_inertia_errors", 3).held_out.inertia_error == 0.6
    assert max(draw("single", seed).held_out.inertia_error for seed in range(50)) <= 0.2


def test_the_bench_shares_no_code_with_the_workflow() -> None:
    for path in BENCH.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                room = f"{name}.".split(".")[1]
                ours = name.split(".")[0] == "geomid_ros"
                assert not ours or room in ("simulation", "errors", "types"), f"{path.name} imports {name}"
