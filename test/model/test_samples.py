"""Samples are cut at pauses, and nothing is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimation.arms import arm

from geomid_ros.model.effects import AtJoints
from geomid_ros.model.effects.drive import CoupledViscousFriction
from geomid_ros.model.effects.friction import CoulombFriction, ViscousFriction
from geomid_ros.model.samples import REGIMES, Entries, JointColumn, PlacedColumn, Samples, moves_one_way, regimes
from geomid_ros.types import FloatArray

PERIOD = 10_000_000  # [ns]


def samples(stamps: list[int]) -> Samples:
    nothing = np.zeros((len(stamps), 0))
    numbers = np.arange(float(len(stamps)))[:, None]
    motion = [numbers] * 4
    return Samples(PERIOD * np.array(stamps, dtype=np.int64), *motion, nothing, nothing, nothing, nothing[:, None])


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
    whole = samples(stamps)
    parts = whole.segments()
    assert [len(part) for part in parts] == lengths
    np.testing.assert_array_equal(np.concatenate([part.stamps for part in parts]), whole.stamps)
    np.testing.assert_array_equal(np.concatenate([part.effort for part in parts]), whole.effort)


class TestColumns:
    """Of effects: one of each joint's own motion, and one of two joints' motors."""

    OWN, PAIR = JointColumn(ViscousFriction()), PlacedColumn(CoupledViscousFriction(), AtJoints(0, 2))
    ENTRIES = Entries((OWN, PAIR), 3)

    @pytest.fixture
    def carried(self) -> Samples:
        rng = np.random.default_rng(3)
        motion = rng.normal(size=(4, 50, 3))
        nothing = np.zeros((50, 0))
        effects = rng.normal(size=(50, len(self.ENTRIES)))
        stamps = PERIOD * np.arange(50)
        return Samples(stamps, *motion, nothing, nothing, nothing, nothing[:, None], effects, self.ENTRIES)

    def test_columns_that_are_not_chosen_go(self, carried: Samples) -> None:
        for chosen in ([self.PAIR], [self.OWN], [self.PAIR, self.OWN], []):
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
