"""Identified values written into the user's MJCF."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.parsers.expat import ExpatError

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.exports.descriptions import DescriptionFiles, not_representable
from geomid_ros.exports.model import ExportModel
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effects_file import joint_attributes
from geomid_ros.files.models.mjcf import with_identified
from geomid_ros.files.models.readers import ELEMENTS, EXISTING_MJCF
from geomid_ros.files.models.urdf import joint_frames
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.urdf_tree import MOST_URDF_BYTES
from geomid_ros.resimulation.written_robot import BodyFrames, body_frames
from geomid_ros.types import FloatArray

_FAR = 1e-3  # [m, rad] largest deviation between the axes of one joint


@dataclass(frozen=True, eq=False)
class UserMjcf:
    """MJCF of the user that the numbers of a model are written into.

    Attributes:
        path: the file.
        text: its content.
        placements: homogeneous matrices ``(4, 4)`` from links to the bodies of the same names.
        joints: names of its joints.
        emptied: bodies that are merged into others.
    """

    path: Path
    text: str
    placements: Mapping[str, FloatArray]
    joints: Collection[str]
    emptied: Sequence[str]

    def with_numbers(self, model: ExportModel) -> str:
        """Return the text with the inertias of the links and the effects at the joints of a model, all else unchanged.
        Raises InputError if one of them is not in this file but in an included one."""
        inertias = {name: _moved(_with_payload(model, name), placed) for name, placed in self.placements.items()}
        attributes = joint_attributes(model.effects, "joint")
        joints = {name: values for name, values in attributes.items() if name in self.joints}
        try:
            return with_identified(self.text, inertias, joints, self.emptied)
        except KeyError as error:
            raise InputError(
                f"{self.path}: {error} is not in this file itself; give the one that includes nothing"
            ) from error
        except ExpatError as error:  # MuJoCo's parser is more lenient
            raise InputError(f"{self.path}: not valid XML ({error})") from error


def patch_user_mjcf(model: ExportModel, path: Path) -> DescriptionFiles:
    """Return the text of an MJCF with the inertias of the links and the effects at the joints of the model, by name;
    see :func:`read_user_mjcf`."""
    target = read_user_mjcf(model, path)
    patched = target.with_numbers(model)
    links, attributes = model.estimated or model.bodies, joint_attributes(model.effects, "joint")
    sentences = [
        *not_representable(model, ELEMENTS[EXISTING_MJCF]),
        *_named(f"{path}: has no body", [name for name in links if name not in target.placements]),
        *_named(f"{path}: has no joint", [name for name in attributes if name not in target.joints]),
        *_named("Merged into other bodies (mass set to zero):", target.emptied),
    ]
    return DescriptionFiles(patched, sentences)


def read_user_mjcf(model: ExportModel, path: Path) -> UserMjcf:
    """Read an MJCF of the same robot as ``model``.

    The frames of its bodies need not be those of the URDF's links: inertias are transformed, with all joints at zero.

    Raises:
        InputError: it has none of the bodies, or its axes are not where the URDF has them.
    """
    text, frames = read_text(path, "MJCF", MOST_URDF_BYTES), body_frames(path)
    links = model.estimated or tuple(model.bodies)
    bodies = [name for name in links if name in frames.bodies]
    if not bodies:
        raise InputError(
            f"{path}: has none of the bodies {', '.join(links)}; those that it has: {', '.join(frames.bodies)}"
        )
    base = _base(model, frames, path)
    placed = {name: np.linalg.inv(frames.bodies[name]) @ base @ model.placements[name] for name in bodies}
    emptied = [link for name in bodies for link in model.bodies[name].merged if frames.masses.get(link)]
    return UserMjcf(path, text, placed, tuple(frames.joints), emptied)


def _named(heading: str, names: Sequence[str]) -> list[str]:
    return [f"{heading} {', '.join(names)}"] if names else []


def _with_payload(model: ExportModel, link: str) -> FloatArray:
    """Parameters ``(10,)`` of a link and of the payload found on it, which is a separate link of the URDF."""
    payload = model.payload_of(link)
    parameters = model.bodies[link].parameters
    return parameters if payload is None else parameters + payload.parameters


def _moved(parameters: FloatArray, placement: FloatArray) -> FloatArray:
    return pseudo_inertia.to_parameters(placement @ pseudo_inertia.from_parameters(parameters) @ placement.T)


def _base(model: ExportModel, frames: BodyFrames, path: Path) -> FloatArray:
    """Homogeneous matrix ``(4, 4)`` from the URDF's root to the MJCF's world: the placement of the body named like the
    root, or else the best fit of all axes. Raises InputError if neither fits."""
    axes = _urdf_axes(model, frames.joints)
    named = frames.bodies.get(model.tree.root, np.eye(4))
    fitted = _fitted(axes, frames.joints)
    apart = [
        [name for name in axes if _deviation(base, axes[name], frames.joints[name]) >= _FAR] for base in (named, fitted)
    ]
    if [] in apart:
        return (named, fitted)[apart.index([])]
    worst = ", ".join(apart[0] if len(apart[0]) < len(apart[1]) else apart[1])
    raise InputError(
        f"{path}: with all joints at zero, its axes are not where {model.urdf_path} has them ({worst}): another robot, "
        "or other zeros or signs of joints; an inertia cannot be moved from one to the other"
    )


def _urdf_axes(model: ExportModel, names: Iterable[str]) -> dict[str, FloatArray]:
    """Point and direction ``(2, 3)`` of the axes of the joints in ``names``, in the frame of the URDF's root."""
    axes = {}
    for joint in joint_frames(model.urdf, str(model.urdf_path)):
        if joint.name in set(names) and np.any(joint.axis):
            placed = model.placements[joint.child]
            axes[joint.name] = np.array([placed[:3, 3], placed[:3, :3] @ joint.axis])
    return axes


def _fitted(axes: Mapping[str, FloatArray], seen: Mapping[str, FloatArray]) -> FloatArray:
    """Least-squares rigid motion from lines ``axes`` to lines ``seen``: the rotation of the directions (Kabsch), then
    the translation perpendicular to them."""
    base = np.eye(4)
    if not axes:
        return base
    source, target = (np.array([lines[name] for name in axes]) for lines in (axes, seen))
    u, _, vt = np.linalg.svd(target[:, 1].T @ source[:, 1])
    mirror = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    base[:3, :3] = u @ mirror @ vt
    across = np.eye(3) - target[:, 1, :, None] * target[:, 1, None, :]
    shifts = np.einsum("nij,nj->ni", across, target[:, 0] - source[:, 0] @ base[:3, :3].T)
    base[:3, 3] = np.linalg.lstsq(across.reshape(-1, 3), shifts.ravel(), rcond=None)[0]
    return base


def _deviation(base: FloatArray, line: FloatArray, seen: FloatArray) -> float:
    """Deviation of a ``line`` from the line ``seen``: the larger of the angle and the distance."""
    point, direction = base[:3, :3] @ line[0] + base[:3, 3], base[:3, :3] @ line[1]
    distance = np.linalg.norm(np.cross(point - seen[0], seen[1]))
    return float(max(distance, np.linalg.norm(direction - seen[1])))
