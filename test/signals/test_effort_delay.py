"""Efforts that come late are put where they belong; all else stays where it is."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.model.samples import Samples
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray

from .feeding import feed
from .sent import JointMessage

SMOOTH = 2e-3  # of a signal of size 1 after the filter
STAMPS = 1000.0 + 0.01 * np.arange(800)


def samples(effort_delay: float, stamps: FloatArray, late: float) -> Samples:
    """One joint at ``sin(3 t)`` whose efforts ``cos(3 t)`` are recorded ``late`` [s]."""
    pipeline = SignalPipeline(["a"], settings=SignalSettings(effort_delay=effort_delay))
    messages = []
    for stamp in stamps:
        position, velocity = [np.sin(3.0 * stamp)], [3.0 * np.cos(3.0 * stamp)]
        effort = [np.cos(3.0 * (stamp - late))]
        messages.append(JointMessage(round(1e9 * stamp), ("a",), position, velocity, effort))
    return feed(pipeline, messages)


@pytest.mark.parametrize("delay", [0.004, 0.03, -0.02])
def test_late_efforts_are_moved_back(delay: float) -> None:
    found = samples(delay, STAMPS, delay)
    times = 1e-9 * found.stamps
    np.testing.assert_allclose(found.position[:, 0], np.sin(3.0 * times), atol=SMOOTH)
    np.testing.assert_allclose(found.effort[:, 0], np.cos(3.0 * times), atol=SMOOTH)
    uncorrected = samples(0.0, STAMPS, delay)
    assert np.abs(uncorrected.effort[:, 0] - np.cos(3.0e-9 * uncorrected.stamps)).max() > abs(delay)


def test_a_pause_does_not_confuse_it() -> None:
    found = samples(0.03, np.delete(STAMPS, range(350, 450)), 0.03)
    assert np.diff(found.stamps).max() > 9e8
    np.testing.assert_allclose(found.effort[:, 0], np.cos(3.0e-9 * found.stamps), atol=SMOOTH)


@pytest.mark.parametrize("delay", [2.0, -1.5, np.nan, np.inf])
def test_a_delay_that_no_robot_has_is_refused(delay: float) -> None:
    with pytest.raises(InputError, match="effort_delay"):
        SignalSettings(effort_delay=delay)
