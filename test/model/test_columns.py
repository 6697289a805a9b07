"""Columns of effects: all of them at once are each by itself."""

import numpy as np
from new_effects.supply_sag import SupplySag

from geomid_ros.model.columns import Column, Columns, Entries, JointColumn, PlacedColumn
from geomid_ros.model.effects import AtJoint, AtJoints, Motion, OnRobot
from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.coupled_motor import CoupledRotorInertia, CoupledViscousFriction
from geomid_ros.model.effects.spring import Spring

MOTION = Motion(*np.random.default_rng(3).standard_normal((3, 7, 4)))


COLUMNS: tuple[Column, ...] = (
    PlacedColumn(CoupledViscousFriction(), AtJoints(2, 3)),
    JointColumn(CoulombFriction()),
    PlacedColumn(SupplySag(), OnRobot()),
    PlacedColumn(CoupledViscousFriction(), AtJoints(0, 2)),
    PlacedColumn(CoupledRotorInertia(), AtJoints(1, 2)),
    PlacedColumn(Spring(), AtJoint(3)),
)


def test_each_column_is_what_it_is_by_itself() -> None:
    values = Columns(COLUMNS).values(MOTION)
    assert values.shape == (7, 4, len(COLUMNS))
    for place, column in enumerate(COLUMNS):
        np.testing.assert_array_equal(values[:, :, place], column.values(MOTION))


def test_only_what_a_column_reaches_is_kept() -> None:
    entries = Entries(Columns(COLUMNS), 4)
    assert len(entries) == 2 + 4 + 4 + 2 + 2 + 1
    assert np.all(entries.values(MOTION))


def test_no_columns_have_no_entries() -> None:
    entries = Entries(Columns(), 4)
    assert entries.spread(entries.values(MOTION)).shape == (7, 4, 0)
