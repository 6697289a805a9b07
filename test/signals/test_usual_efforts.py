"""A change of all efforts at once is suspicious if it is one of the unit: large, and of efforts that are there."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.signals.usual_efforts import CHUNK, UsualEfforts
from geomid_ros.types import FloatArray

JOINTS = 4


@pytest.fixture
def usual() -> tuple[UsualEfforts, FloatArray]:
    """Having learned from smooth efforts ``(N, joints)`` of ten newton metres."""
    times = 0.05 * np.arange(4 * CHUNK)
    efforts = 10.0 * np.sin(times[:, None] + np.arange(JOINTS))
    learned = UsualEfforts(np.full(JOINTS, 100.0))
    for part in np.split(efforts, 4):
        learned.add(part)
    return learned, efforts


def test_another_unit_is_suspicious_and_what_goes_on_is_not(usual: tuple[UsualEfforts, FloatArray]) -> None:
    learned, efforts = usual
    before, after = efforts[:-1], efforts[1:]
    assert not np.any(learned.jump(before, after))
    assert np.mean(learned.jump(before, -after)) > 0.5
