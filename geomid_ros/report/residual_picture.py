"""Pictures of residuals against a variable, each a small panel that a phone shows whole.

They are SVG in which text stays text, as the content of an ``<img>``: nothing in them is ever executed.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from xml.sax.saxutils import escape

import numpy as np

from geomid_ros.report.colours import BEFORE, FLOOR, FRAME, GRID, IDENTIFIED, INK
from geomid_ros.report.page import dots_path, ticks
from geomid_ros.report.series import BINS
from geomid_ros.types import FloatArray

_WIDTH = 310  # [pt]
_ROW = 58  # by which a picture is higher for each of its rows
_LEFT, _RIGHT, _TOP, _BOTTOM = 53, 12, 22, 33  # margins [pt]
_FINE = 10  # units of a path to the point
_FONT = "font-family='sans-serif' font-size='9'"


@dataclass(frozen=True)
class Picture:
    """A picture for the page: what it holds in words, and the picture as the address of an ``<img>``."""

    description: str
    address: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Residuals:
    """A channel's residuals ``(N,)`` in ``unit``: ``missing`` without the named effects, and their part ``fitted`` by
    these; ``floor`` is the noise's standard deviation. They are drawn against ``values (N,)`` of a ``variable`` in
    ``variable_unit``."""

    channel: str
    unit: str
    missing: FloatArray
    fitted: FloatArray
    floor: float
    variable: str
    variable_unit: str
    values: FloatArray


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
            f"<path d='{grid}' stroke='{GRID}' stroke-width='7'/>{''.join(marks)}</svg>",
            f"<path d='M{_LEFT} {self.top}V{bottom}H{_WIDTH - _RIGHT}' stroke='{FRAME}' fill='none'/>",
            *(_text(_LEFT - 4, self.top + y / _FINE + 3, f"{v:g}", "end") for v, y in zip(up, down, strict=True)),
            f"<g transform='translate(11 {self.top + 0.5 * self.height}) rotate(-90)'>{_text(0, 0, label)}</g>",
        ]
        if below is not None:
            numbers = zip(across, right, strict=True)
            parts += [_text(_LEFT + x / _FINE, bottom + 12, f"{v:g}") for v, x in numbers]
            parts.append(_text(_LEFT + 0.5 * self._width, bottom + 25, below))
        return "".join(parts)

    def dots(self, x: FloatArray, y: FloatArray, color: str) -> str:
        """As many of the points as are seen apart."""
        chosen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        chosen = chosen[:: -(-len(chosen) // (2 * BINS)) or 1]
        size = float(np.clip(45.0 / np.sqrt(len(chosen) + 1.0), 1.3, 3.0))
        path = dots_path(*self.places(x[chosen], y[chosen]))
        style = f"stroke='{color}' stroke-width='{_FINE * size:.0f}' stroke-opacity='.65'"
        return f"<path d='{path}' {style} stroke-linecap='round'/>"

    def band(self, half: float) -> str:
        """Values of y up to ``half`` from zero."""
        _, (top, bottom) = self.places(np.zeros(2), np.array([half, -half]))
        return f"<rect y='{top:.0f}' width='{_FINE * self._width}' height='{bottom - top:.0f}' fill='{FLOOR}'/>"


def residual_picture(residuals: Residuals) -> Picture:
    """What is missing with what was fitted to it, and below it what is left of it; only the latter where nothing was
    fitted."""
    values, fitted = residuals.values, residuals.fitted
    rows = [("left", residuals.missing - fitted, INK)]
    left = "the remaining residual"
    if np.any(fitted):
        rows = [("missing", residuals.missing, BEFORE), *rows]
        left = f"above, the residual of the model with corrected inertias, and what the findings explain; {left}"
    whole = 144 + _ROW * len(rows)
    height = (whole - _TOP - _BOTTOM + 8.0) / len(rows) - 8.0
    limits = _limits(np.concatenate([residuals.missing, fitted]), residuals.floor)
    panel = _Panel(top=_TOP, height=height, x=_span(values), y=limits)
    drawn = []
    for name, own, color in rows:
        is_last = name == "left"
        marks = [panel.dots(values, own, color)] + ([] if is_last else [panel.dots(values, fitted, IDENTIFIED)])
        below = f"{residuals.variable} [{residuals.variable_unit}]" if is_last else None
        drawn.append(panel.drawn(marks, f"{name} [{residuals.unit}]", below, panel.band(2.0 * residuals.floor)))
        panel = replace(panel, top=panel.top + height + 8.0)
    title = f"{residuals.channel} against {residuals.variable}"
    return _picture(title, f"Residual of {title}: {left}.", whole, drawn)


def _limits(values: FloatArray, floor: float) -> tuple[float, float]:
    """All but the outermost values, and at least the floor's band."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (0.3, 99.7)) if len(finite) else (0.0, 0.0)
    low, high = min(low, -2.5 * floor), max(high, 2.5 * floor)
    margin = 0.08 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def _span(values: FloatArray) -> tuple[float, float]:
    """From the smallest to the largest of the numbers among values, and a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = max(0.03 * (high - low), 1e-3 * max(abs(low), abs(high), 1.0))
    return low - margin, high + margin


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' fill='{INK}'>{escape(text)}</text>"


def _picture(title: str, description: str, height: float, drawn: Sequence[str]) -> Picture:
    """A picture ``height`` [pt] high of what is drawn."""
    shortened = title if len(title) <= 52 else f"{title[:22]}…{title[-28:]}"
    size = f"width='{_WIDTH}pt' height='{height}pt' viewBox='0 0 {_WIDTH} {height}'"
    text = (
        f"<svg xmlns='http://www.w3.org/2000/svg' {size} {_FONT}><rect width='100%' height='100%' fill='#fff'/>"
        f"<g font-size='10' font-weight='bold'>{_text(6, 13, shortened, 'start')}</g>{''.join(drawn)}</svg>"
    )
    return Picture(description, f"data:image/svg+xml;base64,{base64.b64encode(text.encode()).decode()}")
