"""``report.html``: findings of the gap workflow on one page that needs no network.

Residuals are drawn against a variable, each in a panel small enough for a phone. The panels are SVG in which text stays
text, as the content of an ``<img>``: nothing in them is ever executed.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.files.models.gap_file import GapFile
from geomid_ros.gap.result import GapResult, ResidualDependence
from geomid_ros.gap.verdict import GAP_ABOVE
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.model.channels import is_of
from geomid_ros.model.effects import KnownEffect
from geomid_ros.report import gap_words
from geomid_ros.report.page import BEFORE, IDENTIFIED, INK, Bars, Script, write_page
from geomid_ros.report.series import MOST_DRAWN, SCRIPT, Series, elapsed, traces
from geomid_ros.resimulation.resimulate import HORIZON, Kind, Resimulated
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class Picture:
    """Picture for the page: its ``description`` in words, and its ``address`` for an ``<img>``."""

    description: str
    address: str


def residual_picture(page: GapPage, channel: int) -> Picture:
    """Draw the residual of a channel against the variable that it depends on most: above, without the named effects,
    and their contribution; below, the remaining residual. Without named effects, draw only the latter."""
    from geomid_ros.report.pictures import residual_svg  # noqa: PLC0415 imports matplotlib

    result, trace, rigid = page.result, page.result.trace, page.rigid[:, channel]
    missing, fitted = trace.measured[:, channel] - rigid, trace.after[:, channel] - rigid
    variable, variable_unit, values = _variable(page, channel)
    panels = [("left", [(missing - fitted, INK)])]
    caption = "the remaining residual"
    if np.any(fitted):
        panels = [("missing", [(missing, BEFORE), (fitted, IDENTIFIED)]), *panels]
        caption = f"above, the residual of the model with corrected inertias, and what the findings explain; {caption}"
    title = f"{result.channels[channel]} against {variable}"
    svg = residual_svg(
        title=title if len(title) <= 52 else f"{title[:22]}…{title[-28:]}",
        label=f"{variable} [{variable_unit}]",
        values=values,
        panels=[(f"{name} [{result.units[channel]}]", curves) for name, curves in panels],
        limits=_limits(np.concatenate([missing, fitted]), float(result.floor[channel])),
        band=2.0 * float(result.floor[channel]),
    )
    return Picture(f"Residual of {title}: {caption}.", f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}")


def _limits(values: FloatArray, floor: float) -> tuple[float, float]:
    """Limits that contain all but the outermost values, and at least the band of the floor."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (0.3, 99.7)) if len(finite) else (0.0, 0.0)
    low, high = min(low, -2.5 * floor), max(high, 2.5 * floor)
    margin = 0.08 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


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
        "added": result.added,
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


def _traces(result: GapResult) -> list[dict[str, Any]]:
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


def _value_before(known: Sequence[KnownEffect], added: KnownEffect, parameter: str) -> str:
    """Value of an added effect's parameter in the model before."""
    for effect in known:
        if (effect.effect, effect.joint) == (added.effect, added.joint) and parameter in effect.parameters:
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
