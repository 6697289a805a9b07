"""A sheet to draw on: its size and colours, places on it in inches from its top left corner, and text."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Literal, TypeAlias

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from geomid_ros.errors import one_line
from geomid_ros.files.disk import write_bytes

Place: TypeAlias = tuple[float, float, float, float]
"""Left, top, width, height [inch]."""

DPI = 150
SIZE = (17.0, 10.0)  # [inch]
ROBOT: Place = (0.25, 0.95, 9.25, 8.35)
CHANNELS: Place = (10.15, 1.30, 6.60, 8.00)

# Grey is the URDF and colour the identified, in the robot as over time. For the colour-blind: Okabe and Ito's
# vermilion.
INK, FAINT, URDF, IDENTIFIED = "#1a1a1a", "#6b7075", "#9a9fa5", "#d55e00"
_COMPRESSION = 3  # of PNGs: with 6, writing takes half as long again, for files a tenth smaller


def write_picture(path: Path, figure: Figure) -> None:
    """Write a figure as the PNG ``path``, which appears whole or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": _COMPRESSION})
    write_bytes(path, buffer.getvalue())


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """A white figure of this size [inch]."""
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def add_axes(figure: Figure, place: Place, share: Axes | None = None) -> Axes:
    """Axes at a place; they ``share`` the x axis of others."""
    left, top, width, height = place
    rectangle = (left / SIZE[0], 1.0 - (top + height) / SIZE[1], width / SIZE[0], height / SIZE[1])
    axes = figure.add_axes(rectangle, sharex=share)
    axes.set_title("", y=1.0)  # else all ticks are laid out once more to find a place for a title
    return axes


def add_area(figure: Figure, place: Place) -> Axes:
    """Axes without a frame whose coordinates are inches from the top left corner."""
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
    zorder: float = 5.0,
) -> None:
    """Text at (x, y) inches from the top left corner of a figure or an area; a dollar sign is no formula."""
    if isinstance(where, Figure):
        x, y = x / SIZE[0], 1.0 - y / SIZE[1]
    where.text(
        x, y, one_line(text), size=size, color=color, weight=weight, ha=ha, va=va, zorder=zorder, parse_math=False
    )


def text_width(text: str, size: float, weight: str = "normal") -> float:
    """Of a line of text [inch]."""
    font = FontProperties(size=size, weight=weight)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0]) / 72.0


def shortened(text: str, inches: float, size: float, weight: str = "normal") -> str:
    """``text`` no wider than ``inches``: names differ at their ends, so something inside is left out."""
    text = one_line(text)
    if text_width(text, size, weight) <= inches:
        return text
    fitting, most = 1, len(text) - 1
    while fitting < most:
        length = (fitting + most + 1) // 2
        if text_width(_without_middle(text, length), size, weight) <= inches:
            fitting = length
        else:
            most = length - 1
    return _without_middle(text, fitting)


def _without_middle(text: str, length: int) -> str:
    """A text of which ``length`` characters are left."""
    head = 2 * length // 5
    return f"{text[:head]}…{text[len(text) - length + head :]}"
