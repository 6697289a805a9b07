"""An IMU's messages: the base's motion, which way is up, and accelerations that are none of an accelerometer."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.model.moving_base import ImuMount
from geomid_ros.signals.ledger import meaning_of
from geomid_ros.signals.messages import IMU
from geomid_ros.signals.moving_base import NO_SPECIFIC_FORCE, TOO_SMALL
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray

from .feeding import assert_same, completed, feed, in_time, pipeline_of, regular, seconds
from .sent import ImuMessage, JointMessage, Message

GRAVITY = np.array([0.0, 0.0, -9.81])
STAMPS = regular(0.01, 6.0)
_STEP = 1e-4  # [s]


def pose(time: float) -> pin.SE3:
    """A trunk that tumbles, and is shaken sideways."""
    phase = 2.0 * np.pi * np.array([0.7, 1.1, 1.6]) * time
    return pin.SE3(pin.exp3(0.3 * np.sin(phase) + [0.0, 0.2, 0.8 * time]), 0.03 * np.cos(phase + 1.0))


@cache
def imu_numbers(time: float) -> FloatArray:
    """What an ideal IMU in the trunk's frame measures, as a message has it, by differences."""
    before, now, after = pose(time - _STEP), pose(time), pose(time + _STEP)
    turning = pin.log3(before.rotation.T @ after.rotation) / (2.0 * _STEP)
    moved = (after.translation - 2.0 * now.translation + before.translation) / _STEP**2
    numbers = np.zeros(37)
    numbers[13:16], numbers[25:28] = turning, now.rotation.T @ (moved - GRAVITY)
    return numbers


@cache
def messages(scale: float = 1.0) -> list[Message]:
    """Of the IMU, with its accelerations multiplied by ``scale``, and of a joint that stands by."""
    scales = np.ones(37)
    scales[25:28] = scale
    imu = [ImuMessage(int(stamp), scales * imu_numbers(float(seconds(stamp)))) for stamp in STAMPS]
    joints = [JointMessage(int(stamp), ("joint",), [0.0], [], [0.0]) for stamp in STAMPS]
    return in_time(joints, imu)


def new_pipeline() -> SignalPipeline:
    settings = SignalSettings(period=0.01, cutoff=10.0)
    return pipeline_of(
        ["joint"], floating_base=True, settings=settings, mount=ImuMount(np.eye(3), np.zeros(3), GRAVITY)
    )


def test_up_is_found_though_the_base_is_shaken() -> None:
    """Within a degree, while the specific force points elsewhere by five; and angular velocity, its derivative and
    the specific force are what was measured."""
    samples = feed(new_pipeline(), messages())
    assert len(samples) > 200
    true = [pose(float(time)).rotation for time in seconds(samples.stamps)]
    ups = np.array([rotation[2] for rotation in true])
    numbers = np.array([imu_numbers(float(time)) for time in seconds(samples.stamps)])
    forces = numbers[:, 25:28]
    found = np.array([pin.XYZQUATToSE3(each).rotation[2] for each in samples.base_pose])
    assert np.rad2deg(np.arccos(np.sum(found * ups, axis=1))).max() < 1.0
    shaken = forces / np.linalg.norm(forces, axis=1, keepdims=True)
    assert np.rad2deg(np.arccos(np.sum(shaken * ups, axis=1))).max() > 5.0
    falling = np.array([pin.XYZQUATToSE3(each).rotation.T @ GRAVITY for each in samples.base_pose])
    np.testing.assert_allclose(samples.base_acceleration[:, :3] - falling, forces, atol=0.02)
    np.testing.assert_allclose(samples.base_velocity[:, 3:], numbers[:, 13:16], atol=0.01)
    later, before = (
        np.array([imu_numbers(float(time) + step)[13:16] for time in seconds(samples.stamps)]) for step in (1e-3, -1e-3)
    )
    np.testing.assert_allclose(samples.base_acceleration[:, 3:], (later - before) / 2e-3, atol=0.1)


def test_samples_do_not_depend_on_how_many_messages_come_at_once() -> None:
    together, alone = new_pipeline(), new_pipeline()
    found = []
    for message in messages()[:800]:
        alone.push(message)
        samples = alone.collect()
        found += [samples] if samples is not None else []
    parts = type(found[0]).concatenate(found)
    assert_same(parts, type(parts).concatenate(list(completed(together, messages()[:800]))))


@pytest.mark.parametrize(
    ("scale", "fault"), [(1.0 / 9.81, TOO_SMALL), (0.0, TOO_SMALL), (2.5, NO_SPECIFIC_FORCE), (0.5, NO_SPECIFIC_FORCE)]
)
def test_an_acceleration_that_is_not_gravity_on_average_is_not_used(scale: float, fault: str) -> None:
    """It is a driver's fault, which the verdict names."""
    pipeline = new_pipeline()
    assert list(completed(pipeline, messages(scale))) == []
    (noted,) = pipeline.ledger.topics[IMU].noted
    assert noted == fault
    assert meaning_of(noted) == "driver error"


@pytest.mark.parametrize(("scale", "used"), [(0.72, True), (1.28, True), (0.66, False), (1.34, False)])
def test_up_to_three_tenths_of_gravity_may_be_a_bias(scale: float, used: bool) -> None:
    """The base is shaken: on average the acceleration is gravity to some hundredths."""
    assert bool(list(completed(new_pipeline(), messages(scale)))) == used


def test_what_is_levelled_is_forgotten() -> None:
    """Two seconds on, with what the filter needs."""
    pipeline = new_pipeline()
    feed(pipeline, messages())
    assert 200 <= len(pipeline._sampler._streams[IMU].segment._levelled.values) < 400 < len(STAMPS)


@pytest.mark.parametrize(("places", "value"), [([16], -1.0), ([28], -1.0), ([14], np.nan), ([25], np.inf)])
def test_messages_without_measurements_are_refused(places: Sequence[int], value: float) -> None:
    """A covariance of -1 says that there is none (sensor_msgs/Imu)."""
    numbers = imu_numbers(0.0).copy()
    numbers[places] = value
    pipeline = new_pipeline()
    pipeline.push(ImuMessage(int(STAMPS[0]), numbers))
    assert pipeline.ledger.topics[IMU].rejected.total() == 1
