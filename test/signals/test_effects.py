"""Effects' columns go through the filter as the efforts do: friction's jump at a reversal is the same in both.

Efforts that come late are put where they belong; all else stays where it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.model.effects.drive import RotorInertia, Spring
from geomid_ros.model.effects.friction import DISTANCES, CoulombFriction, Presliding, ViscousFriction
from geomid_ros.model.effects.sensor_errors import EffortOffset
from geomid_ros.model.samples import JointColumn, Samples
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, IntArray

from . import feeding
from .feeding import JOINTS, Motion, assert_same, feed, joint_messages, pipeline_of, regular
from .sent import JointMessage

COLUMNS = tuple(
    JointColumn(effect)
    for effect in (ViscousFriction(), CoulombFriction(0.02), RotorInertia(), EffortOffset(), Spring())
)


def columns(position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Viscous and Coulomb friction, rotor inertia, offset, and a spring, by their formulas ``(N, J, 5)``."""
    return np.stack([velocity, np.tanh(velocity / 0.02), acceleration, np.ones_like(position), position], axis=2)


def pipeline(period: float = 0.008) -> SignalPipeline:
    return pipeline_of(JOINTS, settings=SignalSettings(period=period), effect_columns=COLUMNS)


def with_efforts(stamps: IntArray, efforts: FloatArray) -> list[JointMessage]:
    """Messages with these efforts, never exactly the same twice: that would be a saturated sensor."""
    different = efforts + 1e-9 * np.arange(len(efforts))[:, None]
    return [replace(m, effort=e) for m, e in zip(joint_messages(stamps), different, strict=True)]


@pytest.mark.parametrize("effects", [(0, 1, 2), (3, 4, 1)])
def test_a_column_is_what_an_effort_of_that_effect_becomes(effects: tuple[int, ...]) -> None:
    """The effort of each joint is an effect's formula on the true motion: filtered, it equals the effect's column."""
    stamps, motion = regular(0.008, 8.0), Motion()
    every = columns(*(motion.derivative(stamps, order) for order in range(3)))
    truth = np.stack([every[:, joint, effect] for joint, effect in enumerate(effects)], axis=1)
    samples = feed(pipeline(), with_efforts(stamps, truth))
    assert samples.effects.shape == (len(samples), 3 * 5)
    for joint, effect in enumerate(effects):
        error = samples.column(COLUMNS[effect])[:, joint] - samples.effort[:, joint]
        assert np.max(np.abs(error)) < 0.02 * np.max(np.abs(truth[:, joint]))


def test_what_an_effect_remembers_does_not_depend_on_the_blocks_in_which_messages_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every joint reverses several times; what is remembered begins with nothing."""
    effect = Presliding(DISTANCES[-1])
    column, stamps, motion = JointColumn(effect), regular(0.008, 8.0), Motion()
    position = motion.derivative(stamps, 0)
    moved = np.diff(position, axis=0, prepend=position[:1])
    truth = Presliding.states([effect], moved, np.zeros((1, 3)))[:, 0] - np.tanh(motion.derivative(stamps, 1) / 0.003)
    found = []
    for count in (feeding.AT_ONCE, 7):
        monkeypatch.setattr(feeding, "AT_ONCE", count)
        own = pipeline_of(JOINTS, settings=SignalSettings(period=0.008), effect_columns=(column,))
        found.append(feed(own, with_efforts(stamps, truth)))
    assert_same(found[0], found[1], tolerance=1e-12)
    error = found[0].column(column) - found[0].effort
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.std(truth)


SMOOTH = 2e-3  # of a signal of size 1 after the filter
STAMPS = 1000.0 + 0.01 * np.arange(800)


def samples(effort_delay: float, stamps: FloatArray, late: float) -> Samples:
    """One joint at ``sin(3 t)`` whose efforts ``cos(3 t)`` are recorded ``late`` [s]."""
    pipeline = pipeline_of(["a"], settings=SignalSettings(effort_delay=effort_delay))
    messages = []
    for stamp in stamps:
        position, velocity = [np.sin(3.0 * stamp)], [3.0 * np.cos(3.0 * stamp)]
        effort = [np.cos(3.0 * (stamp - late))]
        messages.append(JointMessage(round(1e9 * stamp), ("a",), position, velocity, effort))
    return feed(pipeline, messages)


@pytest.mark.parametrize("delay", [0.03, -0.02])
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
