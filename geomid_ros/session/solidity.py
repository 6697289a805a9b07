"""Identified links that no solid of their shapes can be, where the URDF has shapes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import LinkEstimate
from geomid_ros.model.shape_prior import OUTSIDE, Solid, UrdfInertial, verdict
from geomid_ros.model.shapes import volume
from geomid_ros.model.urdf_tree import inertial_parameters, read_xml
from geomid_ros.types import FloatArray

_DENSEST = 22_590.0
"""[kg/m^3] osmium; no material has more."""


def impossible_links(urdf: str, source: str, links: Iterable[LinkEstimate]) -> Iterator[str]:
    """A sentence for each link that its shape cannot hold: denser than any material, or with mass outside of it.

    Links without a shape that can be read, and links that others are counted in with, pass; so do those whose mass in
    the URDF is outside of their shape, too, which is not that of their mass then.

    Args:
        urdf: text of the robot description.
        source: where it is from; meshes are looked for from there.
        links: to judge.
    """
    for link in links:
        solid = None if link.merged else _solid(urdf, source, link.name)
        if solid is None:
            continue
        density = link.mass / volume(solid.moments)
        if density > _DENSEST:
            yield (
                f"link '{link.name}' weighs {link.mass:.3g} kg, {density:.3g} kg/m^3 in its shape of the URDF, and no "
                f"material has more than {_DENSEST:.0f}"
            )
            continue
        own = inertial_parameters(_element(urdf, source, link.name), source)
        if _is_outside(link.parameters, solid) and not _is_outside(own, solid):
            yield f"link '{link.name}' has mass outside of its shape of the URDF"


def _is_outside(parameters: FloatArray | None, solid: Solid) -> bool:
    """Whether a body ``(10,)`` has mass outside of a solid."""
    if parameters is None:
        return False
    return verdict(UrdfInertial(parameters, ""), solid, float(parameters[0]) / volume(solid.moments)) == OUTSIDE


def _element(urdf: str, source: str, name: str) -> Element:
    return next(link for link in read_xml(urdf, source).findall("link") if link.get("name") == name)


def _solid(urdf: str, source: str, name: str) -> Solid | None:
    """The solid that a link's shapes fill; None if none can be read."""
    # Of few results alone: what reads meshes takes a third of a second to import.
    from geomid_ros.files.shapes import ShapeReader  # noqa: PLC0415

    element = _element(urdf, source, name)
    try:
        return ShapeReader(Path(source), {}).solid(element)
    except (InputError, OSError, ImportError):
        return None
