"""One picture of an identification: the robot's bodies before and after, and what was measured against the models."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from geomid_ros.report.ellipsoids import BodyDrawing
from geomid_ros.report.robot_drawing import draw_bodies
from geomid_ros.report.series_drawing import Series, draw_series
from geomid_ros.report.sheet import DPI, FAINT, SIZE, add_text, shortened

_LEFT, _TITLE_WIDTH = 0.25, 9.7  # [inch]
_NOTE_TOP = 9.48


def identification_figure(title: str, bodies: Sequence[BodyDrawing], series: Sequence[Series], note: str) -> Figure:
    """Draw bodies and channels."""
    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    heading = shortened(title, _TITLE_WIDTH, 17.0, "bold")
    add_text(figure, _LEFT, 0.42, heading, 17.0, weight="bold")
    wrapped = textwrap.fill(note, 190, max_lines=3, placeholder=" …")
    add_text(figure, _LEFT, _NOTE_TOP, wrapped, color=FAINT, va="top")
    if bodies:
        draw_bodies(figure, bodies)
    draw_series(figure, series)
    return figure
