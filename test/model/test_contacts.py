"""Feet whose forces nobody measures: rows that hold whatever the ground does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.errors import InputError
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import identified_effect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import Contact
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from .robots import GRAVITY, Reference, random_parameters, random_samples, urdf, with_values
from .test_joint_rows import assert_equal

QUADRUPEDS = pytest.mark.parametrize(
    ("name", "feet"),
    [
        ("go2.urdf", ("FL_foot", "FR_foot", "RL_foot", "RR_foot")),
        ("solo12.urdf", ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")),
    ],
)
RADIUS = 0.03
FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")


def go2(*feet: str, effects: Sequence[str] = (), radius: float = RADIUS) -> MeasurementModel:
    """A quadruped on these feet."""
    contacts = [Contact(foot, radius) for foot in feet]
    named = [identified_effect(effect) for effect in effects]
    return MeasurementModel(Robot(urdf("go2.urdf"), floating_base=True), named, contacts=contacts)


def standing(samples: Samples, feet: int = 1, share: float = 1.0, **arrays: FloatArray) -> Samples:
    """The samples with other arrays, and a ``share`` of the feet on the ground."""
    stands = np.random.default_rng(3).random((len(samples), feet)) < share
    return replace(with_values(samples, **arrays), standing=stands)


def bent(robot: Robot, seed: int) -> Samples:
    """Random samples with all knees bent."""
    samples = random_samples(robot, seed)
    knees = [1.4 * name.endswith(("calf_joint", "KFE")) for name in robot.joint_names]
    return with_values(samples, position=0.2 * samples.position - knees)


def on_the_ground(reference: Reference, samples: Samples, joints: tuple[str, ...], foot: str, seed: int) -> FloatArray:
    """Random forces of the ground at the lowest point of a round foot, as wrenches ``(N, 6)`` in the foot's frame."""
    forces = 50.0 * np.random.default_rng(seed).normal(size=(len(samples), 3))
    found = np.empty((len(samples), 6))
    for index, force in enumerate(forces):
        rotation = reference.placement(samples, index, joints, foot).rotation
        down, pushed = rotation.T @ [0.0, 0.0, -RADIUS], rotation.T @ force
        found[index] = [*pushed, *np.cross(down, pushed)]
    return found


@QUADRUPEDS
def test_forces_of_the_ground_drop_out_of_the_rows(name: str, feet: tuple[str, ...]) -> None:
    """Whatever the ground does to feet that stand, the base's rows say what else acts on the base, and the rows of the
    other legs say their efforts; with friction in the joints."""
    robot = Robot(urdf(name), floating_base=True)
    model = MeasurementModel(
        robot, [identified_effect("viscous_friction")], contacts=[Contact(foot, RADIUS) for foot in feet]
    )
    assert [channel.name for channel in model.channels[-6:]] == [
        f"base/{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz")
    ]
    bodies, friction = random_parameters(robot, seed=1), 0.3
    reference = Reference(urdf(name), floating_base=True)
    reference.set_inertias(dict(zip(robot.body_names, bodies, strict=True)))
    samples = bent(robot, seed=2)
    stands = standing(samples, len(feet), 0.6).standing
    wrenches = {
        foot: on_the_ground(reference, samples, robot.joint_names, foot, seed) * stood[:, None]
        for seed, (foot, stood) in enumerate(zip(feet, stands.T, strict=True))
    }
    base, efforts = reference.inverse_dynamics(samples, robot.joint_names, wrenches)
    samples = standing(samples, len(feet), 0.6, effort=efforts + friction * samples.velocity)
    measured, predicted = model.predict(samples, np.append(bodies, np.full(len(robot.joints), friction)))
    assert_equal((predicted - measured)[:, -6:], base)
    assert model.legs is not None
    for joints, stood in zip(model.legs.joints, stands.T, strict=True):
        assert np.all(np.isnan(measured[:, joints]) == stood[:, None])
        assert_equal(predicted[~stood][:, joints], measured[~stood][:, joints])


def test_a_leg_of_six_joints_has_a_flat_foot() -> None:
    """Forces and moments of the ground drop out of the base's rows."""
    name, feet = "talos_reduced.urdf", ("left_sole_link", "right_sole_link")
    robot, reference = Robot(urdf(name), floating_base=True), Reference(urdf(name), floating_base=True)
    model = MeasurementModel(robot, [], contacts=[Contact(foot) for foot in feet])
    samples = random_samples(robot, seed=2)
    knees = [name in ("leg_left_4_joint", "leg_right_4_joint") for name in robot.joint_names]
    samples = with_values(samples, position=0.2 * samples.position + knees)
    ground = 50.0 * np.random.default_rng(3).normal(size=(len(feet), len(samples), 6))
    base, efforts = reference.inverse_dynamics(samples, robot.joint_names, dict(zip(feet, ground, strict=True)))
    measured, predicted = model.predict(standing(samples, len(feet), effort=efforts), model.nominal_inertias)
    np.testing.assert_allclose((predicted - measured)[:, -6:], base, rtol=0.0, atol=1e-8 * np.max(np.abs(efforts)))


def test_a_leg_of_six_joints_that_hardly_tells_the_ground_says_nothing() -> None:
    """In a posture in which the moment on a foot takes all efforts, and turns of the hips beside it none."""
    robot = Robot(urdf("talos_reduced.urdf"), floating_base=True)
    model = MeasurementModel(robot, [], contacts=[Contact("left_sole_link")])
    samples = random_samples(robot, seed=2)
    position = 0.2 * samples.position
    leg = [robot.joint_names.index(f"leg_left_{number}_joint") for number in range(1, 7)]
    position[:, leg[3]] += 1.0
    position[1, leg] = 1.54, -0.49, -1.78, 1.66, 0.65, -0.18
    rows = model.rows(standing(samples, position=position))
    assert np.isnan(rows.targets[:, -6:]).any(axis=1).tolist() == [index == 1 for index in range(len(samples))]


def test_columns_of_effects_lose_the_ground_as_rows_do() -> None:
    """Column by column, what effects add to each channel is what the rows have of them where a target is left."""
    model = go2(*FEET, effects=["viscous_friction"])
    samples = bent(model.robot, seed=2)
    samples = standing(samples, len(FEET), 0.6, effort=samples.velocity)
    columns = [model.columns_of(samples, c.effect, c.place, c.index) for c in model.coefficients]
    model.eliminate_ground(samples, columns)
    rows = model.rows(samples)
    dense = np.zeros((*rows.targets.shape, len(columns)))
    for index, own in enumerate(columns):
        for channel, column in own.items():
            dense[:, channel, index] = column
    left = np.isfinite(rows.targets)
    assert_equal(dense[left], rows.coefficients[left][:, len(model.nominal_inertias) :])


def test_the_ground_loads_the_gears_of_legs_that_stand() -> None:
    """Friction in proportion to the load, ground included, drops out of the base's rows; what it adds to the load
    itself is of second order."""
    model, friction = go2(FEET[0], effects=["load_friction"]), 1e-6
    robot, reference = model.robot, Reference(urdf("go2.urdf"), floating_base=True)
    samples = bent(robot, seed=2)
    wrench = on_the_ground(reference, samples, robot.joint_names, "FL_foot", 3)
    base, efforts = reference.inverse_dynamics(samples, robot.joint_names, {"FL_foot": wrench})
    measured = efforts + friction * np.abs(efforts) * np.sign(samples.velocity)
    samples = standing(samples, effort=measured)
    targets, predicted = model.predict(samples, np.append(model.nominal_inertias, np.full(len(robot.joints), friction)))
    np.testing.assert_allclose((predicted - targets)[:, -6:], base, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(predicted[:, 3:-6], targets[:, 3:-6], rtol=0.0, atol=1e-8)


def test_a_foot_bears_what_its_leg_says() -> None:
    """By the URDF; a share of what each foot bears when all stand."""
    model = go2(*FEET)
    robot, reference = model.robot, Reference(urdf("go2.urdf"), floating_base=True)
    samples = bent(robot, seed=4)
    wrench = on_the_ground(reference, samples, robot.joint_names, "FR_foot", 5)
    efforts = reference.inverse_dynamics(samples, robot.joint_names, {"FR_foot": wrench})[1]
    assert model.legs is not None
    loads = model.legs.loads(with_values(samples, effort=efforts))
    share = pin.computeTotalMass(reference.model) * -GRAVITY[2] / 4
    np.testing.assert_allclose(loads[:, 1], np.linalg.norm(wrench[:, :3], axis=1) / share, rtol=1e-8)
    np.testing.assert_allclose(loads[:, [0, 2, 3]], 0.0, atol=1e-8)


def test_known_friction_of_a_leg_is_no_load_of_its_foot() -> None:
    """And under another gravity it stays known."""
    model = go2(*FEET, effects=["viscous_friction", "rotor_inertia"])
    samples, size = bent(model.robot, seed=4), len(model.nominal_inertias)
    known = np.append(np.full(size, np.nan), np.random.default_rng(1).uniform(0.5, 1.0, len(model.coefficients)))
    joints = [model.robot.joint_names.index(c.place_name) for c in model.coefficients]
    efforts = samples.effort.copy()
    for coefficient, joint, value in zip(model.coefficients, joints, known[size:], strict=True):
        viscous = coefficient.effect.name == "viscous_friction"
        efforts[:, joint] += value * (samples.velocity if viscous else samples.acceleration)[:, joint]
    moon, beside = np.array([0.0, 0.0, -1.62]), model.with_known_loads(known)
    for alone, informed in ((model, beside), (model.with_gravity(moon), beside.with_gravity(moon))):
        assert alone.legs is not None
        assert informed.legs is not None
        rubbed, expected = with_values(samples, effort=efforts), alone.legs.loads(samples)
        assert np.max(np.abs(alone.legs.loads(rubbed) - expected)) > 0.3
        np.testing.assert_allclose(informed.legs.loads(rubbed), expected, atol=1e-9)


def test_under_another_gravity_legs_are_of_that_robot() -> None:
    """Nothing is shared with the model that it is made of: both may be used at the same time."""
    model = go2(FEET[0], radius=0.0)
    samples = bent(model.robot, seed=7)
    moon = model.with_gravity(np.array([0.0, 0.0, -1.62]))
    direct = Robot(urdf("go2.urdf"), floating_base=True, gravity=np.array([0.0, 0.0, -1.62]))
    expected = MeasurementModel(direct, [], contacts=[Contact("FL_foot")])
    assert moon.legs is not None
    assert expected.legs is not None
    np.testing.assert_allclose(moon.legs.loads(samples), expected.legs.loads(samples))


@pytest.mark.parametrize(
    ("feet", "sensors", "message"),
    [
        (["FL_fot"], [], "unknown link of a contact 'FL_fot'. Did you mean 'FL_foot'"),
        (["FL_hip"], [], r"the leg of 'FL_hip' has too few joints \(1\): at least 3"),
        (["FL_foot", "FL_calf"], [], "'FL_foot' and 'FL_calf' share joint 'FL_hip_joint'"),
        (
            ["FL_foot"],
            [WrenchSensor("/foot", "FR_foot", "external")],
            "contacts and an external wrench sensor, '/foot', exclude each other",
        ),
    ],
)
def test_feet_that_cannot_be_are_refused(feet: list[str], sensors: list[WrenchSensor], message: str) -> None:
    robot = Robot(urdf("go2.urdf"), floating_base=True)
    with pytest.raises(InputError, match=message):
        MeasurementModel(robot, [], sensors, contacts=[Contact(foot) for foot in feet])


@pytest.mark.parametrize("text", ["", ":0.02", "foot:", "foot:wide", "foot:-1", "foot:nan"])
def test_another_form_of_a_contact_is_refused(text: str) -> None:
    assert (Contact.parse("foot"), Contact.parse("foot:0.02")) == (Contact("foot"), Contact("foot", 0.02))
    with pytest.raises(InputError, match="FRAME or FRAME:RADIUS"):
        Contact.parse(text)


@pytest.mark.parametrize(("knee", "known"), [(0.0, False), (-0.02, False), (-0.3, False), (-0.6, True), (-1.4, True)])
def test_a_straight_leg_tells_no_force(knee: float, known: bool) -> None:
    """Along the leg no joint feels it. The rows of the base are left out then, not those of other legs; no coefficient
    is no number."""
    model = go2("FL_foot", "FR_foot")
    robot, samples = model.robot, bent(model.robot, seed=4)
    position = samples.position.copy()
    position[:, robot.joint_names.index("FL_calf_joint")] = knee
    position[:, robot.joint_names.index("FL_thigh_joint")] = -0.5 * knee
    straight = with_values(samples, position=position)
    assert model.legs is not None
    forces, rows = model.legs.forces(straight), model.rows(standing(straight, 2))
    assert np.all(np.isfinite(forces[:, 0])) == known
    assert np.all(np.isfinite(forces[:, 1]))
    assert np.all(np.isnan(rows.targets[:, -6:])) == (not known)
    assert np.isfinite(rows.coefficients).all()
