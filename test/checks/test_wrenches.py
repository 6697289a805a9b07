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
from geomid_ros.checks.wrench_sensors import FirstForces
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.model.robot import Robot
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


@pytest.fixture(scope="module")
def model() -> MeasurementModel:
    """An arm with three joints and two sensors in its chain, one of which measures forces only."""
    robot = Robot(read_urdf(BAGS / "arm3.urdf"), cuts=["link2", "wrist_ft"])
    sensors = [WrenchSensor("/wrist", "wrist_ft", "mounted"), WrenchSensor("/arm/ft", "link2", "mounted", ("fz", "fx"))]
    return MeasurementModel(robot, (), sensors)


def rows(model: MeasurementModel, nominal: FloatArray, distort: FloatArray, count: int, seed: int = 0) -> Rows:
    """What the URDF predicts on the wrist's forces, distorted, with noise."""
    rng = np.random.default_rng(seed)
    coefficients = rng.standard_normal((count, len(model.channels), len(nominal)))
    targets = coefficients @ nominal
    forces = list(model.layout.wrenches["/wrist"])[:3]
    scale = np.std(targets[:, forces])
    targets[:, forces] = (targets[:, forces] + 0.2 * scale * rng.standard_normal((count, 3))) @ distort.T
    return Rows(coefficients, targets)


def checked(model: MeasurementModel, distort: FloatArray, *counts: int) -> FirstForces:
    nominal = np.random.default_rng(7).standard_normal(model.dimension)
    check = FirstForces(model, nominal)
    for seed, count in enumerate(counts):
        check.add(rows(model, nominal, distort, count, seed))
    return check


def test_only_the_first_instants_count(model: MeasurementModel) -> None:
    """Later a sensor that was as declared may change, which is for others to find."""
    nominal = np.random.default_rng(7).standard_normal(model.dimension)
    check = FirstForces(model, nominal)
    check.add(rows(model, nominal, np.eye(3), 60))
    check.add(rows(model, nominal, -np.eye(3), 6000))
    assert check.problems == {}


def about_z(degrees: float) -> FloatArray:
    """A rotation about z, of forces that are mostly across it."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.block([[turn, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])


@pytest.mark.parametrize(
    ("distort", "word"),
    [
        (np.eye(3), ""),
        (10.0 * np.eye(3), ""),
        (40.0 * np.eye(3), ""),
        (60.0 * np.eye(3), "unit"),
        (100.0 * np.eye(3), "1e+02 times"),
        (0.025 * np.eye(3), ""),
        (0.016 * np.eye(3), "unit"),
        (0.001 * np.eye(3), "0.001 times"),
        (about_z(30.0), ""),
        (about_z(90.0), "frame"),
        (about_z(90.0)[[2, 0, 1]] @ about_z(90.0).T, "frame"),
        (60.0 * about_z(90.0), "frame"),
        (-np.eye(3), "sign"),
        (-2.5 * np.eye(3), "sign"),
        (-60.0 * np.eye(3), "sign"),
        (np.zeros((3, 3)), ""),
    ],
    ids=str,
)
def test_a_sensor_that_is_not_as_declared_is_named(distort: FloatArray, word: str, model: MeasurementModel) -> None:
    """What a payload or a mounting explains is no fault."""
    check = checked(model, distort, 30, 30)
    assert check.ended
    assert [*check.problems] == ["/wrist"] * bool(word)
    assert word in check.problems.get("/wrist", "")


def test_forces_that_say_nothing_of_the_urdf_s_are_no_fault(model: MeasurementModel) -> None:
    """Of noise alone neither sign nor frame nor unit can be told; what is not measured is left out."""
    nominal = np.random.default_rng(7).standard_normal(model.dimension)
    silent, holes = (rows(model, nominal, -np.eye(3), 200) for _ in range(2))
    noise = 1e3 * np.random.default_rng(8).standard_normal(silent.targets.shape)
    check = FirstForces(model, nominal)
    check.add(Rows(silent.coefficients, noise))
    assert check.problems == {}
    holes.targets[::2] = np.nan
    holes.targets[1::4, 3] = np.nan
    check = FirstForces(model, nominal)
    check.add(holes)
    assert "sign" in check.problems["/wrist"]
