"""A wrench sensor that is not what it is declared to be is told by what it carries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import TypeAlias

import numpy as np
import pytest
from files.recordings import BAGS
from scipy.spatial.transform import Rotation

from geomid_ros.checks import recording_check
from geomid_ros.checks.causes import Cause
from geomid_ros.checks.recording_check import CheckResult, CheckTask, RecordingCheck
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_fitted
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

Change: TypeAlias = Callable[[FloatArray], FloatArray]
SENSOR = WrenchSensor("/wrench", "wrist_ft", "mounted")


@cache
def recorded() -> tuple[Session, Samples]:
    """The shipped arm with a sensor at its wrist."""
    session = Session(read_urdf(BAGS / "arm7.urdf"), Configuration().with_sensors([SENSOR]), "arm7.urdf")
    train = read_fitted(session, Bags(fitted=[BAGS / "arm7"], hold_out=0.0))
    assert session.review.findings == ()
    return session, Samples.concatenate(train)


def cause(change: Change) -> Cause | None:
    """What is said of a sensor whose wrenches ``(N, 2, 3)``, force and torque, were changed."""
    session, samples = recorded()
    wrenches = change(samples.wrenches.reshape(-1, 2, 3).copy()).reshape(samples.wrenches.shape)
    check = RecordingCheck(CheckTask(session.model, np.ones(len(session.robot.joints)), {"/wrench": "wrist"}))
    check.add(replace(samples, wrenches=wrenches))
    with pytest.MonkeyPatch.context() as patch:  # efforts, which are always the same, would take most of the time
        patch.setattr(recording_check, "check_efforts", lambda *_, **__: CheckResult())
        findings = check.findings()
    assert len(findings) <= 1
    return findings[0].cause if findings else None


def turned(axis: list[float], degrees: float) -> Change:
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    return lambda wrench: wrench @ turn.T


def in_base(wrench: FloatArray) -> FloatArray:
    session, samples = recorded()
    rotations = []
    for q, v, a in zip(*session.robot.configuration(samples), strict=True):
        session.robot.update_motion(q, v, a)
        rotations.append(np.array(session.robot.placement("wrist_ft").rotation))
    return wrench @ np.array(rotations).transpose(0, 2, 1)


def late(wrench: FloatArray, seconds: float) -> FloatArray:
    steps = round(seconds / float(np.median(np.diff(recorded()[1].seconds))))
    return np.concatenate([np.repeat(wrench[:1], steps, axis=0), wrench[:-steps]])


X, Y, Z = np.eye(3).tolist()
UNIT = "check that it is in N and N m"
FAULTS: dict[str, tuple[Change, str]] = {
    "sound": (lambda wrench: wrench, ""),
    "an offset, as all sensors have": (lambda wrench: wrench + np.array([[3.0, -5.0, 8.0], [0.2, 0.1, -0.3]]), ""),
    "reversed": (np.negative, "write wrench.wrist.sign: -1.0"),
    "in mN": (lambda wrench: 1000.0 * wrench, UNIT),
    "in kN": (lambda wrench: 1e-3 * wrench, UNIT),
    "torques in N mm": (lambda wrench: wrench * np.array([[1.0], [1000.0]]), "torques are in N mm"),
    "a quarter turn about z": (turned(Z, 90.0), "are its y, -x, z;"),
    "a quarter turn about x": (turned(X, 90.0), "are its x, z, -y;"),
    "half a turn about y": (turned(Y, 180.0), "are its -x, y, -z;"),
    "35 degrees": (turned([1.0, 2.0, 2.0], 35.0), "by about 3"),
    "70 degrees": (turned([1.0, 2.0, 2.0], 70.0), "by about 7"),
    "in the axes of the base": (in_base, "axes of the base"),
    "late": (partial(late, seconds=0.5), "0.50 s late"),
    "very late": (partial(late, seconds=1.5), "1.50 s late"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_what_is_wrong_with_a_sensor_is_named(case: str) -> None:
    change, said = FAULTS[case]
    found = cause(change)
    assert (found is not None) == bool(said)
    if found is not None:
        assert said in found.sentence
