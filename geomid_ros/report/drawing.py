"""Picture of an identification: bodies before and after, and measured and predicted channels."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter
from matplotlib.transforms import Affine2D

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.samples import Samples
from geomid_ros.report import ellipsoids
from geomid_ros.report.ellipsoids import BodyDrawing, Ellipsoid, View
from geomid_ros.report.page import (
    DOUBT,
    FAINT,
    FRAME,
    GRID,
    IDENTIFIED,
    INK,
    MEASURED,
    NONE,
    SHARES,
    STICKS,
    URDF,
)
from geomid_ros.report.page import number as written
from geomid_ros.report.pictures import (
    CHANNELS,
    ROBOT,
    SIZE,
    AxesRectangle,
    add_area,
    add_axes,
    add_text,
    new_figure,
    shortened,
    text_width,
    tidy,
)
from geomid_ros.report.series import MOST_DRAWN, Clock, Series, limits, thinned
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray


def draw_identification(
    session: Session,
    estimate: Estimate,
    batches: Sequence[Samples],
    series: Sequence[Series],
    of_what: str,
    doubts: Sequence[str],
) -> Figure:
    """Draw the bodies before and after, and every measured channel over time.

    Args:
        session: session of the identification.
        estimate: the estimate.
        batches: samples in the order of time; the bodies are drawn in the pose of the middle one.
        series: their channels.
        of_what: name of these samples.
        doubts: why the estimate cannot be used, in sentences.
    """
    return identification_figure(
        f"{session.robot.name}: identified link inertias",
        _bodies(session, estimate, _middle(batches)),
        series,
        f"Measured and predicted on {of_what}; identified from {estimate.rows_accepted} rows.",
        doubts,
    )


def identification_figure(
    title: str, bodies: Sequence[BodyDrawing], series: Sequence[Series], note: str, doubts: Sequence[str] = ()
) -> Figure:
    """Draw bodies and channels, with ``doubts`` below the title and a ``note`` below all."""
    figure = new_figure(*SIZE, layout=None)
    left, top, _, height = ROBOT
    heading = shortened(title, CHANNELS[0] - left, 17.0, "bold")
    add_text(figure, left, 0.42, heading, 17.0, weight="bold")
    for k, line in enumerate(textwrap.wrap(" ".join(doubts), 115, max_lines=2, placeholder=" …")):
        add_text(figure, left, 0.66 + 0.16 * k, line, size=9.0, color=DOUBT, weight="bold")
    for k, line in enumerate(textwrap.wrap(note, 190, max_lines=3, placeholder=" …")):
        add_text(figure, left, top + height + 0.2 + 0.16 * k, line, color=FAINT, va="top")
    if bodies:
        draw_bodies(figure, bodies)
    draw_series(figure, series)
    return figure


def _bodies(session: Session, estimate: Estimate, pose: Samples) -> list[BodyDrawing]:
    robot = session.robot
    frames = robot.link_frames(pose)
    nominal = session.model.nominal_inertias.reshape(-1, 10)
    return [
        BodyDrawing(
            link.name,
            frames[link.name][1],
            frames[parent][1] if (parent := robot.parent_body(link.name)) else None,
            Ellipsoid.of(nominal[index], *frames[link.name]),
            Ellipsoid.of(link.parameters, *frames[link.name]),
            link.from_data,
            std_mass=link.std_mass,
        )
        for index, link in enumerate(estimate.links)
    ]


def _middle(batches: Sequence[Samples]) -> Samples:
    """Sample in the middle of the batches."""
    ends = np.cumsum([len(samples) for samples in batches])
    batch = int(np.searchsorted(ends, ends[-1] // 2, side="right"))
    place = int(ends[-1] // 2 - ends[batch]) + len(batches[batch])
    return batches[batch].select(slice(place, place + 1))


def draw_series(figure: Figure, series: Sequence[Series]) -> None:
    """Draw the most improved channels."""
    shown = _most_improved(series)
    left, top, width, height = CHANNELS
    _draw_series_header(figure, series, len(shown))
    if not shown:
        return
    columns = 1 if len(shown) <= 6 else 2
    rows = -(-len(shown) // columns)
    clock = Clock.of(shown)
    cell = (width / columns, min(height / rows, 3.2))
    shared: Axes | None = None
    for k, channel in enumerate(shown):
        row, column = divmod(k, columns)
        place = (left + column * cell[0] + 0.30 * column, top + row * cell[1] + 0.1, cell[0] - 0.30, cell[1] - 0.42)
        axes = add_axes(figure, place, shared)
        shared = shared or axes
        _draw_channel(axes, channel, clock, place[2], lowest=k + columns >= len(shown))


def _most_improved(series: Sequence[Series]) -> list[Series]:
    """Select at most ``MOST_DRAWN`` channels with the largest improvement, in their original order."""
    ratios = np.array([channel.ratio for channel in series])
    best = np.argsort(np.where(np.isfinite(ratios), ratios, np.inf), kind="stable")[:MOST_DRAWN]
    return [series[k] for k in np.sort(best)]


def _draw_series_header(figure: Figure, series: Sequence[Series], shown: int) -> None:
    better = sum(channel.ratio < 1.0 for channel in series)
    worse = sum(channel.ratio > 1.0 for channel in series)
    text = f"RMS residual fell in {better} of {len(series)} channels" + (f", rose in {worse}" if worse else "")
    if shown < len(series):
        text += f"; the {shown} with the largest improvement are shown"
    add_text(figure, CHANNELS[0], 0.72, text, 9.5, FAINT)
    handles = [
        Line2D([], [], color=MEASURED, lw=1.8, label="measured"),
        Line2D([], [], color=URDF, lw=1.2, ls="--", label="URDF"),
        Line2D([], [], color=IDENTIFIED, lw=1.2, label="identified"),
    ]
    corner = ((CHANNELS[0] - 0.08) / SIZE[0], 1.0 - 0.42 / SIZE[1])
    figure.legend(
        handles=handles, loc="center left", bbox_to_anchor=corner, ncol=3, frameon=False, fontsize=10.5, borderpad=0
    )


def _draw_channel(axes: Axes, channel: Series, clock: Clock, width: float, lowest: bool) -> None:
    """Draw a channel in a panel ``width`` inches wide; the ``lowest`` panel of a column labels the time."""
    axes.plot(*thinned(channel.times, channel.measured, clock), color=MEASURED, lw=1.5)
    axes.plot(*thinned(channel.times, channel.nominal, clock), color=URDF, lw=1.1, ls="--")
    axes.plot(*thinned(channel.times, channel.predicted, clock), color=IDENTIFIED, lw=0.9)
    axes.set_ylim(*limits(channel))
    change, unit = _change(channel), f" [{channel.unit}]"
    room = width - text_width(change, 9.0) - text_width(unit, 9.0, "bold") - 0.1
    name = shortened(channel.name, room, 9.0, "bold") + unit
    axes.set_title(name, loc="left", size=9.0, pad=3.0, weight="bold", parse_math=False)
    axes.set_title(change, loc="right", size=9.0, pad=3.0)
    axes.tick_params(labelsize=8.5, color=FAINT, labelcolor=INK, length=2.5, labelbottom=lowest)
    axes.set_xlim(clock.seconds[0], clock.seconds[-1])
    tidy(axes)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "\N{MINUS SIGN}")))
    if lowest:
        axes.set_xlabel(clock.label, size=9.0, labelpad=1.5)


def _change(channel: Series) -> str:
    before, after = channel.rms
    if not np.any(np.isfinite(channel.measured)):
        return "not measured"
    return f"RMS {written(before)} → {written(after)}"


# --- Bodies before and after, and the table of links ---

Color: TypeAlias = tuple[float, float, float]

MOST_ROWS = 30  # of the link table

_TABLE_WIDTH, _ROW, _KEY_HEIGHT = 3.9, 0.28, 1.15  # [inch]
_THINNEST = 1e-3  # smallest semi-axis drawn, as a fraction of the robot's size
_BADGE = 0.1  # radius of a link's number in the picture [inch]
# For colour-blind readers, the scale darkens steadily.
_SHARES = LinearSegmentedColormap.from_list("share", SHARES)


def draw_bodies(figure: Figure, bodies: Sequence[BodyDrawing]) -> None:
    """Draw the robot, the table of its links and the key.

    Bodies that reach too far to leave room for the others are cut off at the edge of the picture, which a text names.
    """
    reach = ellipsoids.reach_of(bodies)
    bodies = [ellipsoids.thickened(body, _THINNEST * reach) for body in bodies]
    solids = ellipsoids.solids_within(bodies, reach)
    points = np.vstack([ellipsoids.stick_ends(bodies), *(solid.centre for solid in solids)])
    view = ellipsoids.view_of(points)
    floor, step = ellipsoids.floor_below(points, solids)
    low, high = ellipsoids.bounds(view.rotation[:2], np.vstack([points, floor.reshape(-1, 3)]), solids)
    robot, table, key = _layout(high - low, len(bodies))
    axes, inch = _robot_axes(figure, robot, low, high)
    _draw_floor(axes, view, floor)
    _draw_compass(axes, view, inch, f"floor grid {step:g} m")
    _draw_sticks(axes, view, bodies)
    for body in bodies:
        if body.identified.is_finite:
            _draw_identified(axes, view, body)
        if body.prior.is_finite:
            _draw_prior(axes, view, body)
    _draw_badges(axes, view, bodies, inch)
    add_text(figure, ROBOT[0], ROBOT[1] + ROBOT[3] + 0.08, _cut_off(axes, view, bodies), 9.0, DOUBT)
    _draw_table(add_area(figure, table), bodies)
    _draw_key(figure, key)


def _cut_off(axes: Axes, view: View, bodies: Sequence[BodyDrawing]) -> str:
    """List the ellipsoids that the edge of the picture cuts off; empty if there are none."""
    low, high = np.transpose([axes.get_xlim(), axes.get_ylim()])
    parts = []
    for place, body in enumerate(bodies, 1):
        for kind, solid in (("URDF", body.prior), ("identified", body.identified)):
            centre, half = view.flat(solid.centre), view.half_widths(solid)
            if np.any((centre - half < low) | (centre + half > high)):
                reach = written(solid.reach_from(body.origin))
                parts.append(f"{place} {kind}, reaches {reach} m from its link's frame")
    return textwrap.shorten(f"Not wholly shown: {'; '.join(parts)}.", 125, placeholder=" …") if parts else ""


def _layout(extent: FloatArray, links: int) -> tuple[AxesRectangle, AxesRectangle, AxesRectangle]:
    """Places of robot, table and key. The table is beside or below, whichever gives the larger robot.

    ``extent (2,)``: of the robot on the picture [m].
    """
    left, top, width, height = ROBOT
    table_height = 0.32 + _ROW * (min(links, MOST_ROWS) + (links > MOST_ROWS))
    beside = (left, top, width - _TABLE_WIDTH - 0.1, height)
    below = (left, top, width, height - max(table_height, _KEY_HEIGHT) - 0.35)
    if _scale(below, extent) > _scale(beside, extent):
        bottom = top + height
        table = (left + 0.3, bottom - max(table_height, _KEY_HEIGHT), _TABLE_WIDTH, table_height)
        return below, table, (left + width - _TABLE_WIDTH, table[1], _TABLE_WIDTH, _KEY_HEIGHT)
    column = left + width - _TABLE_WIDTH
    table_height = min(table_height, height - _KEY_HEIGHT - 0.3)
    key = (column, top + table_height + 0.3, _TABLE_WIDTH, _KEY_HEIGHT)
    return beside, (column, top, _TABLE_WIDTH, table_height), key


def _scale(place: AxesRectangle, extent: FloatArray) -> float:
    """Inches per metre if ``extent (2,)`` [m] fills the place except for a margin; negative without room."""
    return float(np.min((np.array(place[2:]) - 0.4) / np.maximum(extent, 1e-3)))


def _robot_axes(figure: Figure, place: AxesRectangle, low: FloatArray, high: FloatArray) -> tuple[Axes, float]:
    """Axes in metres with equal scales around corners ``(2,)`` [m]; and the metres per inch."""
    axes = add_axes(figure, place)
    axes.set_axis_off()
    inch = 1.0 / _scale(place, high - low)
    middle, half = (low + high) / 2.0, np.array(place[2:]) * inch / 2.0
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    return axes, inch


def _draw_floor(axes: Axes, view: View, floor: FloatArray) -> None:
    flat = view.flat(floor)
    for line in (*flat, *flat.transpose(1, 0, 2)):
        axes.plot(*line.T, color=GRID, lw=0.8, zorder=0.0)


def _draw_compass(axes: Axes, view: View, inch: float, label: str) -> None:
    """Draw the world axes in the lower left corner, with a label beside them."""
    start = np.array([axes.get_xlim()[0], axes.get_ylim()[0]]) + 0.2 * inch
    for axis, name in zip(view.rotation[:2].T, "xyz", strict=True):
        axes.plot(*np.transpose([start, start + 0.33 * inch * axis]), color=FAINT, lw=1.3, zorder=0.1)
        end = start + 0.45 * inch * axis
        add_text(axes, end[0], end[1], name, 8.5, FAINT, ha="center")
    add_text(axes, start[0] + 0.6 * inch, start[1] - 0.05 * inch, label, 8.5, FAINT)


def _draw_sticks(axes: Axes, view: View, bodies: Sequence[BodyDrawing]) -> None:
    for body in bodies:
        if body.parent_origin is not None:
            stick = view.flat(np.array([body.parent_origin, body.origin]))
            axes.plot(*stick.T, color=STICKS, lw=3.0, solid_capstyle="round", zorder=2.0)
    axes.plot(*view.flat(ellipsoids.stick_ends(bodies)).T, "o", ms=5.5, mfc="white", mec=STICKS, mew=1.3, zorder=2.1)


def _draw_identified(axes: Axes, view: View, body: BodyDrawing) -> None:
    """Draw a shaded, translucent ellipsoid in the colour of its fraction from data.

    The outline is the unit disk under ``U S``, where ``U S V^T`` is the view's part of the sphere map.
    """
    solid, color = body.identified, _SHARES(_share(body.from_data))[:3]
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
    edge = tuple(0.6 * np.array(color))
    axes.add_artist(Circle((0.0, 0.0), 1.0, transform=to_sheet, fill=False, ec=edge, lw=0.9, zorder=order))


def _shaded_disk(sphere_map: FloatArray, back: FloatArray, color: Color) -> FloatArray:
    """Colours ``(128, 128, 4)`` of the near side of the ellipsoid over its unit disk, lit from the upper left.

    ``back (3, 3)``: rows are the two directions of the disk and the line of sight, on the unit sphere.
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


def _draw_prior(axes: Axes, view: View, body: BodyDrawing) -> None:
    """Draw outline and principal sections of the URDF's ellipsoid."""
    sphere_map = view.sphere_map(body.prior)
    centre = view.flat(body.prior.centre)[:, None]
    axes.plot(*view.outline(body.prior), color=URDF, lw=1.1, zorder=1.6)
    for k in range(3):
        section = np.delete(sphere_map[:2], k, axis=1) @ ellipsoids.circle()
        axes.plot(*(centre + section), color=URDF, lw=0.55, alpha=0.9, zorder=1.6)


def _draw_badges(axes: Axes, view: View, bodies: Sequence[BodyDrawing], inch: float) -> None:
    """Draw each body's number at its centre, or beside it if it would hide the body or another number."""
    anchors = [body.identified.centre if body.identified.is_finite else body.origin for body in bodies]
    low, high = np.transpose([axes.get_xlim(), axes.get_ylim()]) / inch
    at = np.clip(view.flat(np.array(anchors)) / inch, low + _BADGE, high - _BADGE)
    small = [np.max(view.half_widths(body.identified)) < _BADGE * inch for body in bodies]
    places = _spread(at + np.outer(small, (2.5 * _BADGE, _BADGE)), 2.3 * _BADGE).clip(low + _BADGE, high - _BADGE)
    for number, (body, anchor, place) in enumerate(zip(bodies, at * inch, places * inch, strict=True), 1):
        if np.linalg.norm(place - anchor) > 0.5 * _BADGE * inch:
            axes.plot(*np.transpose([anchor, place]), color=INK, lw=0.7, zorder=3.0)
            axes.plot(*anchor, "o", ms=2.5, color=INK, zorder=3.0)
        _draw_badge(axes, place[0], place[1], number, body, inch)


def _draw_badge(axes: Axes, x: float, y: float, number: int, body: BodyDrawing, inch: float) -> None:
    """Draw a link's number on its colour; ``inch`` in the axes' coordinates."""
    color = _SHARES(_share(body.from_data))[:3]
    axes.add_artist(Circle((x, y), _BADGE * inch, fc=color, ec="white", lw=1.0, zorder=4.0))
    add_text(axes, x, y, str(number), 7.5, _ink_on(color), weight="bold", ha="center", va="center_baseline")


def _spread(points: FloatArray, distance: float) -> FloatArray:
    """Push ``points (K, 2)`` apart until none are closer than ``distance``, or the rounds are used up."""
    turns = 2.4 * np.arange(len(points))
    places = points + 1e-6 * distance * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for _ in range(300):
        offsets = places[:, None] - places
        lengths = np.linalg.norm(offsets, axis=-1) + np.eye(len(places)) * 1e9
        push = np.clip(distance - lengths, 0.0, None) / 2.0
        if not np.any(push > 1e-3 * distance):
            break
        places = places + 0.5 * np.sum(offsets / lengths[..., None] * push[..., None], axis=1)
    return places


def _draw_table(area: Axes, bodies: Sequence[BodyDrawing]) -> None:
    most = sorted(enumerate(bodies, 1), key=lambda numbered: -_share(numbered[1].from_data))[:MOST_ROWS]
    shown = sorted(most, key=lambda numbered: numbered[0])
    hidden = len(bodies) - len(shown)
    for x, text, ha in ((0.0, "link", "left"), (2.24, "mass [kg]", "right"), (_TABLE_WIDTH, "from data", "right")):
        add_text(area, x, 0.06, text, 9.5, FAINT, ha=ha)
    area.plot([0.0, _TABLE_WIDTH], [0.22, 0.22], color=FRAME, lw=0.8)
    row = (area.get_ylim()[0] - 0.32) / (len(shown) + (hidden > 0))
    for k, (number, body) in enumerate(shown):
        _draw_row(area, 0.32 + (k + 0.5) * row, number, body)
    if hidden:
        add_text(area, 0.32, 0.32 + (len(shown) + 0.5) * row, f"and {hidden} with less from data", 9.0, FAINT)


def _draw_row(area: Axes, y: float, number: int, body: BodyDrawing) -> None:
    share = _share(body.from_data)
    color = _SHARES(share)[:3]
    _draw_badge(area, _BADGE, y, number, body, 1.0)
    add_text(area, 0.28, y, shortened(body.name, 0.88, 9.0), 9.0)
    add_text(area, 1.54, y, written(body.prior.mass), 9.5, FAINT, ha="right")
    add_text(area, 1.62, y, "→", 9.5, FAINT, ha="center")
    add_text(area, 2.24, y, written(body.identified.mass), 9.5, weight="bold", ha="right")
    if np.isfinite(body.std_mass):
        add_text(area, 2.28, y, f"± {written(body.std_mass)}", 8.5, FAINT)
    area.add_artist(Rectangle((3.0, y - 0.055), 0.42, 0.11, fc=GRID, lw=0.0))
    area.add_artist(Rectangle((3.0, y - 0.055), 0.42 * share, 0.11, fc=color, lw=0.0))
    percent = f"{100.0 * body.from_data:.0f} %" if np.isfinite(body.from_data) else NONE
    add_text(area, _TABLE_WIDTH, y, percent, 9.5, ha="right")


def _draw_key(figure: Figure, place: AxesRectangle) -> None:
    """Draw the legend of the ellipsoids and the colour bar."""
    area = add_area(figure, place)
    add_text(area, 0.0, 0.06, "Ellipsoids: uniform bodies of the same mass and inertia", 9.0, FAINT)
    area.add_artist(Circle((0.1, 0.35), 0.09, fill=False, ec=URDF, lw=1.1))
    area.add_artist(Circle((0.95, 0.35), 0.09, fc=_SHARES(0.6), ec="none"))
    add_text(area, 0.26, 0.35, "URDF", 9.0)
    add_text(area, 1.11, 0.35, "identified, coloured by its share from data:", 9.0)
    bar = add_axes(figure, (place[0] + 0.1, place[1] + 0.58, place[2] - 0.3, 0.14))
    scale = ScalarMappable(Normalize(0.0, 1.0), _SHARES)
    colorbar = figure.colorbar(scale, cax=bar, orientation="horizontal", format=PercentFormatter(1.0, symbol=" %"))
    colorbar.outline.set_visible(False)
    bar.tick_params(labelsize=8.5, color=FAINT, length=2.5)


def _share(from_data: float) -> float:
    return float(np.clip(from_data, 0.0, 1.0)) if np.isfinite(from_data) else 0.0


def _ink_on(color: Color) -> str:
    """Readable text colour on ``color``: black or white."""
    return INK if float(np.dot(color, (0.299, 0.587, 0.114))) > 0.55 else "white"
