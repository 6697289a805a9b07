"""How many hypotheses are fitted does not grow with the joints of a robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from estimation.arms import motion, samples

from geomid_ros.checks import effort_data
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.recording_check import check_efforts
from geomid_ros.checks.sample_reservoir import FEWEST, KeptSamples
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot


def chain(joints: int) -> str:
    """URDF of a chain of links that turn about the axes y and x in turn."""
    parts = [
        f'<link name="l{n}"><inertial><origin xyz="0.1 0.02 0.01"/><mass value="{2.0 - 1.5 * n / joints}"/>'
        '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.013"/></inertial></link>'
        f'<joint name="j{n}" type="revolute"><parent link="l{n - 1}"/><child link="l{n}"/><origin xyz="0.2 0 0"/>'
        f'<axis xyz="{n % 2} {1 - n % 2} 0"/><limit lower="-3" upper="3" effort="900" velocity="4"/></joint>'
        for n in range(1, joints + 1)
    ]
    return f'<robot name="chain"><link name="l0"/>{"".join(parts)}</robot>'


def fits(monkeypatch: pytest.MonkeyPatch, joints: int) -> tuple[int, list[tuple[str, ...]]]:
    """How many fits it takes to find the joint whose effort is reversed, and the joints that are named."""
    robot = Robot(chain(joints), source="chain")
    moving = samples(motion(np.random.default_rng(joints), joints, 8.0), np.zeros((800, joints)))
    recorded = moving.select(slice(None, None, 800 // (2 * FEWEST)))
    rows = robot.joint_effort_rows(*robot.configuration(recorded)).reshape(len(recorded), joints, -1)
    true = np.array([body.parameters for body in robot.bodies]).ravel()
    effort = rows @ true + 0.2 * recorded.velocity
    effort += 0.02 * np.std(effort, axis=0) * np.random.default_rng(0).normal(size=effort.shape)
    effort[:, 1] *= -1.0
    measured = type(recorded)(**{**recorded.arrays, "effort": effort})
    count = 0

    def counted(of: Callable[..., Any]) -> Callable[..., Any]:
        def one(*arguments: Any, **named: Any) -> Any:
            nonlocal count
            count += 1
            return of(*arguments, **named)

        return one

    with monkeypatch.context() as patch:
        patch.setattr(effort_data, "evidence", counted(effort_data.evidence))
        kept = KeptSamples(measured, measured, np.zeros(len(measured), dtype=np.int64), np.full(len(measured), ""))
        found = check_efforts(MeasurementModel(robot, ()), kept, np.ones(joints)).findings
    return count, [finding.cause.places for finding in found]


def test_fits_do_not_grow_with_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    few, named = fits(monkeypatch, 6)
    assert named == [("j2",)]
    many, named = fits(monkeypatch, 12)
    assert named == [("j2",)]
    assert many <= few + 20


def test_expected_efforts_are_those_of_links_drawn_about_the_urdfs() -> None:
    random, robot = np.random.default_rng(3), Robot(chain(4), source="chain")
    subject = EffortData.of_all(robot, samples(motion(random, 4, 0.6), random.normal(size=(60, 4))))
    draws = np.einsum("bij,nbj->nbi", subject.factor, random.normal(size=(4000, 4, 10))).reshape(4000, 40)
    squares = [np.var(subject.link_efforts(subject.urdf_parameters + draw), axis=0) for draw in draws]
    assert np.allclose(np.sqrt(np.mean(squares, axis=0)), subject.expected_std, rtol=0.05)
