"""Where effects are looked for that nobody said are there."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from new_effects.coaxial_friction import CoaxialFriction
from new_effects.supply_sag import SupplySag

from geomid_ros.model.effects import EFFECTS, AtJoint, AtJoints, Effect, Motion, OnRobot, identifiable
from geomid_ros.model.effects.drive import (
    CROSSINGS,
    Backlash,
    CoupledRotorInertia,
    CoupledViscousFriction,
    JointElasticity,
    Spring,
)
from geomid_ros.model.effects.effect import JointEffect
from geomid_ros.model.effects.friction import CoulombFriction, LoadFriction, StribeckFriction
from geomid_ros.model.effects.sensor_errors import EffortGain
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Column, Entries, JointColumn, PlacedColumn, Samples, affected_joints
from geomid_ros.types import FloatArray

from .robots import fixed_base, urdf

COUPLED = identifiable()["coupled_viscous_friction"]


def pairs(name: str, *, asked_for: bool = False) -> set[str]:
    """Places of a motor that turns two joints, the joints by the ends of their names."""
    effects = {"effects": [COUPLED]} if asked_for else {"effects": [], "candidates": [COUPLED]}
    model = MeasurementModel(Robot(urdf(name)), **effects)  # type: ignore[arg-type]
    return {coefficient.place_name for coefficient in model.coefficients}


@pytest.mark.parametrize(
    ("name", "meeting"),
    [
        # The other axes of its arm are parallel.
        (
            "ur5_robot.urdf",
            {"shoulder_pan_joint+shoulder_lift_joint", "wrist_1_joint+wrist_2_joint", "wrist_2_joint+wrist_3_joint"},
        ),
        # Its elbow and its flange are beside the axes before them.
        (
            "panda.urdf",
            {"panda_joint1+panda_joint2", "panda_joint2+panda_joint3", "panda_joint5+panda_joint6"},
        ),
    ],
)
def test_a_motor_of_two_joints_is_looked_for_where_axes_meet(name: str, meeting: set[str]) -> None:
    assert pairs(name) == meeting


def test_a_motor_of_two_joints_is_at_all_that_follow_one_another_where_it_is_asked_for() -> None:
    joints = Robot(urdf("ur5_robot.urdf")).joint_names
    assert pairs("ur5_robot.urdf", asked_for=True) == {f"{a}+{b}" for a, b in pairwise(joints)}


MOTION = Motion(np.random.default_rng(3).standard_normal((3, 7, 4)))


def still(effects: FloatArray, entries: Entries) -> Samples:
    """Samples of joints at rest, in which nothing but these columns tells of a motion."""
    return fixed_base(np.arange(7), *np.zeros((4, 7, 4)), effects=effects, entries=entries)


COLUMNS: tuple[Column, ...] = (
    PlacedColumn(CoupledViscousFriction(), AtJoints(2, 3)),
    JointColumn(CoulombFriction()),
    PlacedColumn(SupplySag(), OnRobot()),
    PlacedColumn(CoupledViscousFriction(), AtJoints(0, 2)),
    PlacedColumn(CoaxialFriction(), AtJoints(1, 2)),
    PlacedColumn(CoupledRotorInertia(), AtJoints(1, 2)),
    PlacedColumn(Spring(), AtJoint(3)),
)


def test_each_column_is_what_it_is_by_itself() -> None:
    entries = Entries(COLUMNS, 4)
    carried = still(entries.values(MOTION), entries)
    assert len(entries) == 2 + 4 + 4 + 2 + 2 + 2 + 1, "only what a column reaches"
    for column in COLUMNS:
        np.testing.assert_array_equal(carried.column(column), column.values(MOTION))
        for joint in affected_joints(column.place, 4):
            entry = carried.effects[:, entries.at(column, joint)]
            np.testing.assert_array_equal(entry, column.values(MOTION)[:, joint])


def test_efforts_of_several_effects_are_added() -> None:
    """Two of one kind at one place, too; whether samples carry their columns or not."""
    columns, motion = Entries(COLUMNS[1:4], 4), MOTION.states
    moving = fixed_base(np.arange(7), *motion, np.zeros((7, 4)))
    effects = [
        (CoulombFriction(), AtJoint(2), 0.5),
        (CoulombFriction(), AtJoint(2), 0.25),
        (CoulombFriction(), AtJoint(0), -1.0),
        (SupplySag(), OnRobot(), 2.0),
        (CoupledViscousFriction(), AtJoints(2, 3), 3.0),
    ]
    expected = sum(value * effect.efforts(MOTION, place) for effect, place, value in effects)
    for samples in (moving, replace(moving, effects=columns.values(MOTION), entries=columns)):
        np.testing.assert_allclose(samples.efforts_of(effects), expected, atol=1e-12)


def test_joints_change_places_in_the_columns_of_their_own_motion() -> None:
    """A column of several joints is then the formula of the motion that is left."""
    entries, order = Entries(COLUMNS, 4), np.array([0, 3, 2, 1])
    changed = still(entries.values(MOTION), entries).with_joints(order)
    coulomb, pair = COLUMNS[1], COLUMNS[3]
    np.testing.assert_array_equal(changed.column(coulomb), coulomb.values(MOTION)[:, order])
    assert not np.any(changed.column(pair))


WITH_COEFFICIENTS = {name: cls() for name, cls in EFFECTS.items() if cls().parts}
DRAWS = 20_000


def coefficients_of(effect: Effect) -> np.ndarray:
    count = 6 if effect.place == "sensor" else sum(part.count for part in effect.parts)
    return np.array([0.5, 0.3, -0.2, 0.4, 0.6, -0.7])[:count]


@pytest.mark.parametrize("name", WITH_COEFFICIENTS)
def test_standard_deviations_are_those_of_parameters_of_random_coefficients(name: str) -> None:
    """Of coefficients whose errors belong together, as those of a spring and of its offset do."""
    effect = WITH_COEFFICIENTS[name]
    values = coefficients_of(effect)
    root = 1e-3 * np.random.default_rng(1).normal(size=(len(values), len(values)))
    draws = values + np.random.default_rng(2).standard_normal((DRAWS, len(values))) @ root.T
    parameters = np.array([list(effect.values(draw).values()) for draw in draws])
    found = list(effect.quantities(values, root @ root.T, usual_load=1.0).values())[: parameters.shape[1]]
    np.testing.assert_allclose([q.value for q in found], np.mean(parameters, axis=0), rtol=1e-3)
    np.testing.assert_allclose([q.std for q in found], np.std(parameters, axis=0), rtol=0.03)


def test_the_scanned_constant_is_as_sure_as_its_logarithm() -> None:
    speed = StribeckFriction(0.2).quantities(np.array([1.0, 0.5]), np.zeros((2, 2)), log_std=0.1)["speed"]
    assert (speed.value, speed.std) == (0.2, pytest.approx(0.02))
    play = Backlash(3).quantities(np.array([0.01]), np.array([[1e-6]]), log_std=0.2, usual_load=5.0)["drag"]
    assert play.value == pytest.approx(5.0 * CROSSINGS[3] / 0.01)
    assert play.std / play.value == pytest.approx(np.hypot(0.2, 0.1))


@pytest.mark.parametrize(
    ("effect", "possible", "absurd"),
    [
        (JointElasticity(), [0.8], [1.2]),
        (JointElasticity(), [-0.8], [-1.2]),
        (Backlash(), [0.15], [0.25]),
        (LoadFriction(), [0.9], [1.1]),
        (EffortGain(), [1.9], [2.1]),
        (EffortGain(), [-0.65], [-0.75]),
        (StribeckFriction(), [1.0, 3.5], [1.0, 4.5]),
        (Spring(), [1.0, 12.0], [1.0, 13.2]),
        (Spring(), [1.0, -12.0], [1.0, -13.2]),
    ],
    ids=lambda value: value.name if isinstance(value, Effect) else str(value),
)
def test_sizes_that_no_robot_has_are_absurd(effect: Effect, possible: list[float], absurd: list[float]) -> None:
    """A gear that gives a radian per N m, play of 0.2 rad, friction that lets no effort through, a third or thrice
    the effort, an excess of four times the level, a spring that rests two turns away."""
    assert not effect.is_out_of_range(np.array(possible))
    assert effect.is_out_of_range(np.array(absurd))


def usual_effect(name: str, effects: list[Effect], candidates: list[Effect]) -> Effect:
    model = MeasurementModel(Robot(urdf("ur5_robot.urdf")), effects, candidates=candidates)  # type: ignore[arg-type]
    return model.coefficients[model.usual_shapes[name, AtJoint(2), 0] - len(model.nominal_inertias)].effect


@pytest.mark.parametrize("cls", [CoulombFriction, StribeckFriction])
def test_the_usual_shape_of_a_candidate_is_near_to_all_of_its_grid(cls: type[JointEffect]) -> None:
    """Changes are searched with it, whatever the shape is. An effect that acts everywhere has its own."""
    speed = np.linspace(-0.5, 0.5, 101)
    motion = JointMotion(np.array([0.0 * speed, speed, 0.0 * speed]))
    grid = [*cls.coarse_grid()]
    columns = np.array([effect.column(motion) for effect in grid if isinstance(effect, JointEffect)])
    farthest = np.max(np.linalg.norm(columns[:, None] - columns, axis=2), axis=1)
    assert farthest[grid.index(usual_effect(cls.name, [], grid))] < farthest[0]
    assert usual_effect(cls.name, [grid[-1]], grid[:-1]) == grid[-1]
