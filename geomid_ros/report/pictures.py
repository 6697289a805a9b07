"""Pictures, and the layout of the figure: its size and colours, places in inches from its top left corner, and text.

Priors made from shapes are drawn with the ellipsoids of the same inertias, and sampled robots by their torques.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path
from matplotlib.ticker import MaxNLocator

from geomid_ros.errors import one_line
from geomid_ros.files.disk import write_bytes
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.shape_prior import LinkPrior
from geomid_ros.report.page import FAINT, FLOOR, FRAME, GRID, IDENTIFIED, INK, URDF
from geomid_ros.types import FloatArray, IntArray

Color: TypeAlias = str | tuple[float, float, float]
AxesRectangle: TypeAlias = tuple[float, float, float, float]
"""Left, top, width, height [inch]."""

DPI = 150
SIZE = (17.0, 10.0)  # [inch]
ROBOT: AxesRectangle = (0.25, 0.95, 9.25, 8.35)
CHANNELS: AxesRectangle = (10.15, 1.30, 6.60, 8.00)


def write_picture(path: Path, figure: Figure) -> None:
    """Write a figure as the PNG ``path``, completely or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    write_bytes(path, buffer.getvalue())


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """Create a white figure of this size [inch]."""
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def add_axes(figure: Figure, place: AxesRectangle, share: Axes | None = None, **options: Any) -> Axes:
    """Add axes at a place, with ``options`` of matplotlib; they ``share`` the x axis of others."""
    left, top, width, height = place
    rectangle = (left / SIZE[0], 1.0 - (top + height) / SIZE[1], width / SIZE[0], height / SIZE[1])
    axes = figure.add_axes(rectangle, sharex=share, **options)
    axes.set_title("", y=1.0)  # avoids a second layout of all ticks to place a title
    return axes


def add_area(figure: Figure, place: AxesRectangle) -> Axes:
    """Add axes without a frame whose coordinates are inches from the top left corner."""
    axes = add_axes(figure, place)
    axes.set_axis_off()
    axes.set_xlim(0.0, place[2])
    axes.set_ylim(place[3], 0.0)
    return axes


def add_text(
    where: Figure | Axes,
    x: float,
    y: float,
    text: str,
    size: float = 9.5,
    color: str = INK,
    weight: str = "normal",
    ha: str = "left",
    va: str = "center",
) -> None:
    """Add text at (x, y) inches from the top left corner of a figure or an area; dollar signs are literal."""
    if isinstance(where, Figure):
        x, y = x / SIZE[0], 1.0 - y / SIZE[1]
    where.text(x, y, one_line(text), size=size, color=color, weight=weight, ha=ha, va=va, zorder=5.0, parse_math=False)


def text_width(text: str, size: float, weight: str = "normal") -> float:
    """Width of a line of text [inch]."""
    font = FontProperties(size=size, weight=weight)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0]) / 72.0


def shortened(text: str, inches: float, size: float, weight: str = "normal") -> str:
    """Shorten ``text`` to about ``inches``; names differ at their ends, so characters in the middle are dropped."""
    text = one_line(text)
    width = text_width(text, size, weight)
    if width <= inches:
        return text
    length = max(1, int(len(text) * max(inches, 0.0) / width) - 2)
    head = 2 * length // 5
    return f"{text[:head]}…{text[len(text) - length + head :]}"


def tidy(axes: Axes) -> None:
    """Give axes a light grid, and a light frame at the left and below."""
    axes.grid(color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FRAME)


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Equivalent uniform ellipsoid of a body in the pose of the robot, in the world frame.

    ``centre (3,)`` and ``semi_axes (3,)`` [m], ``axes (3, 3)`` with their directions as columns, ``mass`` [kg].
    """

    centre: FloatArray
    semi_axes: FloatArray
    axes: FloatArray
    mass: float

    @staticmethod
    def of(parameters: FloatArray, rotation: FloatArray, origin: FloatArray) -> Ellipsoid:
        """Ellipsoid of inertial ``parameters (10,)`` of a link, given the pose of its frame in the world."""
        semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(parameters)
        centre = origin + rotation @ pseudo_inertia.centre_of_mass(parameters)
        return Ellipsoid(centre, semi_axes, rotation @ axes, float(parameters[0]))

    @property
    def is_finite(self) -> bool:
        """True if the ellipsoid can be drawn."""
        return all(np.all(np.isfinite(part)) for part in (self.centre, self.semi_axes, self.axes))

    def reach_from(self, origin: FloatArray) -> float:
        """Largest reach from an ``origin (3,)`` [m]."""
        return float(np.linalg.norm(self.centre - origin) + np.max(self.semi_axes))

    def thickened(self, least: float) -> Ellipsoid:
        """Return the ellipsoid with semi-axes of at least ``least`` [m], so that it is visible."""
        return replace(self, semi_axes=np.maximum(np.abs(self.semi_axes), least))

    def outline(self, directions: FloatArray) -> FloatArray:
        """Outline ``(2, K)`` [m] in orthographic projection: the unit circle under ``U S``, where ``U S V^T`` maps the
        unit sphere to the picture. ``directions (2, 3)`` point right and up."""
        turn, stretch, _ = np.linalg.svd(directions @ (self.axes * self.semi_axes))
        angle = np.linspace(0.0, 2.0 * np.pi, 97)
        circle = np.array([np.cos(angle), np.sin(angle)])
        return np.asarray((directions @ self.centre)[:, None] + (turn * stretch) @ circle)

    @property
    def surface(self) -> FloatArray:
        """Points ``(3, 49, 25)`` [m] on a grid of longitudes and latitudes about the third axis."""
        longitude, latitude = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 49), np.linspace(0.0, np.pi, 25), indexing="ij")
        level = np.sin(latitude)
        sphere = np.array([np.cos(longitude) * level, np.sin(longitude) * level, np.cos(latitude)])
        moved: FloatArray = np.tensordot(self.axes * self.semi_axes, sphere, 1) + self.centre[:, None, None]
        return moved

    def draw(self, axes: Any, color: Color) -> None:
        """Draw a translucent surface in 3D axes, lit from the upper left."""
        axes.plot_surface(*self.surface, color=color, alpha=0.6, linewidth=0.0, lightsource=LightSource(190.0, 45.0))

    def draw_wires(self, axes: Any, color: Color) -> None:
        """Draw the principal sections in 3D axes, in front of all surfaces."""
        for line in (*self.surface[:, ::12].swapaxes(0, 1), self.surface[:, :, 12]):
            axes.plot(*line, color=color, lw=0.8, zorder=700.0)


def frame_space(axes: Any, points: FloatArray) -> None:
    """Give 3D axes equal scales [m], and limits that contain ``points (K, 3)``."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.5 * np.maximum(0.05 * np.max(high - low) - (high - low), 0.0) + 1e-6
    ends = np.transpose([low - margin, high + margin])
    axes.set(**{f"{letter}lim": pair for letter, pair in zip("xyz", ends, strict=True)})
    axes.set_box_aspect(np.ptp(ends, axis=1), zoom=0.88)
    axes.patch.set_visible(False)
    axes.tick_params(labelsize=8.5, labelcolor=FAINT)
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_label_text(f"{name} [m]", size=8.5, color=FAINT)
        axis.labelpad = 3.0
        axis.set_pane_color("none")
        axis.line.set_color(FRAME)
        axis.set_major_locator(MaxNLocator(4))


# Name of the view along each world axis, and the axes to the right and up.
_VIEWS = (("from the front", "yz"), ("from the right", "xz"), ("from above", "xy"))


@dataclass(frozen=True, eq=False)
class PlacedLink:
    """Link of a prior with its pose in the world: ``rotation (3, 3)`` and ``origin (3,)`` of its frame."""

    link: LinkPrior
    rotation: FloatArray
    origin: FloatArray

    def in_world(self, points: FloatArray) -> FloatArray:
        """Transform points ``(N, 3)`` from the link's frame to the world."""
        return points @ self.rotation.T + self.origin


def prior_picture(path: Path, title: str, links: Sequence[PlacedLink]) -> None:
    """Draw the links, viewed along the two axes of their smallest extent, in orthographic projection, into the PNG
    ``path``."""
    corners = np.concatenate([placed.in_world(placed.link.solid.vertices) for placed in links if placed.link.solid])
    shortest = np.argsort(np.ptp(corners, axis=0), kind="stable")[:2]
    wide = np.ptp(corners[:, :2], axis=0).max() > 1.2 * np.ptp(corners[:, 2])
    figure = new_figure(12.0, 8.0)
    figure.suptitle(title, x=0.02, ha="left", weight="bold", parse_math=False)
    panels = figure.subplots(*((2, 1) if wide else (1, 2)))
    for panel, axis in zip(panels, shortest, strict=True):
        name, axes = _VIEWS[int(axis)]
        right, up = (np.eye(3)["xyz".index(letter)] for letter in axes)
        _draw(panel, links, np.array([right, up, np.cross(right, up)]))
        panel.set_title(f"{name} ({', '.join(axes)})", size="medium")
        panel.set_aspect("equal", adjustable="box")
        panel.set_xlabel("m")
    handles = [
        Line2D([], [], color=FRAME, lw=6, label="shapes"),
        Line2D([], [], color=IDENTIFIED, label="uniform ellipsoid of the same inertia, prior"),
        Line2D([], [], color=URDF, ls="--", label="the same for the URDF's inertial"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    write_picture(path, figure)


def _draw(axes: Axes, links: Sequence[PlacedLink], view: FloatArray) -> None:
    """Draw the links in one ``view (3, 3)``, whose rows point right, up, and towards the viewer. The limits ignore
    inertials of the URDF, which may lie far outside."""
    extents = []
    for placed in links:
        pose = placed.rotation, placed.origin
        if placed.link.solid is not None:
            vertices = placed.in_world(placed.link.solid.vertices) @ view.T
            _draw_shape(axes, vertices, placed.link.solid.triangles)
            extents.append(vertices[:, :2])
        if placed.link.before.parameters is not None and not placed.link.before.problem:
            outline = Ellipsoid.of(placed.link.before.parameters, *pose).outline(view[:2])
            axes.plot(*outline, color=URDF, ls="--", lw=1.0)
        if placed.link.parameters is not None:
            outline = Ellipsoid.of(placed.link.parameters, *pose).outline(view[:2])
            axes.plot(*outline, color=IDENTIFIED, lw=1.3)
            extents.append(outline.T)
    ends = np.concatenate(extents)
    margin = 0.05 * np.ptp(ends, axis=0).max()
    axes.set_xlim(ends[:, 0].min() - margin, ends[:, 0].max() + margin)
    axes.set_ylim(ends[:, 1].min() - margin, ends[:, 1].max() + margin)


def _draw_shape(axes: Axes, vertices: FloatArray, faces: IntArray) -> None:
    """Draw ``vertices (V, 3)`` in the view's axes, with nearer triangles in front of farther ones."""
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


def torque_picture(path: Path, title: str, names: Sequence[str], drawn: FloatArray, ranges: FloatArray) -> None:
    """Draw the PNG ``path``: width of the band of efforts of ``drawn`` robots and of ``ranges``, ``(joints,)`` in the
    order of the joint ``names``."""
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
    axes.set_xlabel("width of the 95 % band of efforts in fast motion (RMS)")
    tidy(axes)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    write_picture(path, figure)


Dots: TypeAlias = tuple[FloatArray, str]
"""Values ``(N,)`` to draw as dots, and their colour."""


def residual_svg(
    *,
    title: str,
    label: str,
    values: FloatArray,
    panels: Sequence[tuple[str, Sequence[Dots]]],
    limits: tuple[float, float],
    band: float,
) -> bytes:
    """Draw residuals against a variable into an SVG, small enough for a phone, in which text stays text.

    Args:
        title: title of the picture.
        label: name and unit of the variable.
        values: of the variable ``(N,)``.
        panels: name and unit of each panel, and its dots.
        limits: of the residuals.
        band: residuals that noise explains, either way.
    """
    figure = new_figure(4.3, 2.0 + 0.8 * len(panels))
    figure.suptitle(title, size=9.5, weight="bold", parse_math=False)
    axes = figure.subplots(len(panels), sharex=True, sharey=True, squeeze=False)[:, 0]
    for panel, (name, curves) in zip(axes, panels, strict=True):
        panel.axhspan(-band, band, color=FLOOR)
        for residual, color in curves:
            panel.plot(values, residual, ".", ms=1.5, alpha=0.65, color=color, rasterized=True)
        panel.set_ylabel(name, size=9.0, parse_math=False)
        panel.tick_params(labelsize=9.0, color=FRAME)
        tidy(panel)
    axes[-1].set_ylim(*limits)
    axes[-1].set_xlabel(label, size=9.0, parse_math=False)
    figure.align_ylabels()
    buffer = io.BytesIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": title}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
