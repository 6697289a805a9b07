"""Whether a written trajectory holds its limits, by another route than the design's.

The trajectory is read from its file, interpolated as a controller does (quintic) at 1 kHz, and differentiated by finite
differences. Distances are MuJoCo's, between the geometries that it makes of the URDF, and so are the efforts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from xml.etree.ElementTree import SubElement, tostring

import mujoco
import numpy as np
import yaml
from defusedxml.ElementTree import fromstring
from scipy.interpolate import BPoly

from benchmarks.excite.robots import PACKAGE, Description
from geomid_ros.types import FloatArray

RATE = 1000.0  # [Hz]
_FAR = 0.1  # [m] beyond which distances do not matter
_ROUNDING = 1e-3  # of a limit: that of third differences
_LENGTH = 1e-4  # [m] by which hulls of two programs may differ


@dataclass(frozen=True, eq=False)
class Limits:
    """Of joints ``(J,)``, and the least ``clearances`` of pairs of links by their names; pairs without one are not
    looked at."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    effort: FloatArray
    clearances: dict[frozenset[str], float]


def positions(path: Path) -> tuple[list[str], FloatArray]:
    """Joint names, and positions ``(N, J)`` at 1 kHz."""
    document = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    points = document["points"]
    stamps = [point["time_from_start"] for point in points]
    times = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    kinds = ("positions", "velocities", "accelerations")
    states = np.array([[point[kind] for kind in kinds] for point in points])
    return document["joint_names"], BPoly.from_derivatives(times, states)(np.arange(0.0, times[-1], 1.0 / RATE))


class Simulated:
    """A URDF as MuJoCo has it."""

    def __init__(self, description: Description, joints: Sequence[str]) -> None:
        self.model = mujoco.MjModel.from_xml_string(_for_mujoco(description))
        # Efforts are those of free links: hulls of neighbours overlap, and would push each other apart.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.data = mujoco.MjData(self.model)
        ids = [self.model.joint(name).id for name in joints]
        self._q, self._v = self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]

    def violations(self, path: Path, limits: Limits) -> dict[str, int]:
        """How many instants break each kind of limit."""
        _, q = positions(path)
        derivatives = [np.diff(q, order, axis=0) * RATE**order for order in (1, 2, 3)]
        low, high = limits.position.T
        found = {"position": int(np.sum((q < low) | (q > high)))}
        kinds = ("velocity", "acceleration", "jerk")
        for kind, values in zip(kinds, derivatives, strict=True):
            found[kind] = int(np.sum(np.abs(values) > (1.0 + _ROUNDING) * getattr(limits, kind)))
        efforts = self._efforts(q)
        found["effort"] = int(np.sum(np.abs(efforts) > limits.effort))
        contacts, closer = self._too_close(q, limits.clearances)
        return {**found, "contact": contacts, "clearance": closer}

    def _efforts(self, q: FloatArray) -> FloatArray:
        speed, acceleration = np.gradient(q, 1.0 / RATE, axis=0), np.diff(q, 2, axis=0) * RATE**2
        efforts = []
        for position, velocity, change in zip(q[1:-1:10], speed[1:-1:10], acceleration[::10], strict=True):
            self.data.qpos[self._q], self.data.qvel[self._v], self.data.qacc[self._v] = position, velocity, change
            mujoco.mj_inverse(self.model, self.data)
            efforts.append(self.data.qfrc_inverse[self._v].copy())
        return np.array(efforts)

    def _too_close(self, q: FloatArray, clearances: dict[frozenset[str], float]) -> tuple[int, int]:
        pairs = [
            (first, second, clearances[names])
            for first, second in combinations(range(self.model.ngeom), 2)
            if (names := self._links(first, second)) in clearances
        ]
        contacts = closer = 0
        nothing = np.zeros(6)
        for position in q:
            self.data.qpos[self._q] = position
            mujoco.mj_kinematics(self.model, self.data)
            found = [mujoco.mj_geomDistance(self.model, self.data, a, b, _FAR, nothing) for a, b, _ in pairs]
            contacts += any(distance < 0.0 for distance in found)
            closer += any(distance < asked - _LENGTH for distance, (*_, asked) in zip(found, pairs, strict=True))
        return contacts, closer

    def _links(self, *geometries: int) -> frozenset[str]:
        return frozenset(self.model.body(self.model.geom_bodyid[geometry]).name for geometry in geometries)


def _for_mujoco(description: Description) -> str:
    """The URDF with its meshes' absolute paths, all links, and collision shapes alone."""
    robot = fromstring(description.text)
    for link in robot.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for mesh in robot.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").replace(f"package://{PACKAGE}", str(description.package)))
    extension = SubElement(robot, "mujoco")
    options = {"strippath": "false", "fusestatic": "false", "discardvisual": "false", "balanceinertia": "true"}
    SubElement(extension, "compiler", options | {"boundmass": "1e-6", "boundinertia": "1e-9"})
    return tostring(robot, encoding="unicode")
