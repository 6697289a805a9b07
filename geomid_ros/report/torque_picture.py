"""The picture of what drawn robots mean for the torques."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from geomid_ros.report.sheet import IDENTIFIED, URDF, write_picture
from geomid_ros.types import FloatArray

_DPI = 130
_HEIGHT = 0.4  # [inch] of a joint


def torque_picture(path: Path, title: str, names: Sequence[str], drawn: FloatArray, ranges: FloatArray) -> None:
    """Draw the PNG ``path``: the width of the band of efforts of ``drawn`` robots and of ``ranges``, ``(joints,)`` in
    the order of the joints' ``names``."""
    figure = Figure(figsize=(8.0, 1.6 + _HEIGHT * len(names)), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
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
