"""Pictures: a prior made from shapes with the ellipsoids that move as the links do; the torques of sampled robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.shape_prior import LinkPrior
from geomid_ros.report.ellipsoids import outline
from geomid_ros.report.sheet import IDENTIFIED, URDF, new_figure, write_picture
from geomid_ros.types import FloatArray, IntArray

# By the axis that the viewer looks along: the axes to the right and up.
_VIEWS = (("from the front", "yz"), ("from the right", "xz"), ("from above", "xy"))


@dataclass(frozen=True, eq=False)
class PlacedLink:
    """A link of a prior where it is in the world: ``rotation (3, 3)`` and ``origin (3,)`` of its frame."""

    link: LinkPrior
    rotation: FloatArray
    origin: FloatArray

    def in_world(self, points: FloatArray) -> FloatArray:
        """Points ``(N, 3)`` of the link's frame."""
        return points @ self.rotation.T + self.origin


def prior_picture(path: Path, title: str, links: Sequence[PlacedLink]) -> None:
    """Draw the links along the two axes in which they reach least far, in orthographic projection, into the PNG
    ``path``."""
    corners = np.concatenate([placed.in_world(placed.link.solid.vertices) for placed in links if placed.link.solid])
    shortest = np.argsort(np.ptp(corners, axis=0), kind="stable")[:2]
    wide = np.ptp(corners[:, :2], axis=0).max() > 1.2 * np.ptp(corners[:, 2])
    figure = new_figure(12.0, 8.0)
    figure.suptitle(title, x=0.02, ha="left", weight="bold", parse_math=False)
    panels = figure.subplots(*((2, 1) if wide else (1, 2)))
    for panel, axis in zip(panels, shortest, strict=True):
        name, axes = _VIEWS[int(axis)]
        right, up = (np.eye(3)["xyz".index(each)] for each in axes)
        _draw(panel, links, np.array([right, up, np.cross(right, up)]))
        panel.set_title(f"{name} ({', '.join(axes)})", size="medium")
        panel.set_aspect("equal", adjustable="box")
        panel.set_xlabel("m")
    handles = [
        Line2D([], [], color="#c9cdd1", lw=6, label="shapes"),
        Line2D([], [], color=IDENTIFIED, label="uniform ellipsoid of the same inertia, prior"),
        Line2D([], [], color=URDF, ls="--", label="the same for the URDF's inertial"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    write_picture(path, figure)


def _draw(axes: Axes, links: Sequence[PlacedLink], view: FloatArray) -> None:
    """The limits are those of shapes and prior: an inertial far outside must not make all else small."""
    reached = []
    for placed in links:
        if placed.link.solid is not None:
            _draw_shape(axes, placed.in_world(placed.link.solid.vertices) @ view.T, placed.link.solid.triangles)
            reached.append((placed.in_world(placed.link.solid.vertices) @ view.T)[:, :2])
        if placed.link.before.parameters is not None and not placed.link.before.problem:
            axes.plot(*_outline(placed.link.before.parameters, placed, view), color=URDF, ls="--", lw=1.0)
        if placed.link.parameters is not None:
            reached.append(_outline(placed.link.parameters, placed, view).T)
            axes.plot(*reached[-1].T, color=IDENTIFIED, lw=1.3)
    ends = np.concatenate(reached)
    margin = 0.05 * np.ptp(ends, axis=0).max()
    axes.set_xlim(ends[:, 0].min() - margin, ends[:, 0].max() + margin)
    axes.set_ylim(ends[:, 1].min() - margin, ends[:, 1].max() + margin)


def _draw_shape(axes: Axes, vertices: FloatArray, faces: IntArray) -> None:
    """``vertices (V, 3)`` in the view's axes; the nearer triangles over the farther ones."""
    triangles = vertices[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(normals, axis=1)
    facing = normals[:, 2] > 1e-6 * sizes
    order = np.argsort(triangles[facing, :, 2].mean(axis=1))
    light = 0.72 + 0.2 * normals[facing, 2] / sizes[facing]
    collection = PolyCollection(
        list(triangles[facing][order, :, :2]), facecolors=np.repeat(light[order, None], 3, axis=1), edgecolors="none"
    )
    axes.add_collection(collection, autolim=False)


def _outline(parameters: FloatArray, placed: PlacedLink, view: FloatArray) -> FloatArray:
    """Outline ``(2, K)`` of the equivalent ellipsoid."""
    semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(parameters)
    centre = view @ placed.in_world(pseudo_inertia.centre_of_mass(parameters))
    return np.asarray(centre[:2, None] + outline(view @ placed.rotation @ (axes * semi_axes)))


def torque_picture(path: Path, title: str, names: Sequence[str], drawn: FloatArray, ranges: FloatArray) -> None:
    """Draw the PNG ``path``: the width of the band of efforts of ``drawn`` robots and of ``ranges``, ``(joints,)`` in
    the order of the joints' ``names``."""
    figure = new_figure(8.0, 0.4 * len(names) + 1.6)
    figure.suptitle(title, x=0.02, ha="left", weight="bold", parse_math=False)
    axes = figure.subplots()
    places = np.arange(len(names))
    axes.hlines(places, drawn, ranges, color=URDF, lw=1.0)
    axes.plot(drawn, places, "o", color=IDENTIFIED, label="robots sampled from the posterior")
    axes.plot(ranges, places, "s", color=URDF, label="independent ranges of ±20 %")
    axes.set_yticks(places, names, parse_math=False)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.grid(axis="x", color="#e6e8ea")
    axes.set_xlabel("width of the 95 % band of efforts in fast motion (RMS)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    write_picture(path, figure)
