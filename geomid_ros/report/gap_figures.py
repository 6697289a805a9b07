"""The gap report's pictures, each a small panel that a phone shows whole.

Pictures are SVG in which text stays text, as the content of an ``<img>``: nothing in them is ever executed.
"""

from __future__ import annotations

import base64
import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from geomid_ros.report.page import AFTER, BEFORE, MEASURED
from geomid_ros.types import BoolArray, FloatArray, IntArray

_FLOOR = "#e9edf0"
_SIZE = (4.3, 2.7)  # of a panel [inch]
_MOST_POINTS = 1500
_MOST_LINE_POINTS = 1200
_SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "geomid",
    "font.size": 9.0,
    "axes.edgecolor": "#c8cbce",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#eceeef",
    "grid.linewidth": 0.7,
    "xtick.color": "#6b7075",
    "ytick.color": "#6b7075",
    "xtick.labelcolor": MEASURED,
    "ytick.labelcolor": MEASURED,
    "savefig.dpi": 130,
}


@dataclass(frozen=True)
class Picture:
    """A picture for the page: what it holds in words, and the picture as the address of an ``<img>``."""

    description: str
    address: str


@dataclass(frozen=True, eq=False)
class Against:
    """What residuals are drawn against: ``values (N,)`` with their name and unit."""

    name: str
    unit: str
    values: FloatArray


@dataclass(frozen=True, eq=False)
class Remainder:
    """A channel's residuals ``(N,)`` in ``unit``: ``missing`` without the named effects, and their part ``fitted`` by
    these; ``floor`` is the noise's standard deviation."""

    channel: str
    unit: str
    missing: FloatArray
    fitted: FloatArray
    floor: float


def elapsed(stamps: IntArray) -> FloatArray:
    """Seconds since the first stamp [ns], pauses between recordings left out, ``(N,)``."""
    steps = np.diff(stamps) * 1e-9
    usual = float(np.median(steps)) if len(steps) else 0.0
    return np.concatenate([[0.0], np.cumsum(np.where(after_pause(stamps)[1:], usual, steps))])[: len(stamps)]


def after_pause(stamps: IntArray) -> BoolArray:
    """Which samples ``(N,)`` follow a pause; so does a recording that began earlier than the one before it."""
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return np.concatenate([[False], (steps > 5.0 * usual) | (steps <= 0.0)])[: len(stamps)]


def remainder_picture(remainder: Remainder, against: Against) -> Picture:
    """What is missing against one variable with what was fitted to it, and below it what is left of it; only the latter
    where nothing was fitted."""
    rest = ("left", remainder.missing - remainder.fitted, MEASURED)
    rows = [("missing", remainder.missing, BEFORE), rest] if np.any(remainder.fitted) else [rest]
    with mpl.rc_context(_SETTINGS):
        height = 2.0 + 0.8 * len(rows)
        figure = Figure((_SIZE[0], height))
        panels = figure.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        figure.subplots_adjust(left=0.17, right=0.96, top=1.0 - 0.3 / height, bottom=0.46 / height, hspace=0.1)
        _title(figure, f"{remainder.channel} against {against.name}")
        for axes, (name, values, color) in zip(panels, rows, strict=True):
            axes.axhspan(-2.0 * remainder.floor, 2.0 * remainder.floor, color=_FLOOR, lw=0, zorder=0)
            _points(axes, against.values, values, color)
            _labels(axes, f"{name} [{remainder.unit}]")
        if len(rows) > 1:
            _points(panels[0], against.values, remainder.fitted, AFTER)
        panels[-1].set_ylim(_limits(np.concatenate([remainder.missing, remainder.fitted]), remainder.floor))
        panels[-1].set_xlabel(f"{against.name} [{against.unit}]", labelpad=1.0, parse_math=False)
        figure.align_ylabels()
        what = {
            "missing": "above, the residual of the model with corrected inertias, and what the findings explain; ",
            "left": "the remaining residual",
        }
        described = "".join(what[name] for name, _, _ in rows)
        return _picture(figure, f"Residual of {remainder.channel} against {against.name}: {described}.")


def overlay_picture(
    name: str, unit: str, times: FloatArray, lines: Mapping[str, FloatArray], seconds: float
) -> Picture:
    """Measured, before and after over ``times (N,)`` [s], each ``(N,)`` and broken where it is NaN: at most ``seconds``
    where they differ most."""
    with mpl.rc_context(_SETTINGS):
        figure = Figure(_SIZE)
        axes = figure.subplots()
        figure.subplots_adjust(left=0.16, right=0.96, top=0.88, bottom=0.17)
        shown = _most_telling(times, np.abs(lines["before"] - lines["measured"]), seconds)
        for key, color, width, dashes in (
            ("measured", MEASURED, 2.4, "-"),
            ("before", BEFORE, 1.4, (0, (4, 2))),
            ("after", AFTER, 1.3, "-"),
        ):
            thinned = slice(shown.start, shown.stop, -(-(shown.stop - shown.start) // _MOST_LINE_POINTS))
            axes.plot(times[thinned], lines[key][thinned], color=color, lw=width, ls=dashes)
        _title(figure, name)
        _labels(axes, f"[{unit}]")
        axes.set_xlabel("time [s]", labelpad=1.0)
        axes.set_xlim(times[shown][0], max(times[shown][-1], times[shown][0] + 1e-3))
        axes.set_ylim(_limits_of(*(lines[key][shown] for key in ("measured", "after", "before"))))
        return _picture(figure, f"{name} over time: measured, before and after.")


def _most_telling(times: FloatArray, error: FloatArray, seconds: float) -> slice:
    """The stretch of at most ``seconds`` in which the error's square has the largest sum."""
    ends = np.searchsorted(times, times + seconds)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(error) ** 2)])
    whole = max(int(np.searchsorted(times, times[-1] - seconds, side="right")), 1)
    start = int(np.argmax((total[ends] - total[: len(times)])[:whole]))
    return slice(start, int(ends[start]))


def _points(axes: Axes, x: FloatArray, y: FloatArray, color: str) -> None:
    chosen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    chosen = chosen[:: -(-len(chosen) // _MOST_POINTS) or 1]
    size = float(np.clip(90.0 / np.sqrt(len(chosen) + 1.0), 2.6, 6.0))
    axes.plot(x[chosen], y[chosen], ".", ms=size, mew=0.0, alpha=0.65, color=color, rasterized=True)


def _limits(values: FloatArray, floor: float) -> tuple[float, float]:
    """All but the outermost values, and at least the floor's band."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (0.3, 99.7)) if len(finite) else (0.0, 0.0)
    low, high = min(low, -2.5 * floor), max(high, 2.5 * floor)
    margin = 0.08 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def _limits_of(measured: FloatArray, after: FloatArray, before: FloatArray) -> tuple[float, float]:
    """All of what was measured and comes after, and of what came before as much as leaves the rest to be seen."""
    low, high = (float(limit) for limit in _ends(np.concatenate([measured, after])))
    span = high - low or 1.0
    first, last = _ends(before)
    low, high = min(low, max(float(first), low - span)), max(high, min(float(last), high + span))
    return low - 0.06 * (high - low), high + 0.06 * (high - low)


def _ends(values: FloatArray) -> FloatArray:
    """The smallest and the largest of the numbers among values."""
    finite = values[np.isfinite(values)]
    return np.array([finite.min(), finite.max()]) if len(finite) else np.zeros(2)


def _title(figure: Figure, text: str) -> None:
    shortened = text if len(text) <= 52 else f"{text[:22]}…{text[-28:]}"
    figure.suptitle(shortened, x=0.02, y=0.985, ha="left", va="top", size=10.0, weight="bold", parse_math=False)


def _labels(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, labelpad=2.0, parse_math=False)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.xaxis.set_major_locator(MaxNLocator(7))
    axes.tick_params(length=2.5)


def _picture(figure: Figure, description: str) -> Picture:
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # names in other scripts: the browser has letters for them
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    encoded = base64.b64encode(buffer.getvalue()).decode()
    return Picture(description, f"data:image/svg+xml;base64,{encoded}")
