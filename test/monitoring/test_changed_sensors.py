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


@pytest.mark.parametrize(
    ("first", "changed"),
    [
        ({}, {}),
        ({"wrist__fz": 900, "wrist__tx": 800}, {"/wrist": 800 - LATE}),  # since the earliest of its gaps, and before
        ({"arm__ft__fz": 500}, {"/arm/ft": 500 - LATE}),
        ({"wrist__fz": 900, "arm__ft__fz": 500}, None),
        ({"wrist__fz": 900, "joint2": 1000}, None),
        ({"joint2": 1000}, None),
    ],
)
def test_a_gap_of_one_sensor_alone_is_the_sensors(
    first: dict[str, int], changed: dict[str, int] | None, model: MeasurementModel
) -> None:
    """One of several sensors, or at a joint, may be a load; so may any if no joint is watched."""
    assert changed_sensors(gaps(**first), model) == changed
    of_sensors = [gap for gap in gaps(**first) if "/" in gap.channel]
    assert changed_sensors(of_sensors, model) is None


def test_a_gap_of_a_force_plate_is_not_the_sensors() -> None:
    """It feels what the robot feels."""
    robot = Robot(read_urdf(BAGS / "arm3.urdf"), cuts=["wrist_ft"], floating_base=True)
    sensors = [WrenchSensor("/wrist", "wrist_ft", "mounted"), WrenchSensor("/plate", "world", "external")]
    model = MeasurementModel(robot, (), sensors)
    assert list(sensor_channels(model)) == ["/wrist"]
    assert changed_sensors(gaps(wrist__fz=900, plate__fz=900), model) is None
    assert changed_sensors(gaps(wrist__fz=900), model) == {"/wrist": 900 - LATE}
