"""Wrench sensors: on the ground, under the feet, and inside the chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.errors import InputError
from geomid_ros.model.channels import AXES, WrenchSensor
from geomid_ros.model.effects import identified_effect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Entries, Samples
from geomid_ros.types import FloatArray

from .robots import Reference, part_after, random_parameters, random_samples, urdf, with_values
from .test_joint_rows import assert_equal

FLOATING = pytest.mark.parametrize(
    ("name", "foot", "other_foot"),
    [
        ("solo12.urdf", "FL_FOOT", "HR_FOOT"),
        ("a1.urdf", "FR_foot", "RL_foot"),
        ("g1_29dof_rev_1_0.urdf", "left_ankle_roll_link", "right_ankle_roll_link"),
        ("talos_reduced.urdf", "left_sole_link", "right_sole_link"),
        ("human.urdf", "left_foot", "right_foot"),
    ],
)


def in_frames(forces: FloatArray, placements: list[pin.SE3]) -> FloatArray:
    """Wrenches ``(N, 6)`` of one frame, seen from others in which that frame is placed so."""
    return np.array([placement.act(pin.Force(f)).vector for f, placement in zip(forces, placements, strict=True)])


@FLOATING
def test_a_force_plate_feels_the_whole_robot(name: str, foot: str, other_foot: str) -> None:
    """(25)-(27): the base part of inverse dynamics, carried to the plate, for any bodies; axes in the order given."""
    del foot, other_foot
    robot = Robot(urdf(name), floating_base=True)
    axes = ("tx", "ty", "fz")
    model = MeasurementModel(
        robot, [identified_effect("viscous_friction")], [WrenchSensor("/plate", "world", "external", axes)]
    )
    assert [(c.name, c.unit) for c in model.channels] == [("plate/tx", "N m"), ("plate/ty", "N m"), ("plate/fz", "N")]
    assert model.dimension == 10 * len(robot.bodies)  # the load's way through the joints is unknown: no effects

    parameters = random_parameters(robot, seed=1)
    reference = Reference(urdf(name), floating_base=True)
    reference.set_inertias(dict(zip(robot.body_names, parameters, strict=True)))
    samples = random_samples(robot, seed=2, sensors=1)
    base = reference.inverse_dynamics(samples, robot.joint_names)[0]
    on_plate = in_frames(base, [pin.XYZQUATToSE3(pose) for pose in samples.base_pose])
    measured, predicted = model.predict(samples, parameters.ravel())
    assert_equal(predicted, on_plate[:, [3, 4, 2]])
    np.testing.assert_array_equal(measured, samples.wrenches[:, 0, [3, 4, 2]])


def standing(
    reference: Reference, samples: Samples, joints: tuple[str, ...], feet: tuple[str, str]
) -> tuple[dict[str, FloatArray], FloatArray]:
    """Contact wrenches ``(N, 6)`` by foot, the first random, that carry the robot; and the joint efforts with them."""
    first = np.random.default_rng(4).normal(size=(len(samples), 6))
    wrenches = {feet[0]: first, feet[1]: np.zeros_like(first)}
    missing = reference.inverse_dynamics(samples, joints, wrenches)[0]
    for index, pose in enumerate(samples.base_pose):
        to_foot = reference.placement(samples, index, joints, feet[1]).actInv(pin.XYZQUATToSE3(pose))
        wrenches[feet[1]][index] = to_foot.act(pin.Force(missing[index])).vector
    base, efforts = reference.inverse_dynamics(samples, joints, wrenches)
    np.testing.assert_allclose(base, 0.0, atol=1e-9 * np.max(np.abs(missing)))
    return wrenches, efforts


@FLOATING
def test_two_feet_and_the_joints_balance(name: str, foot: str, other_foot: str) -> None:
    """tau + J^T w for the joints and the sum of both feet for the base, made by rnea with external forces."""
    robot = Robot(urdf(name), floating_base=True)
    sensors = [WrenchSensor("/a", foot, "external"), WrenchSensor("/b", other_foot, "external", sign=-1.0)]
    model = MeasurementModel(robot, [identified_effect("viscous_friction")], sensors)
    assert len(model.channels) == len(robot.joints) + 6
    assert {c.name for c in model.channels[-6:]} == {f"a/{axis}" for axis in AXES}

    parameters = random_parameters(robot, seed=5)
    reference = Reference(urdf(name), floating_base=True)
    reference.set_inertias(dict(zip(robot.body_names, parameters, strict=True)))
    samples = random_samples(robot, seed=6, sensors=2)
    wrenches, efforts = standing(reference, samples, robot.joint_names, (foot, other_foot))
    viscous = np.random.default_rng(7).uniform(size=len(robot.joints))
    samples = with_values(
        samples,
        effort=efforts + viscous * samples.velocity,
        wrenches=np.stack([wrenches[foot], -wrenches[other_foot]], axis=1),
    )
    measured, predicted = model.predict(samples, np.concatenate([parameters.ravel(), viscous]))
    assert_equal(measured, predicted)


def test_a_known_load_on_a_fixed_robot_reaches_its_joints() -> None:
    """A pushed arm: no rows of the sensor's own, but J^T w in the joints' equations."""
    robot = Robot(urdf("panda.urdf"))
    model = MeasurementModel(robot, [], [WrenchSensor("/push", "panda_hand", "external", sign=-1.0)])
    assert len(model.channels) == len(robot.joints)
    samples = random_samples(robot, seed=8, sensors=1)
    reference = Reference(urdf("panda.urdf"))
    efforts = reference.inverse_dynamics(samples, robot.joint_names, {"panda_hand": -samples.wrenches[:, 0]})[1]
    measured, predicted = model.predict(with_values(samples, effort=efforts), model.nominal_inertias)
    assert_equal(measured, predicted)


@pytest.mark.parametrize(
    ("name", "link", "floating", "sign"),
    [
        ("ur5_robot.urdf", "wrist_1_link", False, 1.0),  # a moving link
        ("panda.urdf", "panda_hand", False, -1.0),  # inside a group of fixed links, fingers after it
        ("talos_reduced.urdf", "wrist_left_ft_link", True, 1.0),
        ("a1.urdf", "FL_foot", True, -1.0),
        ("human.urdf", "left_clavicle", True, 1.0),
    ],
)
def test_a_mounted_sensor_moves_all_that_comes_after_it(name: str, link: str, floating: bool, sign: float) -> None:
    """Its rows are the base part of the inverse dynamics of the distal part, a robot of its own led by its frame."""
    robot = Robot(urdf(name), floating_base=floating, cuts=[link])
    axes = ("fz", "tx", "fy", "tz")
    sensor = WrenchSensor("/wrist", link, "mounted", axes, sign)
    model = MeasurementModel(robot, [identified_effect("effort_offset")] if not floating else [], [sensor])
    samples = random_samples(robot, seed=9, sensors=1)

    part = Reference(part_after(urdf(name), link), floating_base=True)
    whole = Reference(urdf(name), floating_base=floating)
    joints = [joint for joint in robot.joint_names if part.model.existJointName(joint)]
    chosen = [robot.joint_names.index(joint) for joint in joints]
    poses, velocities, accelerations = [], [], []
    for index in range(len(samples)):
        placement = whole.placement(samples, index, robot.joint_names, link)
        velocity, acceleration = whole.motion(samples, index, robot.joint_names, link)
        poses.append(pin.SE3ToXYZQUAT(placement))
        velocities.append(velocity)
        accelerations.append(acceleration)
    led = with_values(
        samples,
        **{kind: getattr(samples, kind)[:, chosen] for kind in ("position", "velocity", "acceleration")},
        base_pose=np.array(poses),
        base_velocity=np.array(velocities),
        base_acceleration=np.array(accelerations),
    )
    expected = part.inverse_dynamics(led, joints)[0]

    parameters = np.concatenate([model.nominal_inertias, np.zeros(len(model.coefficients))])
    measured, predicted = model.predict(samples, parameters)
    indices = [AXES.index(axis) for axis in axes]
    assert_equal(predicted[:, -4:], expected[:, indices])
    np.testing.assert_array_equal(measured[:, -4:], sign * samples.wrenches[:, 0, indices])
    assert [channel.name for channel in model.channels[-4:]] == [f"wrist/{axis}" for axis in axes]
    carried = {model.body_names[column // 10] for column in model.channels[-1].columns}
    assert carried == {body for body in robot.body_names if part.model.existBodyName(body)}


def test_a_sensor_under_a_fixed_base_feels_the_base_as_well() -> None:
    """The base link stands still but weighs on the sensor: it is one of the bodies, fixed to the world."""
    robot = Robot(urdf("ur5_robot.urdf"), cuts=["base_link"])
    model = MeasurementModel(robot, [], [WrenchSensor("/base", "base_link", "mounted")])
    assert robot.body_names[0] == "base_link"
    samples = random_samples(robot, seed=10, sensors=1)
    part = Reference(part_after(urdf("ur5_robot.urdf"), "base_link"), floating_base=True)
    still = np.zeros((len(samples), 6))
    pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(samples), 1))
    moved = with_values(samples, base_pose=pose, base_velocity=still, base_acceleration=still)
    base, efforts = part.inverse_dynamics(moved, robot.joint_names)
    assert_equal(model.predict(samples, model.nominal_inertias)[1], np.hstack([efforts, base]))


def test_what_an_axis_does_not_measure_is_not_read() -> None:
    """A one-axis load cell fills the rest of its message with NaN."""
    robot = Robot(urdf("solo12.urdf"), floating_base=True)
    samples = random_samples(robot, seed=11, sensors=1)
    holes = samples.wrenches.copy()
    holes[:, :, [0, 1, 3, 4, 5]] = np.nan
    for frame in ("world", "FL_FOOT"):
        model = MeasurementModel(robot, [], [WrenchSensor("/cell", frame, "external", ("fz",))])
        np.testing.assert_array_equal(
            model.rows(with_values(samples, wrenches=holes)).targets, model.rows(samples).targets
        )


def feet(*axes: tuple[str, ...], topics: str = "ab") -> list[WrenchSensor]:
    """Loads on two feet."""
    places = zip(topics, ("FL_FOOT", "FR_FOOT"), axes, strict=True)
    return [WrenchSensor(f"/{topic}", foot, "external", measured) for topic, foot, measured in places]


@pytest.mark.parametrize(
    ("robot", "sensors", "message"),
    [
        (Robot(urdf("panda.urdf")), [WrenchSensor("/wrist", "panda_hand", "mounted")], "'panda_hand'.*cuts"),
        (Robot(urdf("ur5_robot.urdf")), [WrenchSensor("/base", "world", "mounted")], "'world'.*cuts"),
        (
            Robot(urdf("ur5_robot.urdf"), cuts=["tool0"]),
            [WrenchSensor("/wrist", "tool0", "mounted")],
            "'tool0' has no mass distal to it",
        ),
        (Robot(urdf("solo12.urdf"), floating_base=True), [], "external"),
        # A fixed arm pushed with a force known along one axis only.
        (Robot(urdf("panda.urdf")), [WrenchSensor("/push", "panda_hand", "external", ("fz",))], "all six axes"),
        (Robot(urdf("solo12.urdf"), floating_base=True), feet(AXES, ("fz",)), "six axes"),
        (Robot(urdf("solo12.urdf"), floating_base=True), feet(AXES, AXES, topics="aa"), "/a"),
    ],
)
def test_what_cannot_be_predicted_is_refused(robot: Robot, sensors: list[WrenchSensor], message: str) -> None:
    with pytest.raises(InputError, match=message):
        MeasurementModel(robot, [], sensors)


def test_an_effect_of_a_sensor_is_felt_at_the_axis_that_its_parameter_names() -> None:
    """Whatever the order of the axes."""
    robot = Robot(urdf("panda.urdf"), cuts=["panda_hand"])
    sensor = WrenchSensor("/wrist", "panda_hand", "mounted", ("tz", "fx", "fy"))
    model = MeasurementModel(robot, [identified_effect("wrench_offset")], [sensor])
    offsets = {"fx": 3.0, "fy": -2.0, "tz": 0.5}
    assert [c.parameter for c in model.coefficients] == ["tz", "fx", "fy"]
    samples = random_samples(robot, seed=11, sensors=1)
    shown = [*model.nominal_inertias, *(offsets[c.parameter] for c in model.coefficients)]
    without = [*model.nominal_inertias, 0.0, 0.0, 0.0]
    _, predicted = model.predict(samples, np.array(shown))
    added = (predicted - model.predict(samples, np.array(without))[1])[:, -3:]
    np.testing.assert_allclose(added, np.tile([0.5, 3.0, -2.0], (len(samples), 1)), atol=1e-9)


def test_rows_are_the_same_whether_samples_carry_the_effects_of_motion_or_not() -> None:
    robot = Robot(urdf("panda.urdf"), cuts=["panda_hand"])
    names = ("viscous_friction", "coulomb_friction", "load_friction", "wrench_offset")
    sensor = WrenchSensor("/wrist", "panda_hand", "mounted", ("tz", "fx", "fy"))
    model = MeasurementModel(robot, [identified_effect(name) for name in names], [sensor])
    samples = random_samples(robot, seed=12, sensors=1)
    entries = Entries(model.columns, len(robot.joints))
    carrying = replace(samples, effects=entries.values(samples.motion), entries=entries)
    expected, found = model.rows(samples), model.rows(carrying)
    np.testing.assert_array_equal(found.coefficients, expected.coefficients)
    np.testing.assert_array_equal(found.targets, expected.targets)
    assert np.all(np.any(found.coefficients[:, :, -len(model.coefficients) :], axis=(0, 1)))
    chosen, links = np.arange(len(model.coefficients))[1::2], np.arange(len(model.nominal_inertias))
    fewer = model.with_coefficients(chosen.tolist()).rows(carrying)
    left = np.append(links, len(links) + chosen)
    np.testing.assert_array_equal(fewer.coefficients, expected.coefficients[:, :, left])
