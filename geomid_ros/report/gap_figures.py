"""The gap report's pictures, each a small panel that a phone shows whole.

Pictures are SVG in which text stays text, as the content of an ``<img>``: nothing in them is ever executed.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from xml.sax.saxutils import escape

import numpy as np

from geomid_ros.report.page import AFTER, BEFORE, MEASURED, dots_path, line_path, ticks
from geomid_ros.types import BoolArray, FloatArray, IntArray

_FLOOR, _GRID, _FRAME = "#e9edf0", "#eceeef", "#c8cbce"
_WIDTH, _HEIGHT = 310, 194  # [pt]
_ROW = 58  # by which a picture is higher for each of its rows
_LEFT, _RIGHT, _TOP, _BOTTOM = 53, 12, 22, 33  # margins [pt]
_FINE = 10  # units of a path to the point
_FONT = "font-family='sans-serif' font-size='9'"
_MOST_POINTS = 1500


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
class ChannelResiduals:
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


@dataclass(frozen=True, kw_only=True)
class _Panel:
    """Axes from the ``top`` [pt] of a picture on, ``height`` [pt] high, between two values of ``x`` and of ``y``."""

    top: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def _width(self) -> float:
        return float(_WIDTH - _LEFT - _RIGHT)

    def places(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where values lie, in units of a path from the upper left corner."""
        right = _FINE * self._width * (x - self.x[0]) / (self.x[1] - self.x[0])
        down = _FINE * self.height * (self.y[1] - y) / (self.y[1] - self.y[0])
        return right, down

    def drawn(self, marks: Sequence[str], label: str, below: str | None, behind: str = "") -> str:
        """The axes with marks, what stands ``behind`` their grid, a label, and one ``below`` with the numbers of x, or
        neither."""
        width, height = _FINE * self._width, _FINE * self.height
        across, up = ticks(*self.x, 7), ticks(*self.y, 5)
        right, _ = self.places(np.array(across), np.zeros(len(across)))
        _, down = self.places(np.zeros(len(up)), np.array(up))
        grid = "".join(f"M{x:.0f} 0v{height:.0f}" for x in right) + "".join(f"M0 {y:.0f}h{width:.0f}" for y in down)
        bottom = self.top + self.height
        size = f"width='{self._width}' height='{self.height}' viewBox='0 0 {width} {height}'"
        parts = [
            f"<svg x='{_LEFT}' y='{self.top}' {size} fill='none'>{behind}",
            f"<path d='{grid}' stroke='{_GRID}' stroke-width='7'/>{''.join(marks)}</svg>",
            f"<path d='M{_LEFT} {self.top}V{bottom}H{_WIDTH - _RIGHT}' stroke='{_FRAME}' fill='none'/>",
            *(_text(_LEFT - 4, self.top + y / _FINE + 3, f"{v:g}", "end") for v, y in zip(up, down, strict=True)),
            f"<g transform='translate(11 {self.top + 0.5 * self.height}) rotate(-90)'>{_text(0, 0, label)}</g>",
        ]
        if below is not None:
            numbers = zip(across, right, strict=True)
            parts += [_text(_LEFT + x / _FINE, bottom + 12, f"{v:g}") for v, x in numbers]
            parts.append(_text(_LEFT + 0.5 * self._width, bottom + 25, below))
        return "".join(parts)

    def line(self, x: FloatArray, y: FloatArray, color: str, width: float, dashes: str) -> str:
        """A line, broken where it is NaN, so many points wide."""
        path = line_path(*self.places(x, y))
        style = f"stroke='{color}' stroke-width='{_FINE * width:.0f}' stroke-dasharray='{dashes}'"
        return f"<path d='{path}' {style} stroke-linejoin='round'/>"

    def dots(self, x: FloatArray, y: FloatArray, color: str) -> str:
        """As many of the points as are seen apart."""
        chosen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        chosen = chosen[:: -(-len(chosen) // _MOST_POINTS) or 1]
        size = float(np.clip(45.0 / np.sqrt(len(chosen) + 1.0), 1.3, 3.0))
        path = dots_path(*self.places(x[chosen], y[chosen]))
        style = f"stroke='{color}' stroke-width='{_FINE * size:.0f}' stroke-opacity='.65'"
        return f"<path d='{path}' {style} stroke-linecap='round'/>"

    def band(self, half: float) -> str:
        """Values of y up to ``half`` from zero."""
        _, (top, bottom) = self.places(np.zeros(2), np.array([half, -half]))
        return f"<rect y='{top:.0f}' width='{_FINE * self._width}' height='{bottom - top:.0f}' fill='{_FLOOR}'/>"


def remainder_picture(remainder: ChannelResiduals, against: Against) -> Picture:
    """What is missing against one variable with what was fitted to it, and below it what is left of it; only the latter
    where nothing was fitted."""
    values, fitted = against.values, remainder.fitted
    rows = [("left", remainder.missing - fitted, MEASURED)]
    left = "the remaining residual"
    if np.any(fitted):
        rows = [("missing", remainder.missing, BEFORE), *rows]
        left = f"above, the residual of the model with corrected inertias, and what the findings explain; {left}"
    whole = 144 + _ROW * len(rows)
    height = (whole - _TOP - _BOTTOM + 8.0) / len(rows) - 8.0
    limits = _limits(np.concatenate([remainder.missing, fitted]), remainder.floor)
    low, high = _span(values)
    margin = 0.03 * (high - low)
    panel = _Panel(top=_TOP, height=height, x=(low - margin, high + margin), y=limits)
    drawn = []
    for name, own, color in rows:
        is_last = name == "left"
        marks = [panel.dots(values, own, color)] + ([] if is_last else [panel.dots(values, fitted, AFTER)])
        below = f"{against.name} [{against.unit}]" if is_last else None
        drawn.append(panel.drawn(marks, f"{name} [{remainder.unit}]", below, panel.band(2.0 * remainder.floor)))
        panel = replace(panel, top=panel.top + height + 8.0)
    title = f"{remainder.channel} against {against.name}"
    return _picture(title, f"Residual of {title}: {left}.", whole, drawn)


def overlay_picture(
    name: str, unit: str, times: FloatArray, lines: Mapping[str, FloatArray], seconds: float
) -> Picture:
    """Measured, before and after over ``times (N,)`` [s], each ``(N,)`` and broken where it is NaN: at most ``seconds``
    where they differ most."""
    shown = _most_telling(times, np.abs(lines["before"] - lines["measured"]), seconds)
    thinned = slice(shown.start, shown.stop, -(-(shown.stop - shown.start) // _MOST_POINTS))
    limits = _limits_of(*(lines[key][shown] for key in ("measured", "after", "before")))
    panel = _Panel(top=_TOP, height=_HEIGHT - _TOP - _BOTTOM, x=_span(times[shown]), y=limits)
    styles = {"measured": (MEASURED, 2.4, "none"), "before": (BEFORE, 1.4, "56 28"), "after": (AFTER, 1.3, "none")}
    marks = [panel.line(times[thinned], lines[key][thinned], *style) for key, style in styles.items()]
    drawn = panel.drawn(marks, f"[{unit}]", "time [s]")
    return _picture(name, f"{name} over time: measured, before and after.", _HEIGHT, [drawn])


def _most_telling(times: FloatArray, error: FloatArray, seconds: float) -> slice:
    """The stretch of at most ``seconds`` in which the error's square has the largest sum."""
    ends = np.searchsorted(times, times + seconds)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(error) ** 2)])
    whole = max(int(np.searchsorted(times, times[-1] - seconds, side="right")), 1)
    start = int(np.argmax((total[ends] - total[: len(times)])[:whole]))
    return slice(start, int(ends[start]))


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


def _span(values: FloatArray) -> tuple[float, float]:
    """From the smallest to the largest of the numbers among values, with some distance where they are alike."""
    low, high = map(float, _ends(values))
    return (low, high) if high - low > 1e-9 * max(abs(low), abs(high), 1e-3) else (low - 1e-3, high + 1e-3)


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' fill='{MEASURED}'>{escape(text)}</text>"


def _picture(title: str, description: str, height: float, drawn: Sequence[str]) -> Picture:
    """A picture ``height`` [pt] high of what is drawn."""
    shortened = title if len(title) <= 52 else f"{title[:22]}…{title[-28:]}"
    size = f"width='{_WIDTH}pt' height='{height}pt' viewBox='0 0 {_WIDTH} {height}'"
    text = (
        f"<svg xmlns='http://www.w3.org/2000/svg' {size} {_FONT}><rect width='100%' height='100%' fill='#fff'/>"
        f"<g font-size='10' font-weight='bold'>{_text(6, 13, shortened, 'start')}</g>{''.join(drawn)}</svg>"
    )
    return Picture(description, f"data:image/svg+xml;base64,{base64.b64encode(text.encode()).decode()}")
