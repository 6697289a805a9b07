"""``report.html``: findings of the gap workflow on one page that needs no network.

Residuals are drawn against a variable, each in a panel small enough for a phone. The panels are SVG in which text stays
text, as the content of an ``<img>``: nothing in them is ever executed.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from geomid_ros.files.models.gap_file import GapFile
from geomid_ros.gap.judgement.held_out import GAP_ABOVE
from geomid_ros.gap.result import Finding, GapResult, ResidualDependence
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.model.channels import is_of
from geomid_ros.model.effects import KnownEffect
from geomid_ros.report import gap_words
from geomid_ros.report.colours import BEFORE, FLOOR, FRAME, GRID, IDENTIFIED, INK
from geomid_ros.report.page import Bars, Script, dots_path, ticks, write_page
from geomid_ros.report.series import BINS, MOST_DRAWN, SCRIPT, ChannelTrace, Series, elapsed, traces
from geomid_ros.resimulation.resimulate import HORIZON, Kind, Resimulated
from geomid_ros.types import FloatArray

_WIDTH = 310  # [pt]
_ROW = 58  # height that each row adds to a picture
_LEFT, _RIGHT, _TOP, _BOTTOM = 53, 12, 22, 33  # margins [pt]
_FINE = 10  # path units per pt
_FONT = "font-family='sans-serif' font-size='9'"


@dataclass(frozen=True)
class Picture:
    """Picture for the page: its ``description`` in words, and its ``address`` for an ``<img>``."""

    description: str
    address: str


@dataclass(frozen=True, kw_only=True)
class _Panel:
    """Axes ``height`` [pt] high, ``top`` [pt] below the upper edge of a picture, with limits of ``x`` and of ``y``."""

    top: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def _width(self) -> float:
        return float(_WIDTH - _LEFT - _RIGHT)

    def places(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert values to units of a path from the upper left corner."""
        right = _FINE * self._width * (x - self.x[0]) / (self.x[1] - self.x[0])
        down = _FINE * self.height * (self.y[1] - y) / (self.y[1] - self.y[0])
        return right, down

    def drawn(self, marks: Sequence[str], label: str, below: str | None, behind: str = "") -> str:
        """Draw the axes: marks over a grid over ``behind``, a label, and, with ``below``, the numbers and label of
        x."""
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
        """Draw the points, thinned to as many as can be distinguished."""
        chosen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        chosen = chosen[:: -(-len(chosen) // (2 * BINS)) or 1]
        size = float(np.clip(45.0 / np.sqrt(len(chosen) + 1.0), 1.3, 3.0))
        path = dots_path(*self.places(x[chosen], y[chosen]))
        style = f"stroke='{color}' stroke-width='{_FINE * size:.0f}' stroke-opacity='.65'"
        return f"<path d='{path}' {style} stroke-linecap='round'/>"

    def band(self, half: float) -> str:
        """Draw the band of y values up to ``half`` from zero."""
        _, (top, bottom) = self.places(np.zeros(2), np.array([half, -half]))
        return f"<rect y='{top:.0f}' width='{_FINE * self._width}' height='{bottom - top:.0f}' fill='{FLOOR}'/>"


def residual_picture(page: GapPage, channel: int) -> Picture:
    """Draw the residual of a channel against the variable that it depends on most: above, without the named effects,
    and their contribution; below, the remaining residual. Without named effects, draw only the latter."""
    result, trace, rigid = page.result, page.result.trace, page.rigid[:, channel]
    missing, fitted = trace.measured[:, channel] - rigid, trace.after[:, channel] - rigid
    floor, (variable, variable_unit, values) = float(result.floor[channel]), _variable(page, channel)
    rows = [("left", missing - fitted, INK)]
    caption = "the remaining residual"
    if np.any(fitted):
        rows = [("missing", missing, BEFORE), *rows]
        caption = f"above, the residual of the model with corrected inertias, and what the findings explain; {caption}"
    total = 144 + _ROW * len(rows)
    height = (total - _TOP - _BOTTOM + 8.0) / len(rows) - 8.0
    limits = _limits(np.concatenate([missing, fitted]), floor)
    panel = _Panel(top=_TOP, height=height, x=_span(values), y=limits)
    panels = []
    for name, residual, color in rows:
        is_last = name == "left"
        marks = [panel.dots(values, residual, color)] + ([] if is_last else [panel.dots(values, fitted, IDENTIFIED)])
        below = f"{variable} [{variable_unit}]" if is_last else None
        panels.append(panel.drawn(marks, f"{name} [{result.units[channel]}]", below, panel.band(2.0 * floor)))
        panel = replace(panel, top=panel.top + height + 8.0)
    title = f"{result.channels[channel]} against {variable}"
    return _picture(title, f"Residual of {title}: {caption}.", total, panels)


def _limits(values: FloatArray, floor: float) -> tuple[float, float]:
    """Limits that contain all but the outermost values, and at least the band of the floor."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (0.3, 99.7)) if len(finite) else (0.0, 0.0)
    low, high = min(low, -2.5 * floor), max(high, 2.5 * floor)
    margin = 0.08 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def _span(values: FloatArray) -> tuple[float, float]:
    """Limits from the smallest to the largest finite value, with a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = max(0.03 * (high - low), 1e-3 * max(abs(low), abs(high), 1.0))
    return low - margin, high + margin


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' fill='{INK}'>{escape(text)}</text>"


def _picture(title: str, description: str, height: float, panels: Sequence[str]) -> Picture:
    """Assemble a picture ``height`` [pt] high from its panels."""
    shortened = title if len(title) <= 52 else f"{title[:22]}…{title[-28:]}"
    size = f"width='{_WIDTH}pt' height='{height}pt' viewBox='0 0 {_WIDTH} {height}'"
    text = (
        f"<svg xmlns='http://www.w3.org/2000/svg' {size} {_FONT}><rect width='100%' height='100%' fill='#fff'/>"
        f"<g font-size='10' font-weight='bold'>{_text(6, 13, shortened, 'start')}</g>{''.join(panels)}</svg>"
    )
    return Picture(description, f"data:image/svg+xml;base64,{base64.b64encode(text.encode()).decode()}")


_MOST_CHANNELS = 6  # with a residual picture
_CHANGED = 0.01  # geodesic distance beyond which a link's inertia counts as changed
_KINDS = {"before": "nominal", "inertias_only": "inertias only", "after": "with effect"}

_WINDOWS = (
    f"Velocities simulated in MuJoCo with the written MJCF. The measured efforts are applied; every {HORIZON:g} s the "
    "simulation restarts from the measured state."
)
_CLOSED_LOOP = (
    "Efforts simulated in MuJoCo with the written MJCF: the whole motion under the recorded commands, with the "
    "controller that explains the measured efforts best."
)
_SIMULATIONS: Mapping[Kind, tuple[str, str]] = {
    "windows": ("Forward in short windows", _WINDOWS),
    "closed_loop": ("In closed loop", _CLOSED_LOOP),
}
"""Title and description of the simulation, by kind."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GapPage:
    """Content of the page.

    ``file`` is the content of ``gap.json``, ``result`` the same with samples if there are any. ``rigid (N, channels)``
    are the predictions of the final model on the trace without any named effect. ``joints``, with the ``units`` (rad or
    m) of their positions, name the columns of the trace's motion. ``simulated`` are resimulations.
    """

    file: GapFile
    result: GapResult
    rigid: FloatArray
    joints: Sequence[str] = ()
    units: Sequence[str] = ()
    simulated: Sequence[Resimulated] = ()


def write_gap_page(path: Path, page: GapPage) -> None:
    """Write the page. Raises GeomidError naming the file."""
    write_page(path, "gap.html.j2", _content(page))


def _content(page: GapPage) -> dict[str, Any]:
    result = page.result
    return {
        "file": page.file,
        "result": result,
        "words": gap_words,
        "bars": _bars(result),
        "kinds": _KINDS,
        "seconds": float(elapsed(result.trace.stamps)[-1]) if len(result.trace.stamps) else page.file.judged_seconds,
        "residuals": [residual_picture(page, channel) for channel in _channels_to_draw(result)],
        "traces": _traces(result),
        "simulations": [
            (*_SIMULATIONS[simulation.kind], _simulation_bars(simulation), traces(_worst_joints(page, simulation)))
            for simulation in page.simulated
        ],
        "located": _located(result),
        "links": list(_links(page)),
        "old": partial(_value_before, page.file.known),
        "script": Script.read(SCRIPT),
    }


def _bars(result: GapResult) -> Bars:
    kinds = list(_KINDS) if result.findings or result.ordinary else ["before", "inertias_only"]
    gaps = {kind: getattr(result.gap, kind) for kind in kinds}
    return Bars.of_gaps(
        (name, f"floor {result.floor[k]:.2g} {result.units[k]}", {kind: float(gaps[kind][k]) for kind in kinds})
        for k, name in enumerate(result.channels)
        if any(math.isfinite(values[k]) for values in gaps.values())
    )


def _simulation_bars(run: Resimulated) -> Bars:
    return Bars.of_gaps((name, "", {"before": rms, "after": run.after[name]}) for name, rms in run.before.items())


# --- Which channels, against what ---


def _channels_to_draw(result: GapResult) -> list[int]:
    """Channels to draw: those with findings or unexplained; the most improved ones if none, or one is robot-wide."""
    if result.verdict == "no gap" or not len(result.trace.stamps):
        return []
    places = [finding.joint for finding in result.findings] + [entry.joint for entry in result.unexplained]
    named = [k for place in places if place for k, name in enumerate(result.channels) if is_of(name, place)]
    improved = np.argsort(-np.nan_to_num(result.gap.inertias_only - result.gap.after), kind="stable")
    everywhere = [int(k) for k in improved[:3]] if not named or "" in places else []
    return list(dict.fromkeys(named + everywhere))[:_MOST_CHANNELS]


def _located(result: GapResult) -> list[ResidualDependence]:
    """Fractions of the gap that variables explain, for channels where corrected inertias leave a gap."""
    gaps = dict(zip(result.channels, result.gap.inertias_only, strict=True))
    return [
        entry for entry in result.located if gaps.get(entry.channel, 0.0) > GAP_ABOVE and math.isfinite(entry.velocity)
    ]


def _variable(page: GapPage, channel: int) -> tuple[str, str, FloatArray]:
    """Variable that the channel's residual depends on most: its name, its unit and its values ``(N,)``."""
    result, trace, name = page.result, page.result.trace, page.result.channels[channel]
    variables = {"load": (result.units[channel], trace.load[:, channel]), "time": ("s", elapsed(trace.stamps))}
    other_joints = [entry.depends_on for entry in result.unexplained if is_of(name, entry.joint)]
    for joint in [name, *other_joints]:
        if joint in page.joints:
            column, suffix = page.joints.index(joint), "" if joint == name else f" of {joint}"
            unit = page.units[column]
            variables[f"position{suffix}"] = (unit, trace.position[:, column])
            variables[f"velocity{suffix}"] = (f"{unit}/s", trace.velocity[:, column])
    shares = next((vars(entry) for entry in result.located if entry.channel == name), {})
    unexplained = next((v for other in other_joints for v in (other, f"velocity of {other}") if v in variables), None)
    chosen = unexplained or max(variables, key=lambda variable: np.nan_to_num(shares.get(variable, 0.0)))
    return (chosen, *variables[chosen])


def _traces(result: GapResult) -> list[ChannelTrace]:
    """Measured channels over time, those with the largest gap before first."""
    trace, times = result.trace, elapsed(result.trace.stamps)
    order = np.argsort(-np.nan_to_num(result.gap.before), kind="stable").tolist()
    measured = [k for k in order if np.any(np.isfinite(trace.measured[:, k]))][:MOST_DRAWN]
    kinds = (trace.measured, trace.before, trace.after)
    return traces(
        [Series(result.channels[k], result.units[k], times, *(values[:, k] for values in kinds)) for k in measured]
    )


def _worst_joints(page: GapPage, simulation: Resimulated) -> list[Series]:
    """Efforts of the compared joints in a simulation, the worst before first; recordings are concatenated."""
    if not simulation.efforts:
        return []
    starts = np.cumsum([0.0, *(np.ptp(part.times) for part in simulation.efforts)])
    times = np.concatenate([part.times + start for part, start in zip(simulation.efforts, starts, strict=False)])
    measured, before, after = (
        np.concatenate([getattr(part, kind) for part in simulation.efforts]) for kind in ("measured", "before", "after")
    )
    compared = [
        Series(name, page.result.units[k], times, measured[:, k], before[:, k], after[:, k])
        for k, name in enumerate(page.joints)
        if name in simulation.before
    ]
    return sorted(compared, key=lambda series: -simulation.before[series.name])[:MOST_DRAWN]


# --- The model file ---


def _value_before(known: Sequence[KnownEffect], finding: Finding, parameter: str) -> str:
    """Value of a finding's parameter in the model before."""
    for effect in known:
        if (effect.effect, effect.joint) == (finding.effect, finding.joint) and parameter in effect.parameters:
            return gap_words.measured(effect.parameters[parameter])
    return "none"


def _links(page: GapPage) -> Iterator[dict[str, Any]]:
    """Yield for every body name, old and new mass, centre of mass and central inertia, and the distance of the two."""
    for name, old, new in zip(page.result.bodies, page.file.nominal, page.result.inertias, strict=True):
        pseudo = pseudo_inertia.from_parameters(np.array([old, new]))
        distance = float(spd.distance(pseudo[0], pseudo[1]))
        yield {"name": name, "old": _body(old), "new": _body(new), "distance": distance, "changed": distance > _CHANGED}


def _body(parameters: FloatArray) -> dict[str, Any]:
    return {
        "mass": float(parameters[0]),
        "com": np.round(1e3 * pseudo_inertia.centre_of_mass(parameters), 1) + 0.0,  # + 0: no negative zero
        "inertia": np.diag(pseudo_inertia.central_inertia(parameters)),
    }
