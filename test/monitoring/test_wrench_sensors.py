"""What wrench sensors measure is compared with the URDF at first; one has changed where nothing else has."""

from __future__ import annotations

import numpy as np
import pytest
from files.recordings import BAGS

from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.model.robot import Robot
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.monitoring.change_detection import LATE, ChannelGap
from geomid_ros.monitoring.wrench_sensors import WrenchCheck, changed_sensors, sensor_channels
from geomid_ros.types import FloatArray


@pytest.fixture(scope="module")
def model() -> MeasurementModel:
    """An arm with three joints and two sensors in its chain, one of which measures forces only."""
    robot = Robot(read_urdf(BAGS / "arm3.urdf"), cuts=["link2", "wrist_ft"])
    sensors = [WrenchSensor("/wrist", "wrist_ft", "mounted"), WrenchSensor("/arm/ft", "link2", "mounted", ("fz", "fx"))]
    return MeasurementModel(robot, (), sensors)


def gaps(**first: int) -> list[ChannelGap]:
    """Open ones, and two that are not."""
    closed = [ChannelGap("joint1", 1.0, None, 7), ChannelGap("wrist/fx", 1.0, None, 8)]
    return closed + [ChannelGap(name.replace("__", "/"), 3.0, 10**9, at) for name, at in first.items()]


def test_channels_of_sensors(model: MeasurementModel) -> None:
    names = [channel.name for channel in model.channels]
    found = {topic: [names[place] for place in places] for topic, places in sensor_channels(model).items()}
    assert found == {
        "/wrist": [f"wrist/{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz")],
        "/arm/ft": ["arm/ft/fz", "arm/ft/fx"],
    }


def test_a_gap_of_a_sensor_alone_is_the_sensors(model: MeasurementModel) -> None:
    """Since the earliest of its gaps, and a block before."""
    assert changed_sensors(gaps(), model) == {}
    assert changed_sensors(gaps(wrist__fz=900, wrist__tx=800), model) == {"/wrist": 800 - LATE}
    assert changed_sensors(gaps(arm__ft__fz=500), model) == {"/arm/ft": 500 - LATE}


def test_a_gap_of_several_sensors_may_be_a_load(model: MeasurementModel) -> None:
    assert changed_sensors(gaps(wrist__fz=900, arm__ft__fz=500), model) is None


def test_without_a_joint_that_is_watched_it_may_be_a_load(model: MeasurementModel) -> None:
    """Nothing would show the difference."""
    of_sensors = [gap for gap in gaps(wrist__fz=900) if "/" in gap.channel]
    assert changed_sensors(of_sensors, model) is None


def test_a_gap_at_a_joint_may_be_a_load(model: MeasurementModel) -> None:
    assert changed_sensors(gaps(wrist__fz=900, joint2=1000), model) is None
    assert changed_sensors(gaps(joint2=1000), model) is None


def test_a_gap_of_a_force_plate_is_not_the_sensors() -> None:
    """It feels what the robot feels."""
    robot = Robot(read_urdf(BAGS / "arm3.urdf"), cuts=["wrist_ft"], floating_base=True)
    sensors = [WrenchSensor("/wrist", "wrist_ft", "mounted"), WrenchSensor("/plate", "world", "external")]
    model = MeasurementModel(robot, (), sensors)
    assert list(sensor_channels(model)) == ["/wrist"]
    assert changed_sensors(gaps(wrist__fz=900, plate__fz=900), model) is None
    assert changed_sensors(gaps(wrist__fz=900), model) == {"/wrist": 900 - LATE}


TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
WRONG = {
    "sign": (-np.eye(3), "sign"),
    "sign and payload": (-2.5 * np.eye(3), "sign"),
    "frame": (TURN, "frame"),
    "frame, another way": (TURN[[2, 0, 1]] @ TURN.T, "frame"),
    "unit": (0.001 * np.eye(3), "0.001 times"),
    "unit, larger": (100.0 * np.eye(3), "1e+02 times"),
}


def rows(model: MeasurementModel, nominal: FloatArray, distort: FloatArray, count: int, seed: int = 0) -> Rows:
    """What the URDF predicts on the wrist's forces, distorted, with noise."""
    rng = np.random.default_rng(seed)
    coefficients = rng.standard_normal((count, len(model.channels), len(nominal)))
    targets = coefficients @ nominal
    forces = sensor_channels(model)["/wrist"][:3]
    scale = np.std(targets[:, forces])
    targets[:, forces] = (targets[:, forces] + 0.2 * scale * rng.standard_normal((count, 3))) @ distort.T
    return Rows(coefficients, targets)


def checked(model: MeasurementModel, distort: FloatArray, *counts: int) -> WrenchCheck:
    nominal = np.random.default_rng(7).standard_normal(model.dimension)
    check = WrenchCheck(model, nominal)
    for seed, count in enumerate(counts):
        check.add(rows(model, nominal, distort, count, seed))
    return check


@pytest.mark.parametrize("case", WRONG)
def test_a_sensor_that_is_not_as_declared_is_named(case: str, model: MeasurementModel) -> None:
    distort, word = WRONG[case]
    check = checked(model, distort, 40, 40)
    assert check.ended
    assert list(check.problems) == ["/wrist"]
    assert word in check.problems["/wrist"]


def test_a_mirror_image_is_no_other_frame(model: MeasurementModel) -> None:
    """No frame is left-handed: nothing is said of what nobody understands."""
    assert checked(model, np.diag([1.0, 1.0, -1.0]), 80).problems == {}


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_a_payload_is_no_fault(factor: float, model: MeasurementModel) -> None:
    check = checked(model, factor * np.eye(3), 80)
    assert check.ended
    assert check.problems == {}


def test_nothing_is_said_of_a_few_instants(model: MeasurementModel) -> None:
    check = checked(model, -np.eye(3), 30, 29)
    assert not check.ended
    assert check.problems == {}


def test_only_the_first_instants_count(model: MeasurementModel) -> None:
    """Later a sensor that was as declared may change, which is for others to find."""
    nominal = np.random.default_rng(7).standard_normal(model.dimension)
    check = WrenchCheck(model, nominal)
    check.add(rows(model, nominal, np.eye(3), 60))
    check.add(rows(model, nominal, -np.eye(3), 6000))
    assert check.problems == {}


def test_without_three_forces_there_is_nothing_to_compare(model: MeasurementModel) -> None:
    lonely = MeasurementModel(model.robot, (), model.sensors[1:])
    assert WrenchCheck(lonely, np.zeros(lonely.dimension)).ended


def turned(degrees: float) -> FloatArray:
    """A rotation about z, of forces that are mostly across it."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.block([[turn, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])


@pytest.mark.parametrize(
    ("distort", "word"),
    [
        (40.0 * np.eye(3), ""),
        (60.0 * np.eye(3), "unit"),
        (0.025 * np.eye(3), ""),
        (0.016 * np.eye(3), "unit"),
        (turned(30.0), ""),
        (turned(90.0), "frame"),
        (60.0 * turned(90.0), "frame"),
        (-60.0 * np.eye(3), "sign"),
        (np.zeros((3, 3)), ""),
    ],
    ids=["40", "60", "1/40", "1/60", "30 degrees", "90 degrees", "60 and 90 degrees", "-60", "nothing"],
)
def test_what_a_payload_or_a_mounting_explains_is_no_fault(
    distort: FloatArray, word: str, model: MeasurementModel
) -> None:
    problem = checked(model, distort, 60).problems.get("/wrist", "")
    assert (word in problem) if word else not problem


def test_forces_that_say_nothing_of_the_urdf_s_are_no_fault(model: MeasurementModel) -> None:
    """Of noise alone neither sign nor frame nor unit can be told; what is not measured is left out."""
    nominal = np.random.default_rng(7).standard_normal(model.dimension)
    silent, holes = (rows(model, nominal, -np.eye(3), 200) for _ in range(2))
    noise = 1e3 * np.random.default_rng(8).standard_normal(silent.targets.shape)
    check = WrenchCheck(model, nominal)
    check.add(Rows(silent.coefficients, noise))
    assert check.problems == {}
    holes.targets[::2] = np.nan
    holes.targets[1::4, 3] = np.nan
    check = WrenchCheck(model, nominal)
    check.add(holes)
    assert "sign" in check.problems["/wrist"]
