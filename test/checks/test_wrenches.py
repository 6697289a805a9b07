"""A wrench sensor that is not what it is declared to be is told by what it carries."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from files.recordings import BAGS
from scipy.spatial.transform import Rotation

from geomid_ros.checks.causes import Cause
from geomid_ros.checks.recording_check import CheckTask, RecordingCheck
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_fitted
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

SENSOR = WrenchSensor("/wrench", "wrist_ft", "mounted")


@cache
def recorded() -> tuple[Session, Samples]:
    """The shipped arm with a sensor at its wrist."""
    session = Session(read_urdf(BAGS / "arm7.urdf"), Configuration().with_sensors([SENSOR]), "arm7.urdf")
    train = read_fitted(session, Bags(fitted=[BAGS / "arm7"], hold_out=0.0))
    assert session.review.findings == ()
    return session, Samples.concatenate(train)


def cause(change: Callable[[FloatArray], FloatArray]) -> Cause | None:
    """What is said of a sensor whose wrenches ``(N, 2, 3)``, force and torque, were changed."""
    session, samples = recorded()
    wrenches = change(samples.wrenches.reshape(-1, 2, 3).copy()).reshape(samples.wrenches.shape)
    check = RecordingCheck(CheckTask(session.model, np.ones(len(session.robot.joints)), {"/wrench": "wrist"}))
    check.add(replace(samples, wrenches=wrenches))
    findings = check.findings()
    assert len(findings) <= 1
    return findings[0].cause if findings else None


def test_a_sound_sensor_is_not_doubted() -> None:
    assert cause(lambda wrench: wrench) is None


def test_an_offset_is_no_fault() -> None:
    """All sensors have one."""
    assert cause(lambda wrench: wrench + np.array([[3.0, -5.0, 8.0], [0.2, 0.1, -0.3]])) is None


def test_a_reversed_sign() -> None:
    found = cause(np.negative)
    assert found is not None
    assert found.settings == {"wrench.wrist.sign": -1.0}


@pytest.mark.parametrize("factor", [1000.0, 1e-3])
def test_another_unit_of_all(factor: float) -> None:
    found = cause(lambda wrench: factor * wrench)
    assert found is not None
    assert "check that it is in N and N m" in found.sentence


def test_torques_in_another_unit() -> None:
    found = cause(lambda wrench: wrench * np.array([[1.0], [1000.0]]))
    assert found is not None
    assert "torques are in N mm" in found.sentence


@pytest.mark.parametrize(
    ("axis", "quarters", "axes"), [("z", 1, "y, -x, z"), ("x", 1, "x, z, -y"), ("y", 2, "-x, y, -z")]
)
def test_turned_axes_are_named(axis: str, quarters: int, axes: str) -> None:
    """The sensor sits turned by right angles: which of its axes is which of the frame's is told."""
    turn = Rotation.from_euler(axis, 90.0 * quarters, degrees=True).as_matrix()
    found = cause(lambda wrench: wrench @ turn.T)
    assert found is not None
    assert f"are its {axes};" in found.sentence


@pytest.mark.parametrize("degrees", [35.0, 70.0])
def test_axes_turned_by_any_angle_are_named(degrees: float) -> None:
    """Not only right angles: a flange that is mounted a few holes further on."""
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([1.0, 2.0, 2.0]) / 3.0).as_matrix()
    found = cause(lambda wrench: wrench @ turn.T)
    assert found is not None
    (told,) = re.findall(r"by about (\d+) degrees", found.sentence)
    assert float(told) == pytest.approx(degrees, abs=3.0)


def test_the_axes_of_the_base() -> None:
    session, samples = recorded()
    rotations = []
    for q, v, a in zip(*session.robot.configuration(samples), strict=True):
        session.robot.update_motion(q, v, a)
        rotations.append(np.array(session.robot.placement("wrist_ft").rotation))
    found = cause(lambda wrench: wrench @ np.array(rotations).transpose(0, 2, 1))
    assert found is not None
    assert "axes of the base" in found.sentence


@pytest.mark.parametrize("late", [0.5, 1.5])
def test_messages_that_come_late(late: float) -> None:
    _, samples = recorded()
    steps = round(late / float(np.median(np.diff(samples.seconds))))

    def delayed(wrench: FloatArray) -> FloatArray:
        return np.concatenate([np.repeat(wrench[:1], steps, axis=0), wrench[:-steps]])

    found = cause(delayed)
    assert found is not None
    assert f"{late:.2f} s late" in found.sentence
