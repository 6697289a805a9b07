"""Channels over time: what was measured against the models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from geomid_ros.report.sheet import (
    FAINT,
    IDENTIFIED,
    INK,
    SIZE,
    URDF,
    add_axes,
    add_text,
    number,
    shortened,
    text_width,
)
from geomid_ros.types import BoolArray, FloatArray, IntArray

MOST_PANELS = 12

_PLACE = (10.15, 1.30, 6.60, 8.00)
_CORE = (0.5, 99.5)  # percentiles between which a channel's ordinary values lie
_BINS = 500  # stretches of a long line; each keeps its smallest and largest value


@dataclass(frozen=True, eq=False)
class Series:
    """A channel over time, in ``unit``: ``times`` [s], the ``measured`` values, those of the URDF (``nominal``) and
    those of the identified model (``predicted``); ``(N,)`` each, NaN where absent."""

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
        """RMS after over RMS before: below 1 is better; NaN where it is undefined."""
        before, after = self.rms
        return after / before if before > 0 else float("nan")


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


def draw_series(figure: Figure, series: Sequence[Series]) -> None:
    """Draw the most improved channels into their place."""
    shown = _most_improved(series)
    left, top, width, height = _PLACE
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
        axes = add_axes(figure, place, first)
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
    add_text(figure, _PLACE[0], 0.72, text, 9.5, FAINT)
    handles = [
        Line2D([], [], color=INK, lw=1.8, label="measured"),
        Line2D([], [], color=URDF, lw=1.2, ls="--", label="URDF"),
        Line2D([], [], color=IDENTIFIED, lw=1.2, label="identified"),
    ]
    corner = ((_PLACE[0] - 0.08) / SIZE[0], 1.0 - 0.42 / SIZE[1])
    figure.legend(
        handles=handles, loc="center left", bbox_to_anchor=corner, ncol=3, frameon=False, fontsize=10.5, borderpad=0
    )


def _draw_channel(axes: Axes, channel: Series, clock: _Clock, width: float, lowest: bool) -> None:
    """In a panel ``width`` inches wide; the ``lowest`` of a column names the times."""
    axes.plot(*_thinned(channel.times, channel.measured, clock), color=INK, lw=1.5)
    axes.plot(*_thinned(channel.times, channel.nominal, clock), color=URDF, lw=1.1, ls="--")
    axes.plot(*_thinned(channel.times, channel.predicted, clock), color=IDENTIFIED, lw=0.9)
    axes.set_ylim(*_limits(channel))
    change, unit = _change(channel), f" [{channel.unit}]"
    room = width - text_width(change, 9.0) - text_width(unit, 9.0, "bold") - 0.1
    name = shortened(channel.name, room, 9.0, "bold") + unit
    axes.set_title(name, loc="left", size=9.0, pad=3.0, weight="bold", parse_math=False)
    axes.set_title(change, loc="right", size=9.0, pad=3.0)
    axes.tick_params(labelsize=8.5, color=FAINT, labelcolor=INK, length=2.5, labelbottom=lowest)
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
    return f"RMS {number(before)} → {number(after)}"


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
    return steps > 5.0 * np.median(steps)


def _extremes(values: FloatArray) -> IntArray:
    """Indices of the smallest and the largest value in each of at most ``_BINS`` stretches, and of both ends."""
    if len(values) <= 2 * _BINS:
        return np.arange(len(values))
    length = -(-len(values) // _BINS)
    padded = np.pad(values, (0, -len(values) % length), mode="edge").reshape(-1, length)
    starts = np.arange(len(padded)) * length
    picked = np.concatenate([[0], starts + padded.argmin(axis=1), starts + padded.argmax(axis=1), [len(values) - 1]])
    return np.unique(np.minimum(picked, len(values) - 1))
