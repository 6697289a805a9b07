"""In which regime a joint moves, of motions at known speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimation.arms import arm

from geomid_ros.model.samples import REGIMES, moves_one_way, regimes
from geomid_ros.types import FloatArray

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
