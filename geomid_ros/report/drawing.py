"""Picture of an identification: bodies before and after, and measured and predicted channels."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.samples import Samples
from geomid_ros.report.ellipsoids import BodyDrawing, Ellipsoid
from geomid_ros.report.page import DOUBT, FAINT, FRAME, GRID, IDENTIFIED, INK, MEASURED, URDF, number
from geomid_ros.report.pictures import CHANNELS, ROBOT, SIZE, add_axes, add_text, new_figure, shortened, text_width
from geomid_ros.report.robot_drawing import draw_bodies
from geomid_ros.report.series import MOST_DRAWN, Clock, Series, limits, thinned
from geomid_ros.session.session import Session


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
    axes.grid(color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FRAME)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "\N{MINUS SIGN}")))
    if lowest:
        axes.set_xlabel(clock.label, size=9.0, labelpad=1.5)


def _change(channel: Series) -> str:
    before, after = channel.rms
    if not np.any(np.isfinite(channel.measured)):
        return "not measured"
    return f"RMS {number(before)} → {number(after)}"
