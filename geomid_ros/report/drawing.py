"""Picture of an identification: bodies before and after, and measured and predicted channels."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.samples import Samples
from geomid_ros.report.page import DOUBT, FAINT, FRAME, GRID, IDENTIFIED, INK, MEASURED, NONE, SHARES, STICKS, URDF
from geomid_ros.report.page import number as written
from geomid_ros.report.pictures import (
    CHANNELS,
    ROBOT,
    SIZE,
    AxesRectangle,
    Ellipsoid,
    add_area,
    add_axes,
    add_text,
    frame_space,
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

MOST_ROWS = 30  # of the link table

_TABLE_WIDTH, _ROW, _KEY_HEIGHT = 3.9, 0.28, 1.15  # [inch]
_ELEVATION = 16.0  # of the view [degrees]
_TICKS = 0.5  # below the robot, with the axes' names [inch]
_THINNEST = 1e-3  # smallest semi-axis drawn, as a fraction of the robot's size
_BADGE = 0.1  # radius of a link's number in the table [inch]
# For colour-blind readers, the scale darkens steadily.
_SHARES = LinearSegmentedColormap.from_list("share", SHARES)


@dataclass(frozen=True, eq=False)
class BodyDrawing:
    """Link to draw.

    Attributes:
        name: name of the link.
        origin: origin of its frame in the world, ``(3,)`` [m].
        parent_origin: start of the stick to it, ``(3,)`` [m]; None for no stick.
        prior, identified: its body before and after.
        from_data: fraction of the prior variance that the data removed, 0 to 1.
        std_mass: standard deviation of the identified mass [kg], NaN if unknown.
    """

    name: str
    origin: FloatArray
    parent_origin: FloatArray | None
    prior: Ellipsoid
    identified: Ellipsoid
    from_data: float
    std_mass: float = np.nan


def draw_bodies(figure: Figure, bodies: Sequence[BodyDrawing]) -> None:
    """Draw the robot, the table of its links and the key.

    Bodies that reach too far to leave room for the others are not drawn; a text names them.
    """
    left, top, width, height = ROBOT
    reach = _reach(bodies)
    far = [
        f"{number} {kind}, reaches {written(solid.reach_from(body.origin))} m from its link's frame"
        for number, body in enumerate(bodies, 1)
        for kind, solid in (("URDF", body.prior), ("identified", body.identified))
        if solid.reach_from(body.origin) > reach
    ]
    text = textwrap.shorten(f"Not shown: {'; '.join(far)}.", 125, placeholder=" …") if far else ""
    add_text(figure, left, top + height + 0.08, text, 9.0, DOUBT)
    column, rows = left + width - _TABLE_WIDTH, min(len(bodies), MOST_ROWS) + (len(bodies) > MOST_ROWS)
    table_height = min(0.32 + _ROW * rows, height - _KEY_HEIGHT - 0.3)
    _draw_table(add_area(figure, (column, top, _TABLE_WIDTH, table_height)), bodies)
    _draw_key(figure, (column, top + table_height + 0.3, _TABLE_WIDTH, _KEY_HEIGHT))
    used = table_height + _KEY_HEIGHT + 0.3
    beside, below = (left, top, column - left - 0.7, height), (left, top + used, width, height - used)
    _draw_robot(figure, (beside, below), bodies, reach)


def _draw_robot(figure: Figure, places: Sequence[AxesRectangle], bodies: Sequence[BodyDrawing], reach: float) -> None:
    """Draw the bodies within ``reach`` [m] of their link's origins, in the place where they are larger."""
    solids = [
        (solid.thickened(_THINNEST * reach), solid is body.prior, _color(body))
        for body in bodies
        for solid in (body.prior, body.identified)
        if solid.reach_from(body.origin) <= reach
    ]
    points = np.vstack([_stick_ends(bodies), *(solid.surface.reshape(3, -1).T for solid, *_ in solids)])
    extent = np.ptp(points, axis=0) + 1e-6
    wide, elevation = np.hypot(*extent[:2]), np.radians(_ELEVATION)
    high = np.cos(elevation) * extent[2] + np.sin(elevation) * wide
    scale, (left, top, width, height) = max(
        (min(width / wide, (height - _TICKS) / high), (left, top, width, height - _TICKS))
        for left, top, width, height in places
    )
    side = float(scale * np.linalg.norm(extent))  # axes in space are square, with the diagonal of their contents
    square = (left + 0.5 * (width - side), top + 0.5 * (height - side), side, side)
    with rc_context({"grid.color": GRID}):
        axes: Any = add_axes(figure, square, projection="3d", proj_type="ortho", elev=_ELEVATION, azim=-60.0)
    for solid, is_prior, color in solids:
        if is_prior:
            solid.draw_wires(axes, URDF)
        else:
            solid.draw(axes, color)
    for number, body in enumerate(bodies, 1):
        axes.plot(*_stick_ends([body]).T, "-o", color=STICKS, lw=3.0, ms=5.5, mfc="white", mew=1.3, zorder=800.0)
        anchor, color = body.identified.centre, _color(body)
        anchor = anchor if body.identified.reach_from(body.origin) <= reach else body.origin
        badge = {"boxstyle": "circle", "fc": color, "ec": "white"}
        style = {"size": 7.5, "color": _ink_on(color), "weight": "bold", "ha": "center", "va": "center"}
        axes.text(*anchor, str(number), zorder=900.0, bbox=badge, **style)
    frame_space(axes, points)


def _reach(bodies: Sequence[BodyDrawing]) -> float:
    """Largest reach of a body from its link's origin [m] that fits the picture: the size of the robot, or three times
    the median reach where the frames lie close together."""
    robot = float(np.linalg.norm(np.ptp(_stick_ends(bodies), axis=0)))
    reaches = [body.prior.reach_from(body.origin) for body in bodies]
    finite = [reach for reach in reaches if np.isfinite(reach)]
    return max(robot, 3.0 * float(np.median(finite)) if finite else 0.0) or 1.0


def _stick_ends(bodies: Sequence[BodyDrawing]) -> FloatArray:
    """End points of the sticks ``(K, 3)`` [m]."""
    return np.array([end for body in bodies for end in (body.parent_origin, body.origin) if end is not None])


def _draw_badge(area: Axes, y: float, number: int, color: tuple[float, float, float]) -> None:
    """Draw a link's number on its colour, at the left of a table in inches."""
    area.add_artist(Circle((_BADGE, y), _BADGE, fc=color, ec="white", lw=1.0, zorder=4.0))
    add_text(area, _BADGE, y, str(number), 7.5, _ink_on(color), weight="bold", ha="center", va="center_baseline")


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
    color = _color(body)
    _draw_badge(area, y, number, color)
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


def _color(body: BodyDrawing) -> tuple[float, float, float]:
    red, green, blue, _ = _SHARES(_share(body.from_data))
    return red, green, blue


def _ink_on(color: tuple[float, float, float]) -> str:
    """Readable text colour on ``color``: black or white."""
    return INK if float(np.dot(color, (0.299, 0.587, 0.114))) > 0.55 else "white"
