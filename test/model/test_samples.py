"""Samples are cut at pauses, and nothing is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimation.arms import arm

from geomid_ros.model.effects import AtJoints
from geomid_ros.model.effects.drive import CoupledViscousFriction
from geomid_ros.model.effects.friction import CoulombFriction, ViscousFriction
from geomid_ros.model.samples import REGIMES, Entries, JointColumn, PlacedColumn, moves_one_way, regimes
from geomid_ros.types import FloatArray

from .robots import fixed_base

PERIOD = 10_000_000  # [ns]


@pytest.mark.parametrize(
    ("stamps", "lengths"),
    [
        ([0, 1, 2, 3, 5, 6, 7, 17, 18], [4, 3, 2]),
        ([0, 1, 2, 3], [4]),
        ([0, 1, 2, 5], [3, 1]),
        ([0, 9], [2]),
        ([4], [1]),
        ([], [0]),
    ],
)
def test_stretches_are_the_parts_between_pauses(stamps: list[int], lengths: list[int]) -> None:
    numbers = np.arange(float(len(stamps)))[:, None]
    whole = fixed_base(PERIOD * np.array(stamps, dtype=np.int64), *[numbers] * 4)
    parts = whole.segments()
    assert [len(part) for part in parts] == lengths
    np.testing.assert_array_equal(np.concatenate([part.stamps for part in parts]), whole.stamps)
    np.testing.assert_array_equal(np.concatenate([part.effort for part in parts]), whole.effort)


def test_columns_that_are_not_chosen_go() -> None:
    """Of effects: one of each joint's own motion, and one of two joints' motors."""
    own, pair = JointColumn(ViscousFriction()), PlacedColumn(CoupledViscousFriction(), AtJoints(0, 2))
    entries, rng = Entries((own, pair), 3), np.random.default_rng(3)
    motion, effects = rng.normal(size=(4, 50, 3)), rng.normal(size=(50, len(entries)))
    carried = fixed_base(PERIOD * np.arange(50), *motion, effects=effects, entries=entries)
    for chosen in ([pair], [own], [pair, own], []):
        kept = carried.with_columns([*chosen, JointColumn(CoulombFriction())])
        assert set(kept.entries.columns) == set(chosen)
        for column in chosen:
            np.testing.assert_array_equal(kept.column(column), carried.column(column))
        np.testing.assert_array_equal(kept.effort, carried.effort)


FAST, SLOW, STILL = range(REGIMES)


def regime(speeds: FloatArray) -> list[int]:
    """The regimes of a joint that moves at these speeds."""
    samples = arm("arm3", 0, seconds=1).samples.select(slice(0, len(speeds)))
    moving = replace(samples, velocity=np.tile(speeds[:, None], 3))
    found = regimes(moving)
    np.testing.assert_array_equal(found != STILL, moves_one_way(moving))
    return [int(each) for each in found[:, 0]]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_slower_a_joint_moves_the_later_its_regime(sign: float) -> None:
    assert regime(sign * np.array([2.0, 0.1, 0.05, 0.03, 0.012, 0.008, 0.0])) == [FAST] * 3 + [SLOW] * 2 + [STILL] * 2
