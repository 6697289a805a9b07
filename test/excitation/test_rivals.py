"""Motions that decide: differences by brute force, and rivals that a decided motion tells apart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.excitation.belief import ROWS_PER_SECOND
from geomid_ros.excitation.rivals import discriminating_motion, responses
from geomid_ros.excitation.search import Search, random_motion
from geomid_ros.model.effects import AtJoint, OnRobot, effect_class
from geomid_ros.model.samples import samples_of
from geomid_ros.session.excitation import rival_effects
from geomid_ros.session.options import MotionOptions

from .arm import small_task
from .test_knowledge import WALLS

TASK = small_task()


def finding(effect: str, joint: str, rivals: list[tuple[str, str]], **values: float) -> dict[str, Any]:
    forms = {form.name: form.units[0] for form in effect_class(effect).parameters}
    parameters = {name: {"value": value, "std": 0.1, "unit": forms[name]} for name, value in values.items()}
    named = [{"effect": name, "joint": place, "loss": 1.0} for name, place in rivals]
    return {"effect": effect, "joint": joint, "parameters": parameters, "rivals": named, "confidence": "ambiguous"}


def written(folder: Path, *findings: dict[str, Any], **more: Any) -> Path:
    path = folder / "gap.json"
    path.write_text(json.dumps({"format": 1, "findings": list(findings), "floor": {}} | more))
    return path


ROTOR = finding("rotor_inertia", "j3", [("payload", "j3")], inertia=0.05)
SPRING = finding("spring", "j2", [("effort_offset", "j2")], stiffness=2.0, equilibrium=0.5)
ELASTIC = finding("joint_elasticity", "j2", [("effort_delay", "")], stiffness=300.0)


def test_a_deciding_motion_tells_more_than_random_ones(tmp_path: Path) -> None:
    judge = rival_effects(TASK.feasibility, written(tmp_path, ROTOR))
    random = np.random.default_rng(1)
    motion = discriminating_motion(TASK.feasibility, TASK.form, judge, random)
    assert TASK.feasibility.keeps_limits(motion)
    for _ in range(6):
        other = TASK.feasibility.shrunk_to_feasible(random_motion(TASK.feasibility, TASK.form, random))
        assert judge.smallest_difference(motion) > judge.smallest_difference(other)


def test_what_a_deciding_motion_shows_is_not_lost_in_making_it_feasible(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a shaft the best motion collides; bending it, which does not look at rivals, may leave nothing of it."""
    task = small_task(MotionOptions(duration=3.0, repeats=1, avoid=WALLS))
    judge = rival_effects(task.feasibility, written(tmp_path, ELASTIC))
    monkeypatch.setattr(Search, "improved", lambda _, motion: motion.scaled(0.0))
    motion = discriminating_motion(task.feasibility, task.form, judge, np.random.default_rng(1))
    assert task.feasibility.keeps_limits(motion)
    assert judge.smallest_difference(motion) > judge.smallest_difference(motion.scaled(0.0)) + 0.1


def test_the_difference_is_what_the_rival_cannot_explain(tmp_path: Path) -> None:
    """A spring, by least squares with an offset and inertias within their prior: the residual that is left."""
    judge = rival_effects(TASK.feasibility, written(tmp_path, SPRING))
    motion = random_motion(TASK.feasibility, TASK.form, np.random.default_rng(2))
    judge.prepare(motion.scaled(0.5))
    ((difference,),) = judge.differences(motion)
    count = 120
    states = motion.at((np.arange(count) + 0.5) * 6.0 / count)[:3]
    model = TASK.belief.model.without_effects()
    sigmas = TASK.belief.sigmas
    posterior = TASK.belief.posterior
    rows = np.concatenate(
        [
            model.rows(samples_of(states)).coefficients[:, :, 10 * k : 10 * k + 10] @ posterior.point.links_jacobian[k]
            for k in range(len(posterior.links))
        ],
        axis=2,
    )
    offset = np.zeros((count, 3, 1))
    offset[:, 1] = 1.0
    target = np.zeros((count, 3))
    target[:, 1] = 2.0 * (states[0][:, 1] - 0.5)
    weight = np.sqrt(ROWS_PER_SECOND * 6.0 / count) / sigmas
    stacked = (np.concatenate([rows, offset], axis=2) * weight[:, None]).reshape(3 * count, -1)
    prior = np.zeros((rows.shape[2], stacked.shape[1]))
    prior[:, :-1] = np.eye(rows.shape[2]) / 0.2
    both = np.concatenate([stacked, prior])
    wanted = np.concatenate([(target * weight).ravel(), np.zeros(len(prior))])
    left = wanted - both @ np.linalg.lstsq(both, wanted, rcond=None)[0]
    # The spring has one parameter more.
    assert np.isclose(difference, left @ left - np.log(ROWS_PER_SECOND * 6.0 * 3), rtol=1e-6)


def test_columns_of_effects_that_depend_on_the_load() -> None:
    """A delay and an elastic gear, by differences of the efforts of shifted motions."""
    model = TASK.belief.model.without_effects()
    inertias = np.array([body.parameters for body in model.robot.bodies])
    motion = random_motion(TASK.feasibility, TASK.form, np.random.default_rng(3))
    period = 0.005
    times = np.arange(1.0, 4.0, period)

    def efforts(instants: np.ndarray) -> np.ndarray:
        return np.asarray(model.rows(samples_of(motion.at(instants)[:3])).coefficients @ inertias.ravel())

    pairs = [(effect_class("effort_delay")(), OnRobot()), (effect_class("joint_elasticity")(), AtJoint(1))]
    delay, elastic = responses(model, motion.at(times)[:3], period, pairs)
    late = (efforts(times - 1e-3) - efforts(times + 1e-3)) / 2e-3
    assert np.allclose(delay[2:-2, :, 0], late[2:-2], atol=0.02 * np.max(np.abs(late)))
    states = motion.at(times)[:3]
    load = efforts(times)[:, 1]
    behind = states.copy()
    behind[0, :, 1] -= 1e-4 * load
    behind[1, :, 1] -= 1e-4 * np.gradient(load, period)
    behind[2, :, 1] -= 1e-4 * np.gradient(np.gradient(load, period), period)
    changed = model.rows(samples_of(behind)).coefficients @ inertias.ravel() - efforts(times)
    assert np.allclose(1e-4 * elastic[4:-4, :, 0], changed[4:-4], atol=0.05 * np.max(np.abs(changed)))


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"findings": []}, "no finding has a rival"),
        ({"format": 2, "findings": []}, "has format 2"),
        ({"findings": [finding("spring", "j2", [("ghost", "")], stiffness=1.0)]}, "'ghost'"),
        ({"findings": [ROTOR], "floor": {"j1": 0.1, "joint4": 0.1}}, "written for another robot.*'joint4'"),
        ({"findings": [ROTOR], "floor": {"j1": 0.1, "arm/tx": 0.1, "tool/j9": 0.1}}, "another robot.*'tool/j9'"),
        ({"findings": [finding("spring", "elbow", [("effort_offset", "j2")], stiffness=1.0)]}, "'elbow'"),
    ],
)
def test_reports_that_cannot_be_used(document: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        rival_effects(TASK.feasibility, written(tmp_path, **document))
