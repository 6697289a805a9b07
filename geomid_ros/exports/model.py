"""Model to export: an ``estimate.json`` with the ``identified.urdf`` in its folder, or any URDF."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation.estimate import QUANTITIES, UncertainInertia
from geomid_ros.files.models.effects_file import QUANTITY_NAMES, is_payload_name, joint_attributes
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.posterior import RTOL
from geomid_ros.files.models.readers import URDF
from geomid_ros.files.models.urdf import read_urdf, with_absolute_files, with_inertials
from geomid_ros.files.models.written_model import IDENTIFIED, fitted_model_of
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import EFFECTS, KnownEffect, Quantity
from geomid_ros.model.robot import GRAVITY, Robot
from geomid_ros.model.urdf_tree import UrdfTree, masters, parse, read_numbers, read_xml
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class ExportModel:
    """Model to export.

    Attributes:
        source: the file.
        tree: tree of links and joints of the URDF.
        bodies: the links with a mass.
        urdf: URDF text with the inertias; ``urdf_path`` is its file.
        effects: effects in addition to the bodies, without payloads that are links of the URDF.
        known: all effects of the estimate but payloads, including those that its reader cannot represent.
        estimated: the identified links.
        warning: why the model should not be used, in a sentence; empty if nothing speaks against it.
        gravity: ``(3,)`` [m/s^2] with the base upright.
        fitted: False if the estimate has no fit of bodies and effects for the reader.
    """

    source: str
    tree: UrdfTree
    bodies: Mapping[str, UncertainInertia]
    urdf: str
    urdf_path: Path
    effects: tuple[KnownEffect, ...]
    known: tuple[KnownEffect, ...]
    estimated: tuple[str, ...] = ()
    warning: str = ""
    gravity: FloatArray = field(default_factory=GRAVITY.copy)
    fitted: bool = True

    @cached_property
    def placements(self) -> dict[str, FloatArray]:
        """Homogeneous matrices ``(4, 4)`` of all links in the root's frame, with all joints at zero."""
        joints = {joint.child: joint for joint in self.tree.joints}
        placements = {self.tree.root: np.eye(4)}
        for link in self.tree.subtree(self.tree.root)[1:]:
            placed = pseudo_inertia.change_of_frame(joints[link].rotation, joints[link].position)
            placements[link] = placements[joints[link].parent] @ placed
        return placements

    @property
    def written(self) -> list[str]:
        """Links whose inertias are written into files: the identified ones and those locked to them; all of a URDF."""
        merged = [link for name in self.estimated for link in self.bodies[name].merged if link in self.bodies]
        return [*self.estimated, *merged] or [*self.bodies]

    @cached_property
    def robot(self) -> Robot:
        """Robot with the identified bodies; joints between links identified as one body are locked."""
        return Robot(
            self.urdf,
            source=str(self.urdf_path),
            floating_base=self.tree.root in self.estimated,
            cuts=[joint.child for joint in self.tree.joints if joint.type == "fixed" and joint.child in self.estimated],
            locked_joints=self._locked,
        )

    @cached_property
    def _locked(self) -> list[str]:
        merged = {link for body in self.bodies.values() for link in body.merged}
        return [joint.name for joint in self.tree.joints if joint.child in merged and joint.type != "fixed"]

    def as_links(self, inertias: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return parameters ``(10,)`` of links from those of identified bodies by name, see :meth:`Robot.as_links`."""
        return self.robot.as_links(inertias) if self._locked else dict(inertias)

    def placement(self, link: str, frame: str) -> FloatArray:
        """Return the homogeneous matrix ``(4, 4)`` from a link's coordinates to those of the link ``frame``."""
        return np.linalg.inv(self.placements[frame]) @ self.placements[link]

    def check_link(self, link: str, kind: str) -> None:
        """Raise InputError if there is no such link."""
        if link not in self.tree.links:
            raise InputError(f"{self.source}: {unknown_name(kind, link, self.tree.links)}")


def read_model(path: Path, reader: str = "") -> ExportModel:
    """Read an ``estimate.json`` or a URDF.

    Args:
        path: the file.
        reader: reader of the export, of :data:`~geomid_ros.files.models.readers.ELEMENTS`, for the model that was
            fitted within the limits of its format; empty for the estimate itself.

    Raises:
        InputError: it names the file.
    """
    if path.suffix != ".json":
        return _of_urdf(path)
    file, urdf = EstimateFile.read(path), path.parent / IDENTIFIED
    if not urdf.exists():
        raise InputError(
            f"{path}: {IDENTIFIED} (the places of the links) is missing in the same folder; keep the files that were "
            "written together in one folder"
        )
    text, source = read_urdf(urdf), str(path)
    tree = parse(text, str(urdf))
    bodies = _estimated_bodies(file, tree)
    known = effects = tuple(effect for effect in file.known_effects if not effect.is_payload)
    written = fitted_model_of(file, reader)
    if written is not None:
        effects = tuple(effect for effect in written.effects if not effect.is_payload)
    friction = _dynamics(text, str(urdf), (*known, *effects))
    model = ExportModel(
        source=source,
        tree=tree,
        bodies=bodies,
        estimated=tuple(link.name for link in file.links),
        warning=file.warning,
        urdf=text,
        urdf_path=urdf,
        effects=(*effects, *friction),
        known=(*known, *friction),
        gravity=file.gravity,
        fitted=written is not None or not reader,
    )
    links = model.as_links(file.inertias if written is None else written.inertias)
    bodies = {name: body for name, body in bodies.items() if name in links or name not in file.inertias}
    bodies |= {name: _with_parameters(bodies[name], inertia) for name, inertia in links.items()}
    estimated = tuple(name for name in model.estimated if name in bodies)
    return replace(
        model, bodies=bodies, estimated=estimated, urdf=text if written is None else with_inertials(text, links)
    )


def _with_parameters(body: UncertainInertia, parameters: FloatArray) -> UncertainInertia:
    """Body with other ``parameters (10,)``, and without its standard deviations if these are other values."""
    std = body.std if np.allclose(parameters, body.parameters) else np.full(10, np.nan)
    return replace(body, parameters=parameters, std=std)


def _of_urdf(path: Path) -> ExportModel:
    text = with_absolute_files(read_urdf(path), str(path))
    tree, effects = parse(text, str(path)), tuple(_dynamics(text, str(path), ()))
    return ExportModel(
        source=str(path),
        tree=tree,
        bodies=_urdf_bodies(tree),
        urdf=text,
        urdf_path=path,
        effects=effects,
        known=effects,
    )


def _dynamics(urdf: str, source: str, found: Sequence[KnownEffect]) -> list[KnownEffect]:
    """Return the friction in <dynamics> of a URDF, unless it is among the effects that were ``found``."""
    written, leaders = joint_attributes(found, "dynamics"), masters(parse(urdf, source), source)
    forms = {effect: cls.parameters[0] for effect, cls in EFFECTS.items() if cls.is_one_number()}
    effects = []
    for joint in read_xml(urdf, source).findall("joint"):
        name = joint.get("name", "")
        for effect, form in forms.items():
            element, _, attribute = form.urdf.partition("/")
            leader, *_ = leaders.get(name, (name,))
            if element == "dynamics" and attribute not in written.get(leader, {}):
                (value,) = read_numbers(joint, element, (attribute,), [0.0], f"{source}: joint '{name}'")
                quantity = Quantity(value, math.nan, form.units[joint.get("type") == "prismatic"])
                effects += [KnownEffect(effect, name, "", {form.name: quantity})] if value > 0.0 else []
    return effects


def _urdf_bodies(tree: UrdfTree) -> dict[str, UncertainInertia]:
    unknown = np.full(10, np.nan)
    return {name: UncertainInertia(parameters=body, std=unknown) for name, body in tree.inertials.items()}


def _estimated_bodies(file: EstimateFile, tree: UrdfTree) -> dict[str, UncertainInertia]:
    """Return the bodies of the URDF, with the estimates of those that were identified, and the standard deviations of
    payloads found by ``geomid gap``, which are links of their own."""
    written, merged = fitted_model_of(file, URDF), file.merged
    for name, parameters in (file.inertias if written is None else written.inertias).items():
        _check_mass(parameters[0], (name, *merged.get(name, ())), tree, file.source)
    bodies = _urdf_bodies(tree)
    if any(link.cannot_tell is not None for link in file.links):
        unknown = bodies.keys() - {link for links in merged.values() for link in links}
        bodies |= {name: replace(bodies[name], cannot_tell=QUANTITIES) for name in unknown}
    bodies |= file.bodies
    for effect in (effect for effect in file.known_effects if effect.is_payload):
        name = payload_link(tree, effect.link)
        if name in bodies:
            std = [effect.parameters[key].std if key in effect.parameters else np.nan for key in QUANTITY_NAMES]
            bodies[name] = UncertainInertia(parameters=bodies[name].parameters, std=np.array(std))
    return bodies


def payload_link(tree: UrdfTree, carrier: str) -> str:
    """Link that a URDF has last as the payload of another one; empty if there is none."""
    names = [joint.child for joint in tree.children(carrier) if is_payload_name(joint.child, carrier)]
    return names[-1] if names else ""


def _check_mass(mass: float, links: Sequence[str], tree: UrdfTree, source: str) -> None:
    """Refuse a description in which a body, the ``links``, does not have this mass (InputError)."""
    written = sum(tree.inertials[link][0] for link in links if link in tree.inertials)
    if abs(written - mass) > RTOL * mass:
        raise InputError(
            f"{source}: the {IDENTIFIED} in the same folder is not of this estimate: link '{links[0]}' has "
            f"{written:.6g} kg there and {mass:.6g} kg here"
        )
