"""The same robot written differently: other link frames, other units of length and mass."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from geometry import bodies
from scipy.spatial.transform import Rotation

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class Rewritten:
    """A URDF, and where each link's new frame lies in its old one ``(4, 4)``; units as factors from old to new."""

    urdf: str
    frames: dict[str, FloatArray]
    length: float
    mass: float

    def parameters(self, link: str, old: FloatArray) -> FloatArray:
        """Parameters ``(10,)`` of a body in the new frame and units."""
        back = np.linalg.inv(self.frames[link])
        factor = np.sqrt(self.mass) * np.diag([self.length] * 3 + [1.0]) @ back
        return pseudo_inertia.to_parameters(factor @ pseudo_inertia.from_parameters(old) @ factor.T)


def rewritten(urdf: str, seed: int, length: float = 1.0, mass: float = 1.0) -> Rewritten:
    """Turn every link's frame at random, and move it along its joint's axis: elsewhere it must not be."""
    rng = np.random.default_rng(seed)
    robot = ElementTree.fromstring(urdf)
    children = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}
    frames = {link.get("name"): np.eye(4) for link in robot.findall("link")}
    for link, joint in children.items():
        frames[link][:3, :3] = bodies.rotation(rng)
        axis = _numbers(joint.find("axis"), "xyz") if joint.find("axis") is not None else rng.normal(size=3)
        frames[link][:3, 3] = 0.3 * rng.normal() * axis
    for link, joint in children.items():
        parent = joint.find("parent").get("link")
        _place(joint.find("origin"), np.linalg.inv(frames[parent]) @ _pose(joint.find("origin")) @ frames[link], length)
        if joint.find("axis") is not None:
            axis = frames[link][:3, :3].T @ _numbers(joint.find("axis"), "xyz")
            joint.find("axis").set("xyz", _text(axis))
    for link in robot.findall("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
        inertial = link.find("inertial")
        if inertial is not None:
            placed = np.linalg.inv(frames[link.get("name")]) @ _pose(inertial.find("origin"))
            _place(inertial.find("origin"), placed, length)
            _multiply(inertial.find("mass"), mass)
            _multiply(inertial.find("inertia"), mass * length**2)
    return Rewritten(ElementTree.tostring(robot, encoding="unicode"), frames, length, mass)


def _numbers(element: Element, key: str) -> FloatArray:
    return np.array([float(part) for part in element.get(key, "0 0 0").split()])


def _text(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _pose(origin: Element) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", _numbers(origin, "rpy")).as_matrix()
    pose[:3, 3] = _numbers(origin, "xyz")
    return pose


def _place(origin: Element, pose: FloatArray, length: float) -> None:
    origin.set("rpy", _text(Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")))
    origin.set("xyz", _text(length * pose[:3, 3]))


def _multiply(element: Element, factor: float) -> None:
    for key, value in element.attrib.items():
        element.set(key, repr(factor * float(value)))
