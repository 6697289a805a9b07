"""What wrench sensors measure at first is compared with the URDF."""

from __future__ import annotations

import numpy as np
import pytest
from files.recordings import BAGS

from geomid_ros.checks.wrench_sensors import FirstForces
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray


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


def turned(degrees: float) -> FloatArray:
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
        (turned(30.0), ""),
        (turned(90.0), "frame"),
        (turned(90.0)[[2, 0, 1]] @ turned(90.0).T, "frame"),
        (60.0 * turned(90.0), "frame"),
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
