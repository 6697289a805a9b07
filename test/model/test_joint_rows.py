"""Rows of joint efforts times parameters are the efforts of inverse dynamics, plus the effects' terms."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.model.effects import DEFAULT_EFFECTS, identified_effect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

from .robots import GRAVITY, Reference, random_parameters, random_samples, urdf, with_values

EXACT = 1e-9  # relative to the largest number of a channel

FIXED = pytest.mark.parametrize(
    "name",
    [
        "ur5_robot.urdf",
        "panda.urdf",  # prismatic fingers, a merged hand
        "kinova.urdf",  # continuous joints between others
        "double_pendulum_continuous.urdf",
        "talos_reduced.urdf",  # 32 joints, deep groups of fixed links
        "human.urdf",  # massless links between the joints
    ],
)


def assert_equal(actual: FloatArray, expected: FloatArray) -> None:
    sizes = np.max(np.abs(expected), axis=0)
    assert np.any(sizes > 0.0)
    np.testing.assert_allclose(actual / np.maximum(sizes, 1e-3), expected / np.maximum(sizes, 1e-3), rtol=0, atol=EXACT)


@FIXED
def test_any_bodies_give_the_efforts_of_a_robot_made_of_them(name: str) -> None:
    robot = Robot(urdf(name))
    parameters = random_parameters(robot, seed=2)
    reference = Reference(urdf(name))
    reference.set_inertias(dict(zip(robot.body_names, parameters, strict=True)))
    samples = random_samples(robot, seed=3)
    predicted = MeasurementModel(robot, []).predict(samples, parameters.ravel())[1]
    expected = reference.inverse_dynamics(samples, robot.joint_names)[1]
    assert_equal(predicted, expected)
    assert_equal(robot.joint_efforts(*robot.configuration(samples), parameters), expected)


def test_effects_add_their_terms() -> None:
    """Viscous c v, Coulomb c tanh(v / 0.02), rotor c a, offset c; positive ones first, each joint by joint."""
    robot = Robot(urdf("ur5_robot.urdf"))
    names = ["effort_offset", "rotor_inertia", "coulomb_friction", "viscous_friction"]
    model = MeasurementModel(robot, [identified_effect(name) for name in names])
    order = ["rotor_inertia", "coulomb_friction", "viscous_friction", "effort_offset"]
    assert [(c.effect.name, c.place_name) for c in model.coefficients] == [
        (name, joint) for name in order for joint in robot.joint_names
    ]
    assert (model.positives, model.dimension) == (18, 60 + 24)

    rotor, coulomb, viscous, offset = np.random.default_rng(4).normal(size=(4, 6))
    samples = random_samples(robot, seed=5)
    predicted = model.predict(samples, np.concatenate([model.nominal_inertias, rotor, coulomb, viscous, offset]))[1]
    efforts = Reference(urdf("ur5_robot.urdf")).inverse_dynamics(samples, robot.joint_names)[1]
    friction = viscous * samples.velocity + coulomb * np.tanh(samples.velocity / 0.02)
    assert_equal(predicted, efforts + rotor * samples.acceleration + friction + offset)


def test_the_gears_transmit_what_is_known_of_links() -> None:
    """A model has another last link; its friction and its motors' inertia load no gear."""
    robot = Robot(urdf("ur5_robot.urdf"))
    model = MeasurementModel(
        robot, [identified_effect(n) for n in ("viscous_friction", "rotor_inertia", "load_friction")]
    )
    samples = random_samples(robot, seed=4)
    links = np.full((len(robot.bodies), 10), np.nan)
    links[-1] = random_parameters(robot, seed=5)[-1]
    bodies = np.append(model.nominal_inertias[:-10], links[-1]).reshape(-1, 10)
    sizes = {"viscous_friction": 3.0, "rotor_inertia": 7.0, "load_friction": 0.1}
    known = np.append(links, [sizes[c.effect.name] for c in model.coefficients])
    by_load = [k for k, c in enumerate(model.coefficients, links.size) if c.effect.name == "load_friction"]
    moving = np.abs(samples.velocity) > 0.1
    for gravity in (GRAVITY, (3.0, -2.0, -9.0)):
        reference = Reference(urdf("ur5_robot.urdf"), gravity=gravity)
        reference.set_inertias(dict(zip(robot.body_names, bodies, strict=True)))
        rigid = reference.inverse_dynamics(samples, robot.joint_names)[1]
        expected = np.abs(rigid) * np.sign(samples.velocity)
        own = model.with_known_loads(known).with_gravity(np.array(gravity))
        found = np.einsum("njj->nj", own.rows(samples).coefficients[:, :, by_load])
        assert_equal(np.where(moving, found, 0.0), np.where(moving, expected, 0.0))
    assert model.with_known_loads(None) is model


def test_other_gravity_and_a_carried_body_come_in_any_order() -> None:
    robot, gravity = Robot(urdf("ur5_robot.urdf")), np.array([3.0, -2.0, -9.0])
    model = MeasurementModel(robot, [identified_effect(name) for name in ("viscous_friction", "load_friction")])
    samples = random_samples(robot, seed=7)
    before = model.with_coefficients(range(8)).with_payload("wrist_3_link").with_gravity(gravity)
    after = model.with_gravity(gravity).with_payload("wrist_3_link").with_coefficients(range(8))
    assert before.body_names == after.body_names == (*robot.body_names, "payload of wrist_3_link")
    assert before.dimension == after.dimension == 10 * len(before.body_names) + 8
    assert_equal(before.rows(samples).coefficients, after.rows(samples).coefficients)


def test_a_row_says_which_parameters_it_can_depend_on() -> None:
    """The columns of a channel are all that differ from zero, and on a serial arm no others are given."""
    robot = Robot(urdf("panda.urdf"))
    model = MeasurementModel(robot, [identified_effect(name) for name in DEFAULT_EFFECTS])
    rows = model.rows(random_samples(robot, seed=6)).coefficients
    for place, channel in enumerate(model.channels):
        outside = np.setdiff1d(np.arange(model.dimension), channel.columns)
        assert not np.any(rows[:, place, outside])
    assert [len(channel.columns) for channel in model.channels] == [10 * n + 4 for n in (9, 8, 7, 6, 5, 4, 3, 1, 1)]


def test_units_follow_the_joints_kind() -> None:
    model = MeasurementModel(Robot(urdf("panda.urdf")), [identified_effect(name) for name in DEFAULT_EFFECTS])
    assert [channel.unit for channel in model.channels] == ["N m"] * 7 + ["N"] * 2
    units = {(c.effect.name, c.unit) for c in model.coefficients}
    assert units == {
        ("viscous_friction", "N m s/rad"),
        ("viscous_friction", "N s/m"),
        ("coulomb_friction", "N m"),
        ("coulomb_friction", "N"),
        ("rotor_inertia", "kg m^2"),
        ("rotor_inertia", "kg"),
        ("effort_offset", "N m"),
        ("effort_offset", "N"),
    }


def test_a_continuous_joint_may_turn_for_ever() -> None:
    robot = Robot(urdf("kinova.urdf"))
    model = MeasurementModel(robot, [])
    samples = random_samples(robot, seed=7)
    turns = 2.0 * np.pi * np.array([joint.continuous for joint in robot.joints])
    assert np.count_nonzero(turns) == 3
    turned = with_values(samples, position=samples.position - 3.0 * turns)
    assert_equal(model.rows(turned).coefficients, model.rows(samples).coefficients)


def test_links_that_are_not_identified_keep_their_share() -> None:
    """With a subset of links, rows times its parameters plus the others' known share is the measurement."""
    robot = Robot(urdf("panda.urdf"))
    chosen = ["panda_link6", "panda_link3"]
    whole, part = (
        MeasurementModel(robot, [identified_effect("viscous_friction")]),
        MeasurementModel(robot, [], links=chosen),
    )
    assert part.body_names == ("panda_link3", "panda_link6")
    samples = random_samples(robot, seed=8)
    parameters = random_parameters(robot, seed=9)[:2]
    measured, predicted = part.predict(samples, parameters.ravel())

    reference = Reference(urdf("panda.urdf"))
    bodies = dict(zip(whole.body_names, whole.nominal_inertias.reshape(-1, 10), strict=True))
    reference.set_inertias(bodies | dict(zip(part.body_names, parameters, strict=True)))
    efforts = reference.inverse_dynamics(samples, robot.joint_names)[1]
    assert_equal(samples.effort - measured + predicted, efforts)
    np.testing.assert_array_equal(part.channels[5].columns, np.arange(10, 20))


def test_predicted_efforts_are_those_of_the_whole_robot_whatever_is_identified() -> None:
    robot = Robot(urdf("ur5_robot.urdf"))
    samples = random_samples(robot, 5)
    expected = Reference(urdf("ur5_robot.urdf")).inverse_dynamics(samples, robot.joint_names)[1]
    for links in (None, [robot.body_names[-1]], []):
        model = MeasurementModel(robot, [], links=links)
        assert_equal(model.predicted_efforts(samples, model.nominal_inertias), expected)
