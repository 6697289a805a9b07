"""Robots of example-robot-data, random samples of them, and rigid-body dynamics by pinocchio's recursive algorithm.

Nothing here uses the regressors under test: bodies are set into a pinocchio model as its own ``Inertia`` objects, and
forces are carried from frame to frame by its ``SE3`` actions.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray

GRAVITY = (0.0, 0.0, -9.81)


@cache
def urdf(name: str) -> str:
    """The text of the one URDF of example-robot-data whose path ends with ``/name``, all its joints free to move (of
    those that mimic others: ``test_mimic.py``)."""
    (file,) = (f for f in files("example-robot-data") or () if f.as_posix().endswith(f"/{name}"))
    return re.sub("<mimic.*?/>", "", Path(str(file.locate())).read_text(encoding="utf-8"))


def random_samples(robot: Robot, seed: int, count: int = 5, sensors: int = 0) -> Samples:
    """Unrelated random numbers in every array: equations of motion hold instant by instant."""
    rng = np.random.default_rng(seed)
    joints, base = len(robot.joints), robot.floating_base
    pose = rng.normal(size=(count, 7))
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    position, velocity, acceleration, effort = rng.normal(size=(4, count, joints))
    return Samples(
        stamps=np.arange(1, count + 1),
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        effort=effort,
        base_pose=pose if base else np.zeros((count, 0)),
        base_velocity=rng.normal(size=(count, 6 if base else 0)),
        base_acceleration=rng.normal(size=(count, 6 if base else 0)),
        wrenches=rng.normal(size=(count, sensors, 6)),
    )


def fixed_base(stamps: IntArray, *motion: FloatArray, **more: Any) -> Samples:
    """Samples of a robot on a fixed base: position, velocity, acceleration and effort, each ``(N, joints)``."""
    none = np.zeros((len(stamps), 0))
    return Samples(stamps, *motion, none, none, none, np.zeros((len(stamps), 0, 6)), **more)


def with_values(samples: Samples, **arrays: FloatArray) -> Samples:
    """The same samples with other values in some arrays."""
    return Samples(**{**vars(samples), **arrays})


def random_parameters(robot: Robot, seed: int) -> FloatArray:
    """Parameters ``(bodies, 10)`` of random bodies that can exist: each a rod, a disc and a ball somewhere."""
    rng = np.random.default_rng(seed)
    bodies = []
    for _ in robot.bodies:
        mass, radius, length = rng.uniform(0.1, 3.0), rng.uniform(0.01, 0.1), rng.uniform(0.1, 0.5)
        parts = [
            pin.Inertia.FromCylinder(mass, radius, length),
            pin.Inertia.FromCylinder(mass, length, radius),
            pin.Inertia.FromSphere(mass, radius),
        ]
        placed = [pin.SE3(pin.exp3(rng.normal(size=3)), 0.2 * rng.normal(size=3)).act(part) for part in parts]
        bodies.append((placed[0] + placed[1] + placed[2]).toDynamicParameters())
    return np.array(bodies)


class Reference:
    """A pinocchio model of the URDF, or of the URDF with other inertias in place of its own."""

    def __init__(self, text: str, *, floating_base: bool = False, gravity: Sequence[float] = GRAVITY) -> None:
        root = (pin.JointModelFreeFlyer(),) if floating_base else ()
        self.model = pin.buildModelFromXML(text, *root)
        self.model.gravity.linear = np.array(gravity)
        self.data = self.model.createData()
        self.floating_base = floating_base

    def frame(self, link: str) -> pin.Frame:
        """The frame of a link."""
        return self.model.frames[self.model.getFrameId(link, pin.BODY)]

    def set_inertias(self, inertias: Mapping[str, FloatArray]) -> None:
        """Let the moving joints carry these bodies, parameters ``(10,)`` by link, and nothing else."""
        for index in range(1, self.model.njoints):
            self.model.inertias[index] = pin.Inertia.Zero()
        for link, parameters in inertias.items():
            frame = self.frame(link)
            placed = frame.placement.act(pin.Inertia.FromDynamicParameters(parameters))
            self.model.inertias[frame.parentJoint] += placed
        self.data = self.model.createData()

    def state(self, samples: Samples, index: int, joints: Sequence[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pinocchio's q, v, a of one instant, joint by joint by name."""
        q, v, a = pin.neutral(self.model), np.zeros(self.model.nv), np.zeros(self.model.nv)
        if self.floating_base:
            q[:7], v[:6], a[:6] = (
                samples.base_pose[index],
                samples.base_velocity[index],
                samples.base_acceleration[index],
            )
        for place, name in enumerate(joints):
            joint = self.model.joints[self.model.getJointId(name)]
            angle = samples.position[index, place]
            q[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(angle), np.sin(angle)] if joint.nq == 2 else [angle]
            v[joint.idx_v], a[joint.idx_v] = samples.velocity[index, place], samples.acceleration[index, place]
        return q, v, a

    def inverse_dynamics(
        self, samples: Samples, joints: Sequence[str], wrenches: Mapping[str, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Forces on the base ``(N, 6)`` (its frame, zero for a fixed base) and efforts ``(N, joints)``.

        ``wrenches (N, 6)`` by link act on the robot, in the axes and about the origin of that link's frame.
        """
        base, efforts = np.zeros((len(samples), 6)), np.zeros((len(samples), len(joints)))
        places = [self.model.joints[self.model.getJointId(name)].idx_v for name in joints]
        for index in range(len(samples)):
            forces = pin.StdVec_Force()
            forces.extend(pin.Force.Zero() for _ in range(self.model.njoints))
            for link, wrench in (wrenches or {}).items():
                frame = self.frame(link)
                forces[frame.parentJoint] += frame.placement.act(pin.Force(wrench[index]))
            tau = pin.rnea(self.model, self.data, *self.state(samples, index, joints), forces)
            efforts[index] = tau[places]
            if self.floating_base:
                base[index] = tau[:6]
        return base, efforts

    def placement(self, samples: Samples, index: int, joints: Sequence[str], link: str) -> pin.SE3:
        """Placement of a link's frame in the world at one instant."""
        pin.framesForwardKinematics(self.model, self.data, self.state(samples, index, joints)[0])
        return self.data.oMf[self.model.getFrameId(link, pin.BODY)].copy()

    def motion(self, samples: Samples, index: int, joints: Sequence[str], link: str) -> tuple[FloatArray, FloatArray]:
        """Spatial velocity and acceleration ``(6,)`` of a link's frame in its own axes at one instant."""
        pin.forwardKinematics(self.model, self.data, *self.state(samples, index, joints))
        frame = self.model.getFrameId(link, pin.BODY)
        velocity = pin.getFrameVelocity(self.model, self.data, frame, pin.LOCAL).vector
        return velocity, pin.getFrameAcceleration(self.model, self.data, frame, pin.LOCAL).vector


def part_after(text: str, link: str) -> str:
    """The URDF of the part of a robot that begins with ``link``, as a robot of its own."""
    robot = ElementTree.fromstring(text)
    joints = robot.findall("joint")
    names = [link]
    for name in names:
        names += [j.find("child").get("link") for j in joints if j.find("parent").get("link") == name]
    for element in [*robot]:
        kept = element.tag == "link" and element.get("name") in names
        kept = kept or (element.tag == "joint" and element.find("parent").get("link") in names)
        if not kept:
            robot.remove(element)
    return ElementTree.tostring(robot, encoding="unicode")
