"""Bodies made of point masses: what they weigh and where is a matter of sums, in any frame."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Points:
    """Point masses: ``masses (N,)`` at ``positions (N, 3)`` in a frame."""

    masses: Array
    positions: Array

    @property
    def mass(self) -> float:
        return float(self.masses.sum())

    @property
    def com(self) -> Array:
        return self.masses @ self.positions / self.mass

    @property
    def inertia(self) -> Array:
        """About the centre of mass: the sum of m (|r|^2 1 - r r^T)."""
        arms = self.positions - self.com
        return sum(
            (m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(self.masses, arms, strict=True)), np.zeros((3, 3))
        )

    @property
    def six(self) -> list[float]:
        """Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
        return list(self.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])

    def placed(self, rotation: Array, translation: Array) -> Points:
        """The same points in the frame in which theirs is placed so."""
        return Points(self.masses, self.positions @ rotation.T + translation)

    def seen_from(self, rotation: Array, translation: Array) -> Points:
        """The same points in a frame that is placed so in theirs."""
        return Points(self.masses, (self.positions - translation) @ rotation)

    def __add__(self, other: Points) -> Points:
        return Points(np.append(self.masses, other.masses), np.vstack([self.positions, other.positions]))


def points(seed: int, scale: float = 0.05) -> Points:
    random = np.random.default_rng(seed)
    return Points(random.uniform(0.02, 0.2, 8), random.normal(scale=scale, size=(8, 3)))


@dataclass(frozen=True, eq=False)
class Link:
    """A link of a chain, its body in its own frame, and the joint that it hangs on, at zero."""

    name: str
    parent: str = ""
    body: Points | None = None
    joint: str = "fixed"
    xyz: Sequence[float] = (0.0, 0.0, 0.0)
    rpy: Sequence[float] = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> tuple[Array, Array]:
        """URDF: roll, pitch and yaw about fixed axes."""
        return Rotation.from_euler("xyz", self.rpy).as_matrix(), np.array(self.xyz)


@dataclass(frozen=True, eq=False)
class Chain:
    """A robot, and what is written of it."""

    links: Sequence[Link]
    estimated: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def urdf(self) -> str:
        return f'<robot name="chain">{"".join(_link(link) for link in self.links)}</robot>'

    def in_root(self, name: str) -> tuple[Array, Array]:
        """Rotation and translation of a link's frame in the root."""
        link = next(link for link in self.links if link.name == name)
        if not link.parent:
            return link.pose
        rotation, translation = self.in_root(link.parent)
        own_rotation, own_translation = link.pose
        return rotation @ own_rotation, rotation @ own_translation + translation

    def seen(self, name: str, frame: str) -> Points:
        """A link's body in the frame of another."""
        body = next(link.body for link in self.links if link.name == name)
        assert body is not None
        return body.placed(*self.in_root(name)).seen_from(*self.in_root(frame))

    def write(self, folder: Path) -> Path:
        """``identified.urdf`` and, if something was estimated, ``estimate.json``."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "identified.urdf").write_text(self.urdf())
        if not self.estimated:
            return folder / "identified.urdf"
        links = [self._entry(name, more) for name, more in self.estimated.items()]
        (folder / "estimate.json").write_text(json.dumps({"format": 1, "links": links, "effects": []}))
        return folder / "estimate.json"

    def _entry(self, name: str, more: Mapping[str, Any]) -> dict[str, Any]:
        body = next(link.body for link in self.links if link.name == name)
        assert body is not None
        std = {"mass": 0.01, "com": [0.002] * 3, "inertia": [[1e-4] * 3] * 3}
        told = {"merged": [], "std": std, "from_data": 0.8, "cannot_tell": []}
        numbers = {"mass": body.mass, "com": body.com.tolist(), "inertia": body.inertia.tolist()}
        return {"name": name, **numbers, **told, **more}


def _link(link: Link) -> str:
    inertial = joint = ""
    if link.body is not None:
        keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        entries = " ".join(f'{key}="{value!r}"' for key, value in zip(keys, map(float, link.body.six), strict=True))
        inertial = (
            f'<inertial><origin xyz="{_words(link.body.com)}"/><mass value="{link.body.mass!r}"/>'
            f"<inertia {entries}/></inertial>"
        )
    if link.parent:
        joint = (
            f'<joint name="{link.name}_joint" type="{link.joint}"><origin xyz="{_words(link.xyz)}" '
            f'rpy="{_words(link.rpy)}"/><parent link="{link.parent}"/><child link="{link.name}"/><axis xyz="0 0 1"/>'
            "</joint>"
        )
    return f'<link name="{link.name}">{inertial}</link>{joint}'


def _words(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)
