"""Robots that move as they are told, and what their sensors say of it: pinocchio's recursive algorithm, planted bodies.

Nothing here uses the regressors or the signal pipeline under test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from files.recordings import Recorded, made, stamped
from model.robots import Reference

from benchmarks.moving_base import moving_base
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

START = 1_700_000_000
SECOND = 1_000_000_000
_TONES = 4
_FREQUENCIES = (0.15, 1.0)  # [Hz]
_MOVED = 0.1  # [m] times half the relative error: how far a centre of mass is moved
VISCOUS, COULOMB = 0.3, 0.5
"""Planted friction at every joint [N m s/rad], [N m]."""


class InMotion:
    """A robot with other bodies than its URDF says, in a motion of sinusoids that begins anywhere.

    ``cuts`` are the links on which a wrench sensor is mounted, ``locked`` the joints that never move.
    """

    def __init__(
        self,
        urdf: str,
        *,
        duration: float,
        rate: float,
        seed: int,
        floating_base: bool = False,
        cuts: Sequence[str] = (),
        locked: Sequence[str] = (),
        begin: float = 0.0,
        swing: float | FloatArray = 0.5,
        error: float = 0.2,
    ) -> None:
        """``duration`` and ``begin`` [s], ``rate`` [Hz], ``swing``: a joint's largest excursion [rad or m], ``error``:
        how far the bodies are from the URDF's, about the relative standard deviation of a mass.

        The same ``seed`` gives the same robot in the same motion, whatever part of it is asked for.
        """
        rng = np.random.default_rng(seed)
        self.robot = Robot(urdf, floating_base=floating_base, cuts=cuts, locked_joints=locked)
        self.joints = self.robot.joint_names
        self.truth = {body.name: _another(body.parameters, rng, error) for body in self.robot.bodies}
        self.reference = Reference(urdf, floating_base=floating_base)
        self.reference.set_inertias(self.truth)
        times = begin + np.arange(round(duration * rate)) / rate
        self.stamps = [START * SECOND + round(time * SECOND) for time in times.tolist()]
        joints = _sines(times, *self._excursions(swing), rng)
        base = _sines(times, np.zeros(6), np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3]), rng)
        self.samples = _samples(joints, base, floating_base)

    def _excursions(self, swing: float) -> tuple[FloatArray, FloatArray]:
        """Middle and amplitude of every joint, within its limits."""
        model = self.reference.model
        at = [model.joints[model.getJointId(joint)].idx_q for joint in self.joints]
        low, high = np.maximum(model.lowerPositionLimit[at], -10.0), np.minimum(model.upperPositionLimit[at], 10.0)
        amplitudes = np.minimum(swing, 0.45 * (high - low))
        return np.clip(0.3, low + amplitudes, high - amplitudes), amplitudes

    def efforts(self, wrenches: Mapping[str, FloatArray] | None = None, friction: bool = True) -> FloatArray:
        """Efforts ``(T, joints)``, with ``wrenches (T, 6)`` on links."""
        _, efforts = self.reference.inverse_dynamics(self.samples, self.joints, wrenches)
        if not friction:
            return efforts
        return efforts + VISCOUS * self.samples.velocity + COULOMB * np.sign(self.samples.velocity)

    def carried(self, link: str) -> FloatArray:
        """Newton and Euler for the bodies from ``link`` on: the wrench on them all ``(T, 6)``, in the link's frame."""
        bodies = [self.robot.body_names[index] for index in self.robot.subtree(link)]
        wrenches = []
        for index in range(len(self.samples)):
            here = self.reference.placement(self.samples, index, self.joints, link)
            wrenches.append(sum((here.actInv(self._force(index, body)) for body in bodies), pin.Force.Zero()).vector)
        return np.array(wrenches)

    def _force(self, index: int, link: str) -> pin.Force:
        """What moves a body and holds it up at one instant, about the world's origin."""
        body = pin.Inertia.FromDynamicParameters(self.truth[link])
        placed = self.reference.placement(self.samples, index, self.joints, link)
        velocity, acceleration = map(pin.Motion, self.reference.motion(self.samples, index, self.joints, link))
        lift = pin.Motion(placed.rotation.T @ np.array([0.0, 0.0, 9.81]), np.zeros(3))
        return placed.act(body * (acceleration + lift) + velocity.cross(body * velocity))

    def on_ground(self) -> FloatArray:
        """What a plate feels under the whole robot ``(T, 6)``, about the world's origin."""
        base, _ = self.reference.inverse_dynamics(self.samples, self.joints)
        poses = map(pin.XYZQUATToSE3, self.samples.base_pose)
        return np.array([pose.act(pin.Force(force)).vector for pose, force in zip(poses, base, strict=True)])

    def on_feet(self, feet: Sequence[str]) -> dict[str, FloatArray]:
        """Forces on point feet, the least that carry the robot: wrenches ``(T, 6)`` in the frames of the ``feet``."""
        ground = self.on_ground()
        wrenches = {foot: np.zeros((len(self.samples), 6)) for foot in feet}
        for index in range(len(self.samples)):
            placements = [self.reference.placement(self.samples, index, self.joints, foot) for foot in feet]
            effect = np.hstack([np.vstack([np.eye(3), pin.skew(placed.translation)]) for placed in placements])
            forces = np.linalg.lstsq(effect, ground[index], rcond=None)[0].reshape(-1, 3)
            for foot, placed, force in zip(feet, placements, forces, strict=True):
                wrenches[foot][index, :3] = placed.rotation.T @ force
        return wrenches

    def joint_states(
        self, efforts: FloatArray, joints: Sequence[str] | None = None, topic: str = "/joint_states"
    ) -> list[Recorded]:
        """Joint messages, of all or some of the ``joints``, in that order."""
        names = list(joints or self.joints)
        at = [self.joints.index(name) for name in names]
        moving = np.array([self.samples.position[:, at], self.samples.velocity[:, at], efforts[:, at]])
        return [
            self._recorded(topic, "sensor_msgs/msg/JointState", k, name=names, position=q, velocity=v, effort=effort)
            for k, (q, v, effort) in enumerate(zip(*moving, strict=True))
        ]

    def wrenches(self, topic: str, frame: str, wrenches: FloatArray) -> list[Recorded]:
        """Wrench messages."""
        return [
            self._recorded(
                topic, "geometry_msgs/msg/WrenchStamped", k, frame, wrench={"force": row[:3], "torque": row[3:]}
            )
            for k, row in enumerate(wrenches.tolist())
        ]

    def odometry(self, topic: str = "/odom") -> list[Recorded]:
        """Poses of the base; the twist is left at zero, as it is not needed."""
        return [
            self._recorded(
                topic,
                "nav_msgs/msg/Odometry",
                k,
                "odom",
                child_frame_id="base",
                pose={"pose": {"position": pose[:3], "orientation": pose[3:]}},
            )
            for k, pose in enumerate(self.samples.base_pose.tolist())
        ]

    def imu(self, topic: str, frame: str) -> list[Recorded]:
        """What an IMU on a link measures; its orientation is left out, which a covariance of -1 says."""
        unknown, found = np.append(-1.0, np.zeros(8)), []
        for k in range(len(self.stamps)):
            rotation = self.reference.placement(self.samples, k, self.joints, frame).rotation
            velocity, acceleration = self.reference.motion(self.samples, k, self.joints, frame)
            force = acceleration[:3] + np.cross(velocity[3:], velocity[:3]) + rotation.T @ np.array([0.0, 0.0, 9.81])
            sensed = {"angular_velocity": velocity[3:].tolist(), "linear_acceleration": force.tolist()}
            found.append(
                self._recorded(topic, "sensor_msgs/msg/Imu", k, frame, orientation_covariance=unknown, **sensed)
            )
        return found

    def _recorded(self, topic: str, kind: str, index: int, frame: str = "", **fields: Any) -> Recorded:
        stamp = self.stamps[index]
        return Recorded(topic, kind, stamp, made(kind, header=stamped(stamp, frame), **fields))


def noisy(values: FloatArray, level: float, seed: int) -> FloatArray:
    """With white noise of this standard deviation."""
    return values + level * np.random.default_rng(seed).standard_normal(values.shape)


def in_time(*streams: Sequence[Recorded]) -> list[Recorded]:
    """All messages in the order of their time."""
    return sorted((item for stream in streams for item in stream), key=lambda item: item.time)


def _another(parameters: FloatArray, rng: np.random.Generator, error: float) -> FloatArray:
    """A body near another one: stretched, sheared and moved a little, and of another density."""
    change = np.eye(4)
    change[:3] += 0.5 * error * rng.normal(size=(3, 4)) * np.array([1.0, 1.0, 1.0, _MOVED])
    change[3, 3] += 0.5 * error * rng.normal()
    return np.asarray(pseudo_inertia.to_parameters(change @ pseudo_inertia.from_parameters(parameters) @ change.T))


def _sines(times: FloatArray, centres: FloatArray, amplitudes: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Position, velocity and acceleration ``(3, T, coordinates)``."""
    shape = (_TONES, len(centres))
    speeds = 2.0 * np.pi * rng.uniform(*_FREQUENCIES, size=shape)
    angles = speeds * times[:, None, None] + rng.uniform(0.0, 2.0 * np.pi, size=shape)
    sizes = amplitudes * rng.dirichlet(np.ones(_TONES), size=len(centres)).T
    position = centres + np.sum(sizes * np.sin(angles), axis=1)
    velocity = np.sum(sizes * speeds * np.cos(angles), axis=1)
    return np.array([position, velocity, -np.sum(sizes * speeds**2 * np.sin(angles), axis=1)])


def _samples(joints: FloatArray, base: FloatArray, floating_base: bool) -> Samples:
    """Of the base ``(3, T, 6)``: translation and rotation vector with derivatives."""
    count, empty = joints.shape[1], np.zeros((joints.shape[1], 0))
    of_base = moving_base(base) if floating_base else 3 * (empty,)
    nothing = np.full_like(joints[0], np.nan)
    return Samples(np.arange(1, count + 1), *joints, nothing, *of_base, np.zeros((count, 0, 6)))
