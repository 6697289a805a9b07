"""One picture of an identification: the robot's bodies before and after, and what was measured against the models.

The robot is drawn in orthographic projection, where an ellipsoid's outline is an ellipse. Positions on the sheet are in
inches from its top left corner.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.textpath import text_to_path
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter
from matplotlib.transforms import Affine2D

from geomid_ros.files.atomic import write_bytes
from geomid_ros.types import BoolArray, FloatArray, IntArray

Place: TypeAlias = tuple[float, float, float, float]  # left, top, width, height [inch]
Color: TypeAlias = tuple[float, float, float]

DPI = 150
SIZE = (17.0, 10.0)  # of the sheet [inch]
MOST_PANELS = 12
MOST_ROWS = 30  # of the table of links

# Grey is the URDF and colour the identified, in the robot as over time. For the colour-blind: Okabe and Ito's
# vermilion, and a scale that darkens steadily.
_INK, _FAINT, _URDF, _IDENTIFIED = "#1a1a1a", "#6b7075", "#9a9fa5", "#d55e00"
_SHARES = LinearSegmentedColormap.from_list("share", ["#dcdcd8", "#9ad3c4", "#41b0c4", "#1d70b2", "#1f2a80"])

_BODIES = (0.25, 0.95, 9.25, 8.35)  # left, top, width, height of the robot with its table [inch]
_SERIES = (10.15, 1.30, 6.60, 8.00)
_NOTE_TOP = 9.48
_TABLE_WIDTH, _ROW = 3.9, 0.28

_CORE = (0.5, 99.5)  # percentiles between which a channel's ordinary values lie
_BINS = 500  # stretches of a long line; each keeps its smallest and largest value
_BADGE = 0.1  # radius of a link's number in the picture [inch]
_NONE = "—"
_LARGE, _SMALL, _FAR, _ABSENT = "▲", "▼", "◆", "✕"
_MARKS = {
    _LARGE: "larger than drawn (dashed)",
    _SMALL: "smaller than drawn (dashed)",
    _FAR: "farther away than drawn (dashed)",
    _ABSENT: "not drawn: not finite",
}


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A body's equivalent uniform ellipsoid in the robot's pose, in the world frame.

    ``centre (3,)`` and ``semi_axes (3,)`` [m], ``axes (3, 3)`` with their directions as columns, ``mass`` [kg].
    """

    centre: FloatArray
    semi_axes: FloatArray
    axes: FloatArray
    mass: float


@dataclass(frozen=True, eq=False)
class BodyDrawing:
    """A link: its frame's ``origin (3,)`` in the world [m], ``parent_origin (3,)`` where the stick to it starts.

    ``from_data``: share of the estimate that came from data, 0 to 1.
    """

    name: str
    origin: FloatArray
    parent_origin: FloatArray | None
    prior: Ellipsoid
    identified: Ellipsoid
    from_data: float


@dataclass(frozen=True, eq=False)
class Series:
    """A channel over time: ``times`` [s] and, in ``unit``, what was measured, what the URDF says (``nominal``) and what
    the identified model says (``predicted``); ``(N,)`` each, NaN where absent."""

    name: str
    unit: str
    times: FloatArray
    measured: FloatArray
    nominal: FloatArray
    predicted: FloatArray

    @property
    def rms(self) -> tuple[float, float]:
        """RMS residual of the URDF and of the identified model, NaN without a common sample."""
        return _rms(self.measured - self.nominal), _rms(self.measured - self.predicted)

    @property
    def ratio(self) -> float:
        """RMS after over RMS before: below 1 is better; NaN where that says nothing."""
        before, after = self.rms
        return after / before if before > 0 else float("nan")


@dataclass(frozen=True, eq=False)
class _View:
    """Orthographic: ``rotation (3, 3)`` has rows right, up, towards the viewer."""

    rotation: FloatArray

    def flat(self, points: FloatArray) -> FloatArray:
        """World points ``(..., 3)`` on the picture ``(..., 2)`` [m]."""
        return points @ self.rotation[:2].T

    def depth(self, point: FloatArray) -> float:
        """Larger is nearer to the viewer [m]."""
        return float(self.rotation[2] @ point)

    def sphere_map(self, body: Ellipsoid) -> FloatArray:
        """``(3, 3)``: takes the unit sphere to the ellipsoid about its centre, in the view's axes [m]."""
        return self.rotation @ (body.axes * body.semi_axes)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A body as it goes onto the sheet: with sizes and places that can be seen, and the marks that say so."""

    number: int
    body: BodyDrawing
    prior_marks: str
    identified_marks: str

    @property
    def marks(self) -> str:
        return "".join(mark for mark in _MARKS if mark in self.prior_marks + self.identified_marks)


def identification_picture(
    path: Path, title: str, bodies: Sequence[BodyDrawing], series: Sequence[Series], note: str
) -> None:
    """Draw bodies and channels into the PNG ``path``, which appears whole or not at all."""
    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    heading = _shortened(title, _SERIES[0] - _BODIES[0] - 0.2, 17.0, "bold")
    _text(figure, _BODIES[0], 0.42, heading, 17.0, weight="bold")
    wrapped = textwrap.fill(note, 190, max_lines=3, placeholder=" …")
    _text(figure, _BODIES[0], _NOTE_TOP, wrapped, color=_FAINT, va="top")
    if bodies:
        _draw_bodies(figure, _made_visible(bodies))
    _draw_series(figure, series)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    write_bytes(path, buffer.getvalue())


# --- The sheet ---


def _axes(figure: Figure, place: Place, share: Axes | None = None) -> Axes:
    left, top, width, height = place
    rectangle = (left / SIZE[0], 1.0 - (top + height) / SIZE[1], width / SIZE[0], height / SIZE[1])
    return figure.add_axes(rectangle, sharex=share)


def _area(figure: Figure, place: Place) -> Axes:
    """Axes without a frame whose coordinates are inches from the top left corner."""
    axes = _axes(figure, place)
    axes.set_axis_off()
    axes.set_xlim(0.0, place[2])
    axes.set_ylim(place[3], 0.0)
    return axes


def _text(
    where: Figure | Axes,
    x: float,
    y: float,
    text: str,
    size: float = 9.5,
    color: str = _INK,
    weight: str = "normal",
    ha: str = "left",
    va: str = "center",
    zorder: float = 5.0,
) -> None:
    """Text at (x, y) inches from the top left corner of a figure or an area; a dollar sign is no formula."""
    if isinstance(where, Figure):
        x, y = x / SIZE[0], 1.0 - y / SIZE[1]
    where.text(x, y, text, size=size, color=color, weight=weight, ha=ha, va=va, zorder=zorder, parse_math=False)


def _width(text: str, size: float, weight: str = "normal") -> float:
    """Of a line of text [inch]."""
    font = FontProperties(size=size, weight=weight)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0]) / 72.0


def _shortened(text: str, inches: float, size: float, weight: str = "normal") -> str:
    """``text`` no wider than ``inches``: names differ at their ends, so something inside is left out."""
    short = text
    for length in range(len(text) - 1, 1, -1):
        if _width(short, size, weight) <= inches:
            break
        head = 2 * length // 5
        short = f"{text[:head]}…{text[len(text) - length + head :]}"
    return short


def _number(value: float) -> str:
    """Three digits, with an exponent only where it is shorter."""
    if not np.isfinite(value):
        return _NONE
    if value == 0.0:
        return "0"
    magnitude = int(np.floor(np.log10(abs(value))))
    if magnitude < -3 or magnitude > 4:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.{max(2 - magnitude, 0)}f}"


def _share(from_data: float) -> float:
    return float(np.clip(from_data, 0.0, 1.0)) if np.isfinite(from_data) else 0.0


def _ink_on(color: Color) -> str:
    """What can be read on ``color``: black or white."""
    return _INK if float(np.dot(color, (0.299, 0.587, 0.114))) > 0.55 else "white"


# --- The robot ---


def _made_visible(bodies: Sequence[BodyDrawing]) -> list[_Drawn]:
    limit = _limit(bodies)
    drawn = []
    for number, body in enumerate(bodies, start=1):
        prior, prior_marks = _fitted(body.prior, body.origin, limit)
        identified, marks = _fitted(body.identified, body.origin, limit)
        drawn.append(_Drawn(number, replace(body, prior=prior, identified=identified), prior_marks, marks))
    return drawn


def _limit(bodies: Sequence[BodyDrawing]) -> float:
    """Longest semi-axis, and distance from its link's origin, that an ellipsoid is drawn with [m].

    In proportion to the robot, or to most of its bodies where the frames lie close together.
    """
    joints = _joints(bodies)
    robot = float(np.linalg.norm(np.ptp(joints, axis=0)))
    reaches = [np.linalg.norm(body.prior.centre - body.origin) + np.max(body.prior.semi_axes) for body in bodies]
    finite = [reach for reach in reaches if np.isfinite(reach)]
    return max(0.5 * robot, 1.5 * float(np.median(finite)) if finite else 0.0) or 1.0


def _joints(bodies: Sequence[BodyDrawing]) -> FloatArray:
    """Where sticks begin and end, ``(K, 3)`` [m]."""
    return np.array([end for body in bodies for end in (body.parent_origin, body.origin) if end is not None])


def _fitted(body: Ellipsoid, origin: FloatArray, limit: float) -> tuple[Ellipsoid, str]:
    """The ellipsoid in a size and place that the picture can show, and the marks that tell of the difference."""
    if not all(np.all(np.isfinite(part)) for part in (body.centre, body.semi_axes, body.axes)):
        return body, _ABSENT
    marks, centre, semi_axes = "", body.centre, np.abs(body.semi_axes)
    distance, largest = float(np.linalg.norm(centre - origin)), float(np.max(semi_axes))
    if distance > limit:
        marks += _FAR
        centre = origin + (centre - origin) * limit / distance
    if largest > limit:
        marks += _LARGE
        semi_axes = semi_axes * limit / largest
    elif largest < 0.01 * limit:
        marks += _SMALL
        semi_axes = np.full(3, 0.01 * limit)
    return replace(body, centre=centre, semi_axes=np.maximum(semi_axes, 1e-3 * limit)), marks


def _solids(drawn: Sequence[_Drawn]) -> list[Ellipsoid]:
    """All ellipsoids that are drawn."""
    pairs = [(d.body.prior, d.prior_marks) for d in drawn] + [(d.body.identified, d.identified_marks) for d in drawn]
    return [solid for solid, marks in pairs if marks != _ABSENT]


def _view(points: FloatArray) -> _View:
    """From slightly above, across the direction in which ``points (K, 3)`` spread, and turned a little for depth.

    A person who faces x is seen from the front, an arm that reaches along x from its right.
    """
    level = points[:, :2] - points[:, :2].mean(axis=0)
    variances, directions = np.linalg.eigh(level.T @ level)
    usual, azimuth = np.radians(-45.0), np.radians(-60.0)
    if variances[1] > 1e-3 * np.sum((points - points.mean(axis=0)) ** 2):
        across = directions[:, 0] * np.where(directions[:, 0] @ (1.0, -1.0) < 0.0, -1.0, 1.0)
        offset = np.angle(np.exp(1j * (np.arctan2(across[1], across[0]) - usual)))
        azimuth = usual + offset - np.clip(offset, -np.radians(25.0), np.radians(25.0))
    elevation = np.radians(16.0)
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return _View(np.array([right, np.cross(towards, right), towards]))


def _draw_bodies(figure: Figure, drawn: Sequence[_Drawn]) -> None:
    bodies, solids = [d.body for d in drawn], _solids(drawn)
    points = np.vstack([_joints(bodies), *(solid.centre for solid in solids)])
    view = _view(points)
    floor, step = _floor(points, solids)
    low, high = _bounds(view, np.vstack([points, floor.reshape(-1, 3)]), solids)
    robot, table, key = _layout(high - low, drawn)
    axes, inch = _robot_axes(figure, robot, low, high)
    _draw_floor(axes, view, floor)
    _draw_compass(axes, view, inch, f"floor grid {step:g} m")
    _draw_sticks(axes, view, bodies)
    for d in drawn:
        if d.identified_marks != _ABSENT:
            _draw_identified(axes, view, d)
        if d.prior_marks != _ABSENT:
            _draw_prior(axes, view, d)
    _draw_badges(axes, view, drawn, inch)
    _draw_table(_area(figure, table), drawn)
    _draw_key(figure, key, drawn)


def _layout(extent: FloatArray, drawn: Sequence[_Drawn]) -> tuple[Place, Place, Place]:
    """Places of the robot, of the table and of the key: table beside or below, whichever lets the robot be larger.

    ``extent (2,)``: of the robot on the picture [m].
    """
    left, top, width, height = _BODIES
    key_height = 1.15 + 0.21 * len(_marks_present(drawn))
    table_height = 0.32 + _ROW * (min(len(drawn), MOST_ROWS) + (len(drawn) > MOST_ROWS))
    beside = (left, top, width - _TABLE_WIDTH - 0.1, height)
    below = (left, top, width, height - max(table_height, key_height) - 0.35)
    if _scale(below, extent) > _scale(beside, extent):
        bottom = top + height
        table = (left + 0.3, bottom - max(table_height, key_height), _TABLE_WIDTH, table_height)
        return below, table, (left + width - _TABLE_WIDTH, table[1], _TABLE_WIDTH, key_height)
    column = left + width - _TABLE_WIDTH
    table_height = min(table_height, height - key_height - 0.3)
    key = (column, top + table_height + 0.3, _TABLE_WIDTH, key_height)
    return beside, (column, top, _TABLE_WIDTH, table_height), key


def _scale(place: Place, extent: FloatArray) -> float:
    """Inches for a metre when ``extent (2,)`` [m] fills the place but for a margin; negative without room."""
    return float(np.min((np.array(place[2:]) - 0.4) / np.maximum(extent, 1e-3)))


def _bounds(view: _View, points: FloatArray, solids: Sequence[Ellipsoid]) -> tuple[FloatArray, FloatArray]:
    """Lower left and upper right corner ``(2,)`` of points ``(K, 3)`` and ellipsoids on the picture [m]."""
    centres = np.array([view.flat(solid.centre) for solid in solids]).reshape(-1, 2)
    halves = np.array([_half_widths(view, solid) for solid in solids]).reshape(-1, 2)
    ends = np.vstack([view.flat(points), centres - halves, centres + halves])
    return ends.min(axis=0), ends.max(axis=0)


def _half_widths(view: _View, solid: Ellipsoid) -> FloatArray:
    """Half the extent of the ellipsoid on the picture, ``(2,)`` [m]."""
    halves: FloatArray = np.linalg.norm(view.sphere_map(solid)[:2], axis=1)
    return halves


def _robot_axes(figure: Figure, place: Place, low: FloatArray, high: FloatArray) -> tuple[Axes, float]:
    """Axes in metres, as long upwards as sideways, around corners ``(2,)`` [m]; and the metres to an inch."""
    axes = _axes(figure, place)
    axes.set_axis_off()
    inch = 1.0 / _scale(place, high - low)
    middle, half = (low + high) / 2.0, np.array(place[2:]) * inch / 2.0
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    return axes, inch


def _floor(points: FloatArray, solids: Sequence[Ellipsoid]) -> tuple[FloatArray, float]:
    """A grid below points ``(K, 3)`` and ellipsoids: crossings ``(rows, columns, 3)``, distance of the lines [m]."""
    halves = np.array([np.linalg.norm(solid.axes * solid.semi_axes, axis=1) for solid in solids]).reshape(-1, 3)
    centres = np.array([solid.centre for solid in solids]).reshape(-1, 3)
    ends = np.vstack([points, centres - halves, centres + halves])
    step = _round_step((float(np.max(np.ptp(ends, axis=0))) or 1.0) / 7.0)
    low, high = np.floor(ends.min(axis=0) / step), np.ceil(ends.max(axis=0) / step)
    x, y = (step * np.arange(low[k], high[k] + 1.0) for k in range(2))
    return np.stack(np.broadcast_arrays(x[:, None], y[None, :], ends[:, 2].min()), axis=-1), step


def _round_step(rough: float) -> float:
    """1, 2 or 5 times a power of ten, near ``rough``."""
    power = 10.0 ** np.floor(np.log10(rough))
    return float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda factor: abs(np.log(factor * power / rough))))


def _draw_floor(axes: Axes, view: _View, floor: FloatArray) -> None:
    flat = view.flat(floor)
    for line in (*flat, *flat.transpose(1, 0, 2)):
        axes.plot(*line.T, color="#e4e6e8", lw=0.8, zorder=0.0)


def _draw_compass(axes: Axes, view: _View, inch: float, label: str) -> None:
    """The world's axes in the lower left corner, and a label beside them."""
    start = np.array([axes.get_xlim()[0], axes.get_ylim()[0]]) + 0.2 * inch
    for axis, name in zip(view.rotation[:2].T, "xyz", strict=True):
        axes.plot(*np.transpose([start, start + 0.33 * inch * axis]), color=_FAINT, lw=1.3, zorder=0.1)
        end = start + 0.45 * inch * axis
        _text(axes, end[0], end[1], name, 8.5, _FAINT, ha="center")
    _text(axes, start[0] + 0.6 * inch, start[1] - 0.05 * inch, label, 8.5, _FAINT)


def _draw_sticks(axes: Axes, view: _View, bodies: Sequence[BodyDrawing]) -> None:
    for body in bodies:
        if body.parent_origin is not None:
            stick = view.flat(np.array([body.parent_origin, body.origin]))
            axes.plot(*stick.T, color="#3c4043", lw=3.0, solid_capstyle="round", zorder=2.0)
    axes.plot(*view.flat(_joints(bodies)).T, "o", ms=5.5, mfc="white", mec="#3c4043", mew=1.3, zorder=2.1)


def _draw_identified(axes: Axes, view: _View, d: _Drawn) -> None:
    """A shaded, translucent ellipsoid in the colour of its share from data.

    With the view's part of the sphere map ``U S V^T``, the unit disk under ``U S`` is the outline.
    """
    solid, color = d.body.identified, _SHARES(_share(d.body.from_data))[:3]
    sphere_map = view.sphere_map(solid)
    turn, stretch, back = np.linalg.svd(sphere_map[:2])
    outline = np.vstack([np.column_stack([turn * stretch, view.flat(solid.centre)]), (0.0, 0.0, 1.0)])
    to_sheet = Affine2D(outline) + axes.transData
    order = 1.0 + 0.5 * np.arctan(view.depth(solid.centre)) / np.pi  # nearer ones over those farther away
    image = AxesImage(axes, extent=(-1.0, 1.0, -1.0, 1.0), origin="lower", interpolation="bilinear", zorder=order)
    image.set_data(_shaded_disk(sphere_map, back, color))
    image.set_transform(to_sheet)
    image.set_clip_path(Circle((0.0, 0.0), 1.0, transform=to_sheet))
    axes.add_artist(image)
    width, style = (1.3, "--") if d.identified_marks else (0.9, "-")
    edge = tuple(0.6 * np.array(color))
    axes.add_artist(Circle((0.0, 0.0), 1.0, transform=to_sheet, fill=False, ec=edge, lw=width, ls=style, zorder=order))


def _shaded_disk(sphere_map: FloatArray, back: FloatArray, color: Color) -> FloatArray:
    """Colours ``(128, 128, 4)`` of the ellipsoid's near side over its unit disk, lit from the upper left.

    ``back (3, 3)``: rows are the disk's two directions and the line of sight on the unit sphere.
    """
    u, v = np.meshgrid(*2 * [np.linspace(-1.0, 1.0, 128)])
    w = np.sqrt(np.clip(1.0 - u**2 - v**2, 0.0, 1.0))
    inverse = np.linalg.inv(sphere_map)
    sight = back[2] * np.sign(back[2] @ inverse[:, 2])
    sphere = u[..., None] * back[0] + v[..., None] * back[1] + w[..., None] * sight
    normals = sphere @ inverse
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = np.array([-0.45, 0.65, 0.61])
    bright = 0.74 + 0.38 * np.clip(normals @ light, -0.6, 1.0)[..., None]
    alpha = 0.55 + 0.3 * (1.0 - w[..., None]) ** 2
    return np.concatenate([np.clip(np.array(color) * bright, 0.0, 1.0), alpha], axis=-1)


def _draw_prior(axes: Axes, view: _View, d: _Drawn) -> None:
    """Outline and principal sections of the URDF's ellipsoid."""
    solid = d.body.prior
    sphere_map = view.sphere_map(solid)
    angle = np.linspace(0.0, 2.0 * np.pi, 97)
    circle = np.array([np.cos(angle), np.sin(angle)])
    turn, stretch, _ = np.linalg.svd(sphere_map[:2])
    centre = view.flat(solid.centre)[:, None]
    style = (0, (4, 2)) if d.prior_marks else "-"
    axes.plot(*(centre + (turn * stretch) @ circle), color=_URDF, lw=1.1, ls=style, zorder=1.6)
    for k in range(3):
        section = np.delete(sphere_map[:2], k, axis=1) @ circle
        axes.plot(*(centre + section), color=_URDF, lw=0.55, alpha=0.9, zorder=1.6)


def _draw_badges(axes: Axes, view: _View, drawn: Sequence[_Drawn], inch: float) -> None:
    """Each body's number at its centre, or beside it where it would hide the body or another number."""
    shown = [d.identified_marks != _ABSENT for d in drawn]
    anchors = [d.body.identified.centre if s else d.body.origin for d, s in zip(drawn, shown, strict=True)]
    at = view.flat(np.array(anchors)) / inch
    small = [
        s and max(_half_widths(view, d.body.identified)) < _BADGE * inch for d, s in zip(drawn, shown, strict=True)
    ]
    places = _spread(at + np.outer(small, (2.5 * _BADGE, _BADGE)), 2.3 * _BADGE)
    for d, anchor, place in zip(drawn, at * inch, places * inch, strict=True):
        if np.linalg.norm(place - anchor) > 0.5 * _BADGE * inch:
            axes.plot(*np.transpose([anchor, place]), color=_INK, lw=0.7, zorder=3.0)
            axes.plot(*anchor, "o", ms=2.5, color=_INK, zorder=3.0)
        _draw_badge(axes, place[0], place[1], d, inch)


def _draw_badge(axes: Axes, x: float, y: float, d: _Drawn, inch: float) -> None:
    """A link's number on its colour; ``inch`` in the axes' coordinates."""
    color = _SHARES(_share(d.body.from_data))[:3]
    axes.add_artist(Circle((x, y), _BADGE * inch, fc=color, ec="white", lw=1.0, zorder=4.0))
    _text(axes, x, y, str(d.number), 7.5, _ink_on(color), "bold", ha="center", va="center_baseline")


def _spread(points: FloatArray, distance: float) -> FloatArray:
    """``points (K, 2)`` pushed apart until none are closer than ``distance``, as far as some rounds get."""
    turns = 2.4 * np.arange(len(points))
    places = points + 1e-6 * distance * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for _ in range(300):
        apart = places[:, None] - places
        lengths = np.linalg.norm(apart, axis=-1) + np.eye(len(places)) * 1e9
        push = np.clip(distance - lengths, 0.0, None) / 2.0
        if not np.any(push > 1e-3 * distance):
            break
        places = places + 0.5 * np.sum(apart / lengths[..., None] * push[..., None], axis=1)
    return places


# --- The table of links ---


def _draw_table(area: Axes, drawn: Sequence[_Drawn]) -> None:
    shown = _listed(drawn)
    hidden = len(drawn) - len(shown)
    for x, text, ha in ((0.0, "link", "left"), (2.74, "mass [kg]", "right"), (_TABLE_WIDTH, "from data", "right")):
        _text(area, x, 0.06, text, 9.5, _FAINT, ha=ha)
    area.plot([0.0, _TABLE_WIDTH], [0.22, 0.22], color="#c8cbce", lw=0.8)
    row = (area.get_ylim()[0] - 0.32) / (len(shown) + (hidden > 0))
    for k, d in enumerate(shown):
        _draw_row(area, 0.32 + (k + 0.5) * row, d)
    if hidden:
        _text(area, 0.32, 0.32 + (len(shown) + 0.5) * row, f"and {hidden} with less from data", 9.0, _FAINT)


def _listed(drawn: Sequence[_Drawn]) -> list[_Drawn]:
    most = sorted(drawn, key=lambda d: -_share(d.body.from_data))[:MOST_ROWS]
    return sorted(most, key=lambda d: d.number)


def _draw_row(area: Axes, y: float, d: _Drawn) -> None:
    share = _share(d.body.from_data)
    color = _SHARES(share)[:3]
    name = f"{_shortened(d.body.name, 1.3 - 0.16 * len(d.marks), 9.0)} {d.marks}"
    _draw_badge(area, _BADGE, y, d, 1.0)
    _text(area, 0.28, y, name, 9.0)
    _text(area, 2.05, y, _number(d.body.prior.mass), 9.5, _FAINT, ha="right")
    _text(area, 2.17, y, "→", 9.5, _FAINT, ha="center")
    _text(area, 2.74, y, _number(d.body.identified.mass), 9.5, weight="bold", ha="right")
    area.add_artist(Rectangle((2.92, y - 0.055), 0.5, 0.11, fc="#eceeef", lw=0.0))
    area.add_artist(Rectangle((2.92, y - 0.055), 0.5 * share, 0.11, fc=color, lw=0.0))
    percent = f"{100.0 * d.body.from_data:.0f} %" if np.isfinite(d.body.from_data) else _NONE
    _text(area, _TABLE_WIDTH, y, percent, 9.5, ha="right")


def _draw_key(figure: Figure, place: Place, drawn: Sequence[_Drawn]) -> None:
    """What the ellipsoids mean, the colour bar, and the marks that occur."""
    area = _area(figure, place)
    _text(area, 0.0, 0.06, "Ellipsoids: uniform bodies of the same mass and inertia", 9.0, _FAINT)
    area.add_artist(Circle((0.1, 0.35), 0.09, fill=False, ec=_URDF, lw=1.1))
    area.add_artist(Circle((0.95, 0.35), 0.09, fc=_SHARES(0.6), ec="none"))
    _text(area, 0.26, 0.35, "URDF", 9.0)
    _text(area, 1.11, 0.35, "identified, coloured by its share from data:", 9.0)
    bar = _axes(figure, (place[0] + 0.1, place[1] + 0.58, place[2] - 0.3, 0.14))
    scale = ScalarMappable(Normalize(0.0, 1.0), _SHARES)
    colorbar = figure.colorbar(scale, cax=bar, orientation="horizontal", format=PercentFormatter(1.0, symbol=" %"))
    colorbar.outline.set_visible(False)
    bar.tick_params(labelsize=8.5, color=_FAINT, length=2.5)
    for k, mark in enumerate(_marks_present(drawn)):
        _text(area, 0.0, 1.2 + 0.21 * k, f"{mark} {_MARKS[mark]}", 8.5, _FAINT)


def _marks_present(drawn: Sequence[_Drawn]) -> list[str]:
    return [mark for mark in _MARKS if any(mark in d.marks for d in drawn)]


# --- The channels ---


@dataclass(frozen=True, eq=False)
class _Clock:
    """From stamps to seconds since the first one; pauses that would leave little room for the rest are shortened.

    ``stamps (K,)`` [s] ascending, ``seconds (K,)`` where they are on the axis.
    """

    stamps: FloatArray
    seconds: FloatArray
    label: str

    @staticmethod
    def of(series: Sequence[Series]) -> _Clock:
        stamps = np.unique(np.concatenate([channel.times for channel in series]))
        stamps = stamps[np.isfinite(stamps)]
        if len(stamps) < 2:
            return _Clock(np.array([0.0, 1.0]) + stamps.sum(), np.array([0.0, 1.0]), "time [s]")
        steps = np.diff(stamps)
        recorded = float(np.sum(steps[~_long(steps)]))
        pauses = _long(steps) & (steps > 0.1 * recorded)
        seconds = np.concatenate([[0.0], np.cumsum(np.where(pauses, 0.03 * recorded, steps))])
        return _Clock(stamps, seconds, "time [s], pauses shortened" if np.any(pauses) else "time [s]")

    def at(self, times: FloatArray) -> FloatArray:
        """Seconds on the axis, like ``times``."""
        return np.interp(times, self.stamps, self.seconds)


def _draw_series(figure: Figure, series: Sequence[Series]) -> None:
    shown = _most_improved(series)
    left, top, width, height = _SERIES
    _draw_series_header(figure, series, len(shown))
    if not shown:
        return
    columns = 1 if len(shown) <= 6 else 2
    rows = -(-len(shown) // columns)
    clock = _Clock.of(shown)
    cell = (width / columns, min(height / rows, 3.2))
    first: Axes | None = None
    for k, channel in enumerate(shown):
        row, column = divmod(k, columns)
        place = (left + column * cell[0] + 0.30 * column, top + row * cell[1] + 0.1, cell[0] - 0.30, cell[1] - 0.42)
        axes = _axes(figure, place, first)
        first = first or axes
        _draw_channel(axes, channel, clock, place[2], lowest=k + columns >= len(shown))


def _most_improved(series: Sequence[Series]) -> list[Series]:
    """At most ``MOST_PANELS``, in their own order."""
    ratios = np.array([channel.ratio for channel in series])
    best = np.argsort(np.where(np.isfinite(ratios), ratios, np.inf), kind="stable")[:MOST_PANELS]
    return [series[k] for k in np.sort(best)]


def _draw_series_header(figure: Figure, series: Sequence[Series], shown: int) -> None:
    better = sum(channel.ratio < 1.0 for channel in series)
    worse = sum(channel.ratio > 1.0 for channel in series)
    text = f"RMS residual fell in {better} of {len(series)} channels" + (f", rose in {worse}" if worse else "")
    if shown < len(series):
        text += f"; the {shown} with the largest improvement are shown"
    _text(figure, _SERIES[0], 0.72, text, 9.5, _FAINT)
    handles = [
        Line2D([], [], color=_INK, lw=1.8, label="measured"),
        Line2D([], [], color=_URDF, lw=1.2, ls="--", label="URDF"),
        Line2D([], [], color=_IDENTIFIED, lw=1.2, label="identified"),
    ]
    corner = ((_SERIES[0] - 0.08) / SIZE[0], 1.0 - 0.42 / SIZE[1])
    figure.legend(
        handles=handles, loc="center left", bbox_to_anchor=corner, ncol=3, frameon=False, fontsize=10.5, borderpad=0
    )


def _draw_channel(axes: Axes, channel: Series, clock: _Clock, width: float, lowest: bool) -> None:
    """In a panel ``width`` inches wide; the ``lowest`` of a column names the times."""
    axes.plot(*_thinned(channel.times, channel.measured, clock), color=_INK, lw=1.5)
    axes.plot(*_thinned(channel.times, channel.nominal, clock), color=_URDF, lw=1.1, ls="--")
    axes.plot(*_thinned(channel.times, channel.predicted, clock), color=_IDENTIFIED, lw=0.9)
    axes.set_ylim(*_limits(channel))
    change, unit = _change(channel), f" [{channel.unit}]"
    room = width - _width(change, 9.0) - _width(unit, 9.0, "bold") - 0.1
    name = _shortened(channel.name, room, 9.0, "bold") + unit
    axes.set_title(name, loc="left", size=9.0, pad=3.0, weight="bold", parse_math=False)
    axes.set_title(change, loc="right", size=9.0, pad=3.0)
    axes.tick_params(labelsize=8.5, color=_FAINT, labelcolor=_INK, length=2.5, labelbottom=lowest)
    axes.set_xlim(clock.seconds[0], clock.seconds[-1])
    axes.grid(color="#eceeef", lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#c8cbce")
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "\N{MINUS SIGN}")))
    if lowest:
        axes.set_xlabel(clock.label, size=9.0, labelpad=1.5)


def _change(channel: Series) -> str:
    before, after = channel.rms
    if not np.any(np.isfinite(channel.measured)):
        return "not measured"
    return f"RMS {_number(before)} → {_number(after)}"


def _rms(residuals: FloatArray) -> float:
    finite = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def _limits(channel: Series) -> tuple[float, float]:
    """Limits of y: all but 1 % of what was measured and identified, and of the rest what comes within one such span."""
    core = np.concatenate([channel.measured, channel.predicted])
    everything = np.concatenate([core, channel.nominal])
    everything = everything[np.isfinite(everything)]
    if len(everything) == 0:
        return -1.0, 1.0
    core = core[np.isfinite(core)]
    if len(core) == 0 or np.ptp(np.percentile(core, _CORE)) == 0.0:
        core = everything
    low, high = np.percentile(core, _CORE)
    span = max(high - low, 1e-3 * max(abs(low), abs(high))) or 1.0
    bottom, top = max(everything.min(), low - span), min(everything.max(), high + span)
    margin = max(0.07 * (top - bottom), 0.5 * (span - (top - bottom)))
    return float(bottom - margin), float(top + margin)


def _thinned(times: FloatArray, values: FloatArray, clock: _Clock) -> tuple[FloatArray, FloatArray]:
    """A line for drawing: no more points than can be seen but with every peak, and broken by NaN at gaps in time."""
    finite = np.flatnonzero(np.isfinite(times) & np.isfinite(values))
    order = finite[np.argsort(times[finite], kind="stable")]
    times, values = times[order], values[order]
    if len(times) < 3:
        return clock.at(times), values
    gaps = np.flatnonzero(_long(np.diff(times)))
    kept = np.union1d(_extremes(values), [*gaps, *(gaps + 1)]).astype(np.int64)
    breaks = np.searchsorted(kept, gaps + 1)
    return np.insert(clock.at(times[kept]), breaks, np.nan), np.insert(values[kept], breaks, np.nan)


def _long(steps: FloatArray) -> BoolArray:
    """Which steps in time are pauses rather than the ordinary distance of samples."""
    longer: BoolArray = steps > 5.0 * np.median(steps)
    return longer


def _extremes(values: FloatArray) -> IntArray:
    """Indices of the smallest and the largest value in each of at most ``_BINS`` stretches, and of both ends."""
    if len(values) <= 2 * _BINS:
        return np.arange(len(values))
    length = -(-len(values) // _BINS)
    padded = np.pad(values, (0, -len(values) % length), mode="edge").reshape(-1, length)
    starts = np.arange(len(padded)) * length
    picked = np.concatenate([[0], starts + padded.argmin(axis=1), starts + padded.argmax(axis=1), [len(values) - 1]])
    return np.unique(np.minimum(picked, len(values) - 1))
