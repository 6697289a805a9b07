"""Base poses: filtered and differentiated on SE(3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from model.robots import fixed_base

from geomid_ros.model import se3
from geomid_ros.model.moving_base import ImuMount
from geomid_ros.model.samples import Samples
from geomid_ros.signals.kernels import derivative_kernels
from geomid_ros.signals.ledger import meaning_of
from geomid_ros.signals.messages import IMU
from geomid_ros.signals.moving_base import NO_GRAVITY, TURNS_OTHERWISE, Stance
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, IntArray

from .feeding import assert_same, completed, feed, in_time, pipeline_of, regular, seconds
from .sent import ImuMessage, JointMessage, Message, PoseMessage

STAMPS = regular(0.01, 3.0)
Trajectory = Callable[[float], pin.SE3]


def flown(trajectory: Trajectory, stamps: IntArray = STAMPS, factors: FloatArray | float = 1.0) -> Samples:
    """Samples of a base on this trajectory (one joint stands by), with quaternions times ``factors (N,)``."""
    poses = []
    for stamp, factor in zip(stamps, np.broadcast_to(factors, len(stamps)), strict=True):
        pose = pin.SE3ToXYZQUAT(trajectory(float(seconds(stamp))))
        pose[3:] *= factor
        poses.append(PoseMessage(int(stamp), pose))
    joints = [JointMessage(int(stamp), ("joint",), [0.0], [], [0.0]) for stamp in STAMPS]
    pipeline = pipeline_of(["joint"], floating_base=True, settings=SignalSettings(period=0.01))
    return feed(pipeline, in_time(joints, poses))


def wandering(time: float) -> pin.SE3:
    """A smooth flight: translation and rotation vector are sines of up to 0.9 Hz."""
    phase = 2.0 * np.pi * np.array([0.3, 0.5, 0.9]) * time
    return pin.SE3(pin.exp3(0.5 * np.sin(phase)) @ pin.exp3(np.array([0.0, 0.0, 0.8 * time])), 0.3 * np.cos(phase))


@cache
def wandered() -> Samples:
    return flown(wandering)


def test_a_flight_is_differentiated() -> None:
    """Against central differences of the trajectory itself, by pinocchio's logarithm; body axes, (linear, angular)."""
    samples = flown(wandering, factors=np.random.default_rng(0).choice([-1.0, 1.0], len(STAMPS)))
    step = 1e-4

    def twist(time: float) -> FloatArray:
        return pin.log6(wandering(time - step).actInv(wandering(time + step))).vector / (2.0 * step)

    times = seconds(samples.stamps)
    velocity = np.array([twist(t) for t in times])
    acceleration = np.array([(twist(t + step) - twist(t - step)) / (2.0 * step) for t in times])
    for found, expected in ((samples.base_velocity, velocity), (samples.base_acceleration, acceleration)):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-2 * np.max(np.abs(expected)))
    errors = [
        pin.log6(pin.XYZQUATToSE3(pose).actInv(wandering(t))).vector
        for pose, t in zip(samples.base_pose, times, strict=True)
    ]
    np.testing.assert_allclose(errors, 0.0, rtol=0, atol=5e-3)


def test_the_filtered_pose_is_the_mean_on_the_group() -> None:
    """Seen from it, the kernel-weighted logarithms of its neighbours cancel; their derivatives are the motion."""
    kernels = derivative_kernels(5.0, 0.01)
    half = kernels.shape[1] // 2
    samples = wandered()
    for index in (0, 20, 55):
        pose = pin.XYZQUATToSE3(samples.base_pose[index])
        times = seconds(samples.stamps[index]) + 0.01 * np.arange(-half, half + 1)
        logarithms = np.array([pin.log6(pose.actInv(wandering(float(time)))).vector for time in times])
        mean, velocity, acceleration = kernels @ logarithms
        np.testing.assert_allclose(mean, 0.0, rtol=0, atol=1e-10)
        np.testing.assert_allclose(samples.base_velocity[index], velocity, rtol=0, atol=1e-8)
        np.testing.assert_allclose(samples.base_acceleration[index], acceleration, rtol=0, atol=1e-6)


def test_quaternions_may_be_rounded() -> None:
    """Lengths off by up to half a percent (single precision, careless drivers) are made good."""
    rounded = flown(wandering, factors=np.random.default_rng(2).uniform(0.995, 1.005, len(STAMPS)))
    for kind in ("base_pose", "base_velocity", "base_acceleration"):
        np.testing.assert_allclose(getattr(rounded, kind), getattr(wandered(), kind), rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.0999, 0.1001, 3.1415])
def test_the_logarithm_is_pinocchios(angle: float) -> None:
    """Near and far, across the switch to the series, whatever the quaternions' signs."""
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(20, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    reference = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    moves = [pin.SE3(pin.exp3(angle * axis), rng.normal(size=3)) for axis in axes]
    poses = np.array([pin.SE3ToXYZQUAT(reference * move) for move in moves])
    poses[::2, 3:] *= -1.0
    expected = np.array([pin.log6(move).vector for move in moves])
    found = se3.relative_log(pin.SE3ToXYZQUAT(reference), poses)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    back = np.array([se3.compose_exp(pin.SE3ToXYZQUAT(reference), twist) for twist in found])
    cosines = np.abs(np.sum(back[:, 3:] * poses[:, 3:], axis=1))
    np.testing.assert_allclose(cosines, 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(back[:, :3], poses[:, :3], rtol=0, atol=1e-12)


GRAVITY = np.array([0.0, 0.0, -9.81])
IMU_STAMPS = regular(0.01, 6.0)
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
def messages(scale: float = 1.0, turning: float = 1.0) -> list[Message]:
    """Of the IMU, with its accelerations multiplied by ``scale`` and its angular velocities by ``turning``, and of a
    joint that stands by."""
    scales = np.ones(37)
    scales[25:28], scales[13:16] = scale, turning
    imu = [ImuMessage(int(stamp), scales * imu_numbers(float(seconds(stamp)))) for stamp in IMU_STAMPS]
    joints = [JointMessage(int(stamp), ("joint",), [0.0], [], [0.0]) for stamp in IMU_STAMPS]
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
    for message in messages()[:600]:
        alone.push(message)
        samples = alone.collect()
        found += [samples] if samples is not None else []
    parts = type(found[0]).concatenate(found)
    assert_same(parts, type(parts).concatenate(list(completed(together, messages()[:600]))))


@pytest.mark.parametrize(
    ("scale", "fault"),
    [
        (1.0 / 9.81, NO_GRAVITY),
        (0.0, NO_GRAVITY),
        (0.66, NO_GRAVITY),
        (1.34, NO_GRAVITY),
        (0.72, ""),
        (1.28, ""),
    ],
)
def test_an_acceleration_that_is_not_gravity_on_average_is_not_used(scale: float, fault: str) -> None:
    """It is a driver's fault, which the verdict names. Up to three tenths of gravity may be a bias: the base is shaken,
    on average the acceleration is gravity to some hundredths."""
    pipeline = new_pipeline()
    assert bool(list(completed(pipeline, messages(scale)))) == (fault == "")
    noted = [*pipeline.ledger.topics[IMU].noted]
    assert noted == [fault] * bool(fault)
    assert {meaning_of(each) for each in noted} <= {"driver error"}


def test_an_angular_velocity_that_does_not_turn_gravity_is_no_fault_of_the_acceleration() -> None:
    """In degrees per second."""
    pipeline = new_pipeline()
    assert not list(completed(pipeline, messages(turning=180.0 / np.pi)))
    assert [*pipeline.ledger.topics[IMU].noted] == [TURNS_OTHERWISE]


@pytest.mark.parametrize(("places", "value"), [([16], -1.0), ([28], -1.0), ([14], np.nan), ([25], np.inf)])
def test_messages_without_measurements_are_refused(places: Sequence[int], value: float) -> None:
    """A covariance of -1 says that there is none (sensor_msgs/Imu)."""
    numbers = imu_numbers(0.0).copy()
    numbers[places] = value
    pipeline = new_pipeline()
    pipeline.push(ImuMessage(int(IMU_STAMPS[0]), numbers))
    assert pipeline.ledger.topics[IMU].rejected.total() == 1


STEP = 10_000_000  # [ns]
CUTOFF = 20.0  # [Hz], of whose period samples are five


def samples_at(stamps: IntArray, loads: FloatArray) -> Samples:
    """Samples of as many joints as feet, whose efforts are what the feet bear."""
    return fixed_base(stamps, *np.zeros((3, *loads.shape)), loads)


def judged(samples: Samples, sizes: Sequence[int]) -> Samples:
    """What comes of samples, so many of which come at once."""
    stance, found = Stance(lambda each: each.effort, CUTOFF), []
    for end, size in zip(np.cumsum(sizes), sizes, strict=True):
        known = stance.with_stance(samples.select(slice(int(end) - size, int(end))))
        found += [known] if known is not None else []
    return Samples.concatenate(found)


def stepping(count: int = 60) -> Samples:
    """One foot is in the air from the 20th sample to the 40th, one bears a little all of the time, one nothing."""
    loads = np.ones((count, 3)) * [1.0, 0.2, 0.01]
    loads[20:41, 0] = 0.05
    return samples_at(STEP * np.arange(1, count + 1), loads)


def test_a_foot_swings_while_it_bears_nothing_a_period_before_and_after() -> None:
    found = judged(stepping(), [60])
    assert len(found) == 55  # the last ones are held: nobody knows what follows
    assert np.flatnonzero(~found.standing[:, 0]).tolist() == list(range(25, 36))
    assert found.standing[:, 1].all()
    assert not found.standing[:, 2].any()


@pytest.mark.parametrize(("load", "stands"), [(0.09, False), (0.11, True)])
def test_a_foot_is_in_the_air_below_a_tenth_of_its_share(load: float, stands: bool) -> None:
    found = judged(samples_at(STEP * np.arange(1, 21), np.full((20, 1), load)), [20])
    assert np.all(found.standing == stands)


def test_what_is_not_known_stands() -> None:
    loads = np.full((20, 1), 0.01)
    loads[10] = np.nan
    found = judged(samples_at(STEP * np.arange(1, 21), loads), [20])
    assert np.flatnonzero(found.standing[:, 0]).tolist() == list(range(5, 15))


@pytest.mark.parametrize("sizes", [[1] * 60, [7, 3, 20, 30], [58, 2], [26, 1, 33]])
def test_it_does_not_matter_how_many_come_at_once(sizes: list[int]) -> None:
    together, found = judged(stepping(), [60]), judged(stepping(), sizes)
    np.testing.assert_array_equal(found.stamps, together.stamps)
    np.testing.assert_array_equal(found.standing, together.standing)
    np.testing.assert_array_equal(found.effort, together.effort)


def test_after_a_pause_or_a_clock_set_back_nothing_of_before_counts() -> None:
    stamps = STEP * np.array([*range(1, 31), *range(1001, 1021), *range(101, 131)])
    loads = np.where(np.arange(80) < 30, 1.0, 0.0)[:, None]
    for sizes in ([80], [30, 20, 30], [1] * 80):
        found = judged(samples_at(stamps, loads), sizes)
        assert len(found) == 30 + 15 + 25  # held when the clock is set back, and at the end
        np.testing.assert_array_equal(found.standing[:, 0], found.effort[:, 0] > 0.5)
