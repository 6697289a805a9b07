"""A wrench sensor has changed where nothing else has."""

from __future__ import annotations

import pytest
from files.recordings import BAGS

from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.monitoring.change_detection import LATE, ChannelGap, changed_sensors, sensor_channels


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
