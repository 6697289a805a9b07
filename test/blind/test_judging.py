"""Counting right and wrong: made-up findings against made-up truths."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.blind.figures import figures
from benchmarks.blind.judging import Judgement, judge, parameter_errors

SPRING = {"effect": "spring", "joint": "joint2", "parameters": {"stiffness": 20.0, "equilibrium": 0.3}}
CABLE = {"effect": "cable_force", "joint": "joint2", "other": "joint3", "parameters": {"stiffness": 4.0}}


def finding(effect: str, joint: str, confidence: str = "confident", **values: float) -> dict[str, Any]:
    parameters = {name: {"value": value, "std": 0.1, "unit": ""} for name, value in values.items()}
    return {
        "effect": effect,
        "joint": joint,
        "probability": 0.9,
        "confidence": confidence,
        "rivals": [],
        "parameters": parameters,
    }


def document(
    *truth: dict[str, Any],
    findings: tuple[dict[str, Any], ...] = (),
    unexplained: tuple[str, ...] = (),
    kind: str = "single",
    inertias_only: float = 3.0,
) -> dict[str, Any]:
    gaps = {
        "before": {"joint1": 9.0},
        "inertias_only": {"joint1": inertias_only, "joint2": None},
        "after": {"joint1": 1.0},
    }
    verdict = "named" if findings else ("unexplained" if unexplained else "no gap")
    return {
        "case": {
            "kind": kind,
            "seed": 1,
            "simulator": "mujoco",
            "training": [{"motion": "sines"}],
            "held_out": {"robot": "arm7", "wrench_frame": None, "noise_time": 0.0},
        },
        "truth": {"effects": list(truth)},
        "gap": {
            "verdict": verdict,
            "findings": list(findings),
            "unexplained": [{"joint": joint, "depends_on": "position", "gap": 2.0} for joint in unexplained],
            "gap": gaps,
            "resimulated": None,
        },
        "seconds": 5.0,
        "processor_seconds": 4.0,
    }


def test_wrong_names_and_wrong_joints_are_wrong() -> None:
    for named in (("spring", "joint3"), ("effort_offset", "joint2")):
        case = judge(document(SPRING, findings=(finding(*named),)))
        assert (case.right, case.listed, case.wrong) == ((), (), (named,))
        assert judge(document(SPRING, findings=(finding(*named, "tentative"),))).wrong == ()


def test_outside_is_flagged_on_its_joint() -> None:
    for joint, flagged in (("joint2", True), ("joint3", True), ("joint1", False)):
        assert judge(document(CABLE, unexplained=(joint,), kind="outside")).flagged is flagged


@pytest.mark.parametrize(
    ("effect", "true", "found", "error"),
    [
        ("gravity_tilt", {"tilt_x": 0.01, "tilt_y": 0.0}, {"tilt_x": 0.01, "tilt_y": 0.002}, np.degrees(0.002)),
        ("effort_delay", {"delay": -0.004}, {"delay": -0.0045}, 0.5),
        ("effort_gain", {"gain": 1.1}, {"gain": 1.045}, 5.0),
        ("payload", {"mass": 2.0, "com_x": 0.1}, {"mass": 1.9, "com_x": 9.9}, 5.0),
    ],
)
def test_errors_of_parameters(effect: str, true: dict[str, float], found: dict[str, float], error: float) -> None:
    assert dict(parameter_errors(effect, true, found)) == {effect: pytest.approx(error)}


def value(cases: list[Judgement], what: str) -> float:
    (line,) = (line for line in figures(cases) if line.what == what)
    return line.value


def test_shares_are_of_the_visible() -> None:
    right = document(SPRING, findings=(finding("spring", "joint2", stiffness=20.0),))
    missed, invisible = document(SPRING), document(SPRING, inertias_only=1.1)
    cases = [judge(each) for each in (right, right, right, missed, invisible)]
    assert value(cases, "effect and joint right and confident, single, visible") == 75.0
    assert value(cases, "not visible (gap below 1.15 x floor), single") == 20.0
    named = document(kind="none", findings=(finding("spring", "joint1", "tentative"),))
    none = [judge(document(kind="none")), judge(named)]
    assert value(none, "named anything, no effect") == 50.0
