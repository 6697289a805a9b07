"""Columns of effects: all of them at once are each by itself."""

import numpy as np
from new_effects.coaxial_friction import CoaxialFriction
from new_effects.supply_sag import SupplySag

from geomid_ros.model.columns import Column, Entries, JointColumn, PlacedColumn
from geomid_ros.model.effects import AtJoint, AtJoints, Motion, OnRobot
from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.coupled_motor import CoupledRotorInertia, CoupledViscousFriction
from geomid_ros.model.effects.spring import Spring
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

MOTION = Motion(*np.random.default_rng(3).standard_normal((3, 7, 4)))


def still(effects: FloatArray, entries: Entries) -> Samples:
    """Samples of joints at rest, in which nothing but these columns tells of a motion."""
    nothing = np.zeros((7, 4))
    return Samples(
        stamps=np.arange(7),
        position=nothing,
        velocity=nothing,
        acceleration=nothing,
        effort=nothing,
        base_pose=nothing[:, :0],
        base_velocity=nothing[:, :0],
        base_acceleration=nothing[:, :0],
        wrenches=np.zeros((7, 0, 6)),
        effects=effects,
        entries=entries,
    )


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
    for column in COLUMNS:
        np.testing.assert_array_equal(carried.column(column), column.values(MOTION))


def test_only_what_a_column_reaches_is_kept() -> None:
    entries = Entries(COLUMNS, 4)
    assert len(entries) == 2 + 4 + 4 + 2 + 2 + 2 + 1
    assert np.all(entries.values(MOTION))


def test_joints_change_places_in_the_columns_of_their_own_motion() -> None:
    """A column of several joints is then the formula of the motion that is left."""
    entries, order = Entries(COLUMNS, 4), np.array([0, 3, 2, 1])
    changed = still(entries.values(MOTION), entries).with_joints(order)
    coulomb, pair = COLUMNS[1], COLUMNS[3]
    np.testing.assert_array_equal(changed.column(coulomb), coulomb.values(MOTION)[:, order])
    assert not np.any(changed.column(pair))
