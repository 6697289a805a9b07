"""Base poses: filtered and differentiated on SE(3)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.model import se3
from geomid_ros.model.samples import Samples
from geomid_ros.signals.kernels import derivative_kernels
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, IntArray

from .feeding import feed, in_time, pipeline_of, regular, seconds
from .sent import JointMessage, PoseMessage

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


def test_the_world_frame_does_not_matter() -> None:
    """Moved to another world, all poses move with it, and body twists stay."""
    move = pin.SE3(pin.exp3(np.array([2.0, -1.0, 1.5])), np.array([-3.0, 10.0, 4.0]))
    here, there = wandered(), flown(lambda time: move * wandering(time))
    np.testing.assert_allclose(there.base_velocity, here.base_velocity, rtol=0, atol=1e-9)
    np.testing.assert_allclose(there.base_acceleration, here.base_acceleration, rtol=0, atol=1e-8)
    for ours, theirs in zip(here.base_pose, there.base_pose, strict=True):
        error = pin.log6((move * pin.XYZQUATToSE3(ours)).actInv(pin.XYZQUATToSE3(theirs)))
        np.testing.assert_allclose(error.vector, 0.0, rtol=0, atol=1e-9)


def test_quaternions_may_be_rounded() -> None:
    """Lengths off by up to half a percent (single precision, careless drivers) are made good."""
    rounded = flown(wandering, factors=np.random.default_rng(2).uniform(0.995, 1.005, len(STAMPS)))
    for kind in ("base_pose", "base_velocity", "base_acceleration"):
        np.testing.assert_allclose(getattr(rounded, kind), getattr(wandered(), kind), rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.0999, 0.1001, 1.0, 3.0, 3.1415])
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
