"""The picture of an identification: bodies before and after, and what was measured against the models."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.samples import Samples
from geomid_ros.report.ellipsoids import BodyDrawing, Ellipsoid
from geomid_ros.report.robot_drawing import draw_bodies
from geomid_ros.report.series import Series
from geomid_ros.report.series_drawing import draw_series
from geomid_ros.report.sheet import DPI, FAINT, SIZE, add_text, shortened
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_LEFT, _TITLE_WIDTH = 0.25, 9.7  # [inch]
_NOTE_TOP = 9.48


def draw_identification(
    session: Session, estimate: Estimate, batches: Sequence[Samples], series: Sequence[Series], of_what: str
) -> Figure:
    """Draw the bodies before and after, and every measured channel over time.

    Args:
        session: in which it was identified.
        estimate: what was found.
        batches: the bodies are drawn as the robot stands in the middle of these samples, which are in the order of
            time.
        series: the channels of them.
        of_what: what these samples are.
    """
    return identification_figure(
        f"{session.robot.name}: identified link inertias",
        _bodies(session, estimate, _middle(batches)),
        series,
        f"Measured and predicted on {of_what}; identified from {estimate.rows_accepted} rows.",
    )


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


def _bodies(session: Session, estimate: Estimate, pose: Samples) -> list[BodyDrawing]:
    robot = session.robot
    frames = robot.link_frames(pose)
    nominal = session.model.nominal_inertias.reshape(-1, 10)
    return [
        BodyDrawing(
            link.name,
            frames[link.name][1],
            frames[parent][1] if (parent := robot.parent_body(link.name)) else None,
            _ellipsoid(nominal[index], *frames[link.name]),
            _ellipsoid(link.parameters, *frames[link.name]),
            link.from_data,
        )
        for index, link in enumerate(estimate.links)
    ]


def _ellipsoid(parameters: FloatArray, rotation: FloatArray, origin: FloatArray) -> Ellipsoid:
    semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(parameters)
    centre = origin + rotation @ pseudo_inertia.centre_of_mass(parameters)
    return Ellipsoid(centre, semi_axes, rotation @ axes, float(parameters[0]))


def _middle(batches: Sequence[Samples]) -> Samples:
    """The one sample in the middle."""
    ends = np.cumsum([len(samples) for samples in batches])
    batch = int(np.searchsorted(ends, ends[-1] // 2, side="right"))
    place = int(ends[-1] // 2 - ends[batch]) + len(batches[batch])
    return batches[batch].select(slice(place, place + 1))
