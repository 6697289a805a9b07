"""A name that does not exist is answered with those that do, and with the one that was probably meant."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from signals.feeding import pipeline_of
from signals.sent import WrenchMessage

from geomid_ros.errors import InputError
from geomid_ros.model.channels import AXES, ROLES, WORLD_FRAMES, WrenchSensor
from geomid_ros.model.effects import identifiable, identified_effect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.signals.settings import SignalSettings

from .robots import urdf

UR5_JOINTS = [f"{part}_joint" for part in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]


def ur5() -> Robot:
    return Robot(urdf("ur5_robot.urdf"), source="ur5")


def measured(frame: str, role: str, floating: bool = False) -> Callable[[], object]:
    robot = Robot(urdf("solo12.urdf"), floating_base=True) if floating else ur5()
    return lambda: MeasurementModel(robot, [], [WrenchSensor("/wrench", frame, role)])


CASES: dict[str, tuple[Callable[[], object], str, list[str]]] = {
    "effect": (lambda: identified_effect("viscous_fricton"), "viscous_friction", list(identifiable())),
    "role": (lambda: WrenchSensor("/w", "tool0", "mountd"), "mounted", list(ROLES)),
    "axis": (lambda: WrenchSensor("/w", "tool0", "mounted", ("fx", "mz", "tzz")), "", list(AXES)),
    "locked joint": (lambda: Robot(urdf("ur5_robot.urdf"), locked_joints=["elbow"]), "elbow_joint", UR5_JOINTS),
    "cut": (lambda: Robot(urdf("ur5_robot.urdf"), cuts=["tool"]), "tool0", ["base_link", "forearm_link"]),
    "link": (lambda: MeasurementModel(ur5(), [], links=["forarm_link"]), "forearm_link", ["wrist_3_link"]),
    "frame of a mounted sensor": (measured("tool_0", "mounted"), "tool0", ["base_link"]),
    "frame of a load": (measured("tool_0", "external"), "tool0", ["base_link"]),
    "frame on a floating robot": (measured("FL_FOOD", "external", floating=True), "FL_FOOT", [*WORLD_FRAMES]),
    "mounted in the world": (measured("world_", "mounted", floating=True), "", ["FL_FOOT"]),
    "joint with a gain": (
        lambda: pipeline_of(UR5_JOINTS, settings=SignalSettings(effort_gain={"elbow": -1.0})),
        "elbow_joint",
        UR5_JOINTS,
    ),
    "wrench topic": (
        lambda: pipeline_of(["a"], sensors=[WrenchSensor("/ft", "l", "mounted")]).push(
            WrenchMessage("ft", 1, "l", [0.0] * 6)
        ),
        "/ft",
        ["/ft"],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_an_unknown_name_is_answered_with_the_valid_ones(case: str) -> None:
    ask, meant, valid = CASES[case]
    with pytest.raises(InputError, match="unknown") as caught:
        ask()
    message = str(caught.value)
    assert not meant or f"Did you mean '{meant}'?" in message
    for name in valid:
        assert name in message.split("Valid:")[1]


@pytest.mark.parametrize("frame", WORLD_FRAMES)
def test_a_force_plate_stands_in_the_world(frame: str) -> None:
    robot = Robot(urdf("solo12.urdf"), floating_base=True)
    model = MeasurementModel(robot, [], [WrenchSensor("/plate", frame, "external")])
    assert len(model.channels) == 6
    with pytest.raises(InputError, match=frame):
        MeasurementModel(Robot(urdf("panda.urdf")), [], [WrenchSensor("/plate", frame, "external")])


def test_a_sensor_from_text() -> None:
    assert WrenchSensor.parse("/w:tool0:mounted") == WrenchSensor("/w", "tool0", "mounted")
    assert WrenchSensor.parse("/w:l:-external:fz,tx") == WrenchSensor("/w", "l", "external", ("fz", "tx"), -1.0)


@pytest.mark.parametrize("text", ["", "/w", "/w:tool0", "/w::mounted", "/w:tool0:mounted:", "/w:tool0:mounted:fx:more"])
def test_a_malformed_sensor_is_answered_with_the_form(text: str) -> None:
    with pytest.raises(InputError, match="TOPIC:FRAME:ROLE"):
        WrenchSensor.parse(text)


@pytest.mark.parametrize(("axes", "sign"), [((), 1.0), (AXES, 0.0), (AXES, 2.0), (AXES, float("nan"))])
def test_a_sensor_has_axes_and_a_sign(axes: tuple[str, ...], sign: float) -> None:
    with pytest.raises(InputError, match="axis"):
        WrenchSensor("/w", "tool0", "mounted", axes, sign)
