"""Reading robot descriptions, and writing identified inertias and effects into them without touching anything else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from geomid_ros.estimation.estimate import LinkEstimate
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effect_forms import is_body, joint_attributes, payload_quantities
from geomid_ros.files.models.xml_edits import Edit, Span, children_of, edited, insertion, with_attributes
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import KnownEffect, values_of
from geomid_ros.model.urdf_tree import MOST_BYTES
from geomid_ros.types import FloatArray

# Mass [kg], centre of mass (3,) [m] in the link's frame, inertia (3, 3) [kg m^2] about it in the link's axes.
Inertia: TypeAlias = tuple[float, FloatArray, FloatArray]


def read_urdf(path: Path) -> str:
    """The text of a URDF file, with the line ends it has. Raises InputError naming it."""
    return read_text(path, "robot description", MOST_BYTES)


def inertia_of(parameters: FloatArray) -> Inertia:
    """The inertia of a body with parameters ``(10,)``."""
    centre = pseudo_inertia.centre_of_mass(parameters)
    return float(parameters[0]), centre, pseudo_inertia.central_inertia(parameters)


def with_identified_inertias(urdf: str, links: Sequence[LinkEstimate]) -> str:
    """``urdf`` with the inertials of the identified bodies; every other character of it is kept.

    A body's inertia goes to its moving link. The inertials of the links that are fixed to it and counted in are
    removed: their mass is in the moving link's.
    """
    merged = [name for link in links for name in link.merged]
    return with_inertials(urdf, {link.name: (link.mass, link.com, link.inertia) for link in links}, merged)


def with_inertials(urdf: str, inertias: Mapping[str, Inertia], removed: Sequence[str] = ()) -> str:
    """``urdf`` with these inertials, by the link's name, and without those of the links ``removed``; every other
    character of it is kept."""
    data = urdf.encode()
    links = children_of(data, "robot", "link", "inertial")
    edits = [insertion(data, links[name], _inertial(*inertia)) for name, inertia in inertias.items()]
    edits += [(*inertial, b"") for name in removed if (inertial := links[name].child)]
    return edited(data, edits).decode()


def _inertial(mass: float, com: FloatArray, inertia: FloatArray) -> bytes:
    centre = " ".join(f"{value:.9g}" for value in com)
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    numbers = " ".join(f'{key}="{inertia[index]:.9g}"' for key, index in entries.items())
    return (
        f'<inertial>\n      <origin xyz="{centre}" rpy="0 0 0"/>\n      <mass value="{mass:.9g}"/>\n'
        f"      <inertia {numbers}/>\n    </inertial>"
    ).encode()


def with_effects(urdf: str, effects: Iterable[KnownEffect]) -> str:
    """``urdf`` with the effects that a URDF can say; every other character of it is kept.

    What effects say of a joint's ``<dynamics>`` is added up there; a payload becomes a link that is fixed to the
    one which carries it.
    """
    data = urdf.encode()
    effects = list(effects)
    joints, links = children_of(data, "robot", "joint", "dynamics"), children_of(data, "robot", "link", "inertial")
    edits = [_dynamics(data, joints[name], own) for name, own in joint_attributes(effects, "dynamics").items()]
    end = data.rindex(b"</robot")
    payloads = [_payload(effect, links, joints) for effect in effects if is_body(effect)]
    edits.append((end, end, b"".join(payloads)))
    return edited(data, edits).decode()


def _dynamics(data: bytes, joint: Span, numbers: Mapping[str, float]) -> Edit:
    """The edit that gives a joint's <dynamics> these attributes; others that it has stay."""
    element = data[slice(*joint.child)] if joint.child else b"<dynamics/>"
    return insertion(data, joint, with_attributes(element, {name: f"{value:.9g}" for name, value in numbers.items()}))


def _payload(effect: KnownEffect, links: Mapping[str, Span], joints: Mapping[str, Span]) -> bytes:
    name = f"{effect.link}_payload"
    while name in links or name in joints:
        name += "_"
    payload = payload_quantities(values_of(effect))
    inertial = _inertial(payload[0], payload[1:4], pseudo_inertia.inertia_matrix(payload[4:])).decode()
    return (
        f'  <link name="{name}">\n    {inertial}\n  </link>\n  <joint name="{name}" type="fixed">\n'
        f'    <parent link="{effect.link}"/>\n    <child link="{name}"/>\n  </joint>\n'
    ).encode()
