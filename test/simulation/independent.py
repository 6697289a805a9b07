"""What pinocchio says about a simulated robot, from the nominal URDF and the truth file alone."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from geomid_ros.simulation.motion import RunTrace
from geomid_ros.types import FloatArray

COMPONENTS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def words(values: Any) -> str:
    """Numbers as a URDF writes them, to the last bit."""
    return " ".join(repr(float(value)) for value in np.ravel(values))


def true_urdf(nominal: str, truth: dict[str, Any]) -> str:
    """The nominal URDF with the inertials of the truth file."""
    robot = ElementTree.fromstring(nominal)
    for link in truth["links"]:
        inertial = robot.find(f"link[@name='{link['name']}']/inertial")
        assert inertial is not None
        inertial.clear()
        ElementTree.SubElement(inertial, "origin", xyz=words(link["com"]), rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=words(link["mass"]))
        inertia = np.array(link["inertia"])
        ElementTree.SubElement(inertial, "inertia", {key: words(inertia[at]) for key, at in COMPONENTS.items()})
    return ElementTree.tostring(robot, encoding="unicode")


@dataclass(frozen=True)
class Independent:
    """The true robot in pinocchio."""

    model: Any
    truth: dict[str, Any]

    @staticmethod
    def read(nominal: str, truth: Path) -> Independent:
        """Build it from a URDF's text and a truth file."""
        values = json.loads(truth.read_text())
        return Independent(pin.buildModelFromXML(true_urdf(nominal, values)), values)

    def coefficients(self, effect: str) -> FloatArray:
        """An effect's coefficients ``(n,)`` in pinocchio's order of joints."""
        every = [entry for entry in self.truth["effects"] if entry["effect"] == effect]
        values = {entry["joint"]: next(iter(entry["parameters"].values())) for entry in every}
        return np.array([values.get(name, 0.0) for name in self.model.names[1:]])

    def smooth_effort(self, trace: RunTrace) -> FloatArray:
        """Efforts ``(T, n)`` of the rigid bodies, the rotors and viscous friction."""
        data = self.model.createData()
        rows = zip(trace.position, trace.velocity, trace.acceleration, strict=True)
        bodies = np.array([pin.rnea(self.model, data, *row) for row in rows])
        viscous = self.coefficients("viscous_friction") * trace.velocity
        return bodies + viscous + self.coefficients("rotor_inertia") * trace.acceleration

    def carried_wrench(self, trace: RunTrace, frame: str, carried: str) -> FloatArray:
        """Newton and Euler for the one body ``carried`` beyond ``frame``: wrench on it ``(T, 6)``, in the frame."""
        link = next(link for link in self.truth["links"] if link["name"] == carried)
        body = pin.Inertia(link["mass"], np.array(link["com"]), np.array(link["inertia"]))
        data = self.model.createData()
        here, there = self.model.getFrameId(frame), self.model.getFrameId(carried)
        wrenches = []
        for row in zip(trace.position, trace.velocity, trace.acceleration, strict=True):
            pin.forwardKinematics(self.model, data, *row)
            pin.updateFramePlacements(self.model, data)
            velocity = pin.getFrameVelocity(self.model, data, there, pin.LOCAL)
            acceleration = pin.getFrameAcceleration(self.model, data, there, pin.LOCAL)
            lift = pin.Motion(data.oMf[there].rotation.T @ np.array([0.0, 0.0, 9.81]), np.zeros(3))
            force = body * (acceleration + lift) + velocity.cross(body * velocity)
            wrenches.append((data.oMf[here].inverse() * data.oMf[there]).act(force).vector.copy())
        return np.array(wrenches)
