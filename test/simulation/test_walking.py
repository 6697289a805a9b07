"""A quadruped on its feet: the simulator's own laws, and what is recorded of them."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from model.robots import urdf

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import read_description
from geomid_ros.simulation.motion import WalkTrace
from geomid_ros.simulation.walking import WalkOptions, parse_feet, simulate_walk, true_bodies, walk

from .reading import messages

FEET = {f"{leg}_foot": 0.022 for leg in ("FL", "FR", "RL", "RR")}
OPTIONS = WalkOptions(robot="", feet=FEET, imu="imu", duration=24.0, rate=250.0)


@cache
def walked() -> WalkTrace:
    """The true motion."""
    robot = read_description(urdf("go2.urdf"))
    return walk(robot, true_bodies(robot, OPTIONS), OPTIONS)


def test_the_ground_carries_the_robot_with_its_payload() -> None:
    """On average over time, whatever the gait; as the accelerometer shows."""
    bodies = true_bodies(read_description(urdf("go2.urdf")), OPTIONS)
    weight = 9.81 * sum(body.mass for body in bodies)
    nominal = 9.81 * sum(body.mass for body in read_description(urdf("go2.urdf")).inertias)
    assert weight > nominal + 9.81 * 2.5
    assert np.mean(np.sum(walked().contact, axis=1)) == pytest.approx(weight, rel=0.01)
    assert np.mean(walked().specific_force[:, 2]) == pytest.approx(9.81, rel=0.02)


def test_each_gait_lifts_the_feet_that_it_should() -> None:
    """None when swaying, one at a time, two at a time."""
    lifted = walked().contact < 1e-3
    sway, lift, trot = np.split(np.sum(lifted, axis=1), 3)
    assert np.mean(sway == 0) > 0.99
    assert np.mean(lift == 1) > 0.15
    assert np.mean(lift <= 1) > 0.95
    assert np.max(trot) >= 2
    assert np.split(lifted, 3)[1].any(axis=0).all()


@pytest.fixture
def options(tmp_path: Path) -> WalkOptions:
    (tmp_path / "go2.urdf").write_text(urdf("go2.urdf"), encoding="utf-8")
    return replace(OPTIONS, robot=str(tmp_path / "go2.urdf"), gaits=("wobble",), duration=4.0)


def test_what_is_recorded(options: WalkOptions, tmp_path: Path) -> None:
    """The joints, the IMU, and the description that lacks the payload; the truth lies beside."""
    bag, truth = simulate_walk(tmp_path / "bag", options)
    joints, imu = messages(bag, "/joint_states"), messages(bag, "/imu")
    assert len(joints) == len(imu) == 1000
    assert {len(joint.effort) for joint in joints} == {12}
    assert {each.header.frame_id for each in imu} == {"imu"}
    assert np.mean([each.linear_acceleration.z for each in imu]) == pytest.approx(9.81, abs=0.2)
    assert {each.orientation_covariance[0] for each in imu} == {-1.0}, "no orientation"
    (description,) = messages(bag, "/robot_description")
    assert description.data == urdf("go2.urdf")
    links = {link["name"]: link["mass"] for link in json.loads(truth.read_text())["links"]}
    assert links["base"] > 6.921 + 2.0
    with pytest.raises(InputError, match="exists already"):
        simulate_walk(tmp_path / "bag", options)


def test_the_trunk_carries_the_payload_if_there_is_one() -> None:
    """Also as a root link without a mass."""
    robot = read_description(urdf("go2.urdf"))
    exact = replace(OPTIONS, payload=0.0, inertia_error=0.0)
    for body, nominal in zip(true_bodies(robot, exact), robot.inertias, strict=True):
        assert body.mass == pytest.approx(nominal.mass)
        np.testing.assert_allclose(body.com, nominal.com, atol=1e-12)
    massless = read_description(urdf("a1.urdf"))
    assert massless.root not in {body.name for body in massless.inertias}
    loaded = true_bodies(massless, replace(OPTIONS, inertia_error=0.0))
    added = sum(body.mass for body in loaded) - sum(body.mass for body in massless.inertias)
    assert added == pytest.approx(OPTIONS.payload)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gaits": ("run",)}, "unknown gait 'run'"),
        ({"duration": 1.0}, "duration is 1, expected 4 or more"),
        ({"rate": 300.0}, "rate is 300; it must be 1000 Hz divided by an integer"),
        ({"feet": {"FL_foot": 0.022}}, "12 moving joints and 1 feet"),
        ({"imu": "head"}, "unknown link 'head'"),
    ],
)
def test_what_cannot_walk_is_refused(
    options: WalkOptions, tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        simulate_walk(tmp_path / "bag", replace(options, **changes))


def test_feet_are_parsed() -> None:
    assert parse_feet(["a:0.02", "b:1"]) == {"a": 0.02, "b": 1.0}
    with pytest.raises(InputError, match="LINK:RADIUS"):
        parse_feet(["a"])
