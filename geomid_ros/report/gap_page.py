"""``report.html``: what the gap workflow found, on one page that needs no network and runs no script."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.files.models.gap_file import GapFile
from geomid_ros.gap.judgement.held_out import REACHED
from geomid_ros.gap.result import Finding, GapResult, Located
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.model.channels import is_of
from geomid_ros.model.effects import KnownEffect
from geomid_ros.report import gap_words
from geomid_ros.report.gap_figures import (
    Against,
    ChannelResiduals,
    Picture,
    after_pause,
    elapsed,
    overlay_picture,
    remainder_picture,
)
from geomid_ros.report.page import Bars, write_page
from geomid_ros.report.series import MOST_DRAWN
from geomid_ros.report.simulated_again import SimulatedAgain
from geomid_ros.types import FloatArray

_MOST_CHANNELS = 6  # whose remainder is drawn
_SECONDS = {"efforts": 10.0, "closed_loop": 10.0, "windows": 2.0}  # of held-out data, in a panel
_MOST_CANDIDATES = 15
_CHANGED = 0.01  # geodesic distance from which on a link's inertia has changed
_TITLES = {"windows": "Forward in short windows", "closed_loop": "In closed loop"}
_KINDS = {"before": "nominal", "inertias_only": "inertias only", "after": "with effect"}


@dataclass(frozen=True, kw_only=True, eq=False)
class GapPage:
    """What the page is made of.

    ``file`` is what ``gap.json`` says, ``result`` the same with samples if there are any. ``rigid (N, channels)`` is
    what the final model predicts on the trace without any named effect. ``joints`` with ``units`` (rad or m) of their
    positions name the columns of the trace's motion. ``simulated`` are simulations.
    """

    file: GapFile
    result: GapResult
    rigid: FloatArray
    joints: Sequence[str] = ()
    units: Sequence[str] = ()
    simulated: Sequence[SimulatedAgain] = ()


def write_gap_page(path: Path, page: GapPage, progress: Callable[[float], None]) -> None:
    """Write the page; ``progress`` is called with the share of its pictures that are drawn."""
    write_page(path, "gap.html.j2", _content(page, progress))


def _content(page: GapPage, progress: Callable[[float], None]) -> dict[str, Any]:
    result, known = page.result, page.file.known_effects("known")
    overlays = [partial(_overlay, page, channel) for channel in _overlay_channels(result)]
    remainders = [
        (result.channels[channel], [partial(remainder_picture, _remainder(page, channel), against) for against in many])
        for channel in _telling_channels(result)
        for many in [list(_variables(page, channel))]
    ]
    motions = [[partial(_motion, again, joint) for joint in _worst_joints(again)] for again in page.simulated]
    total = len(overlays) + sum(len(many) for _, many in remainders) + sum(map(len, motions))
    draw = _Drawing(total, progress)
    return {
        "file": page.file,
        "known": known,
        "result": result,
        "verdict": gap_words.verdict_sentence(result),
        "in_short": gap_words.in_short(result),
        "confidence": gap_words.CONFIDENCE,
        "bars": _bars(result),
        "kinds": _KINDS,
        "seconds": float(elapsed(result.trace.stamps)[-1]) if len(result.trace.stamps) else page.file.judged_seconds,
        "remainders": [(name, [draw(picture) for picture in many]) for name, many in remainders],
        "overlays": [draw(picture) for picture in overlays],
        "motions": [
            (_TITLES[again.kind], again, _motion_bars(again), [draw(picture) for picture in many])
            for again, many in zip(page.simulated, motions, strict=True)
        ],
        "candidates": result.ranking[:_MOST_CANDIDATES],
        "located": _located(result),
        "links": list(_links(page)),
        "old": partial(_old, known),
        "not_explained": gap_words.not_explained(result),
        "record": gap_words.to_record(result),
    }


class _Drawing:
    """Draws pictures and counts them."""

    def __init__(self, total: int, progress: Callable[[float], None]) -> None:
        self._total = total
        self._done = 0
        self._progress = progress

    def __call__(self, picture: Callable[[], Picture]) -> Picture:
        drawn = picture()
        self._done += 1
        self._progress(self._done / self._total)
        return drawn


def _bars(result: GapResult) -> Bars:
    kinds = list(_KINDS) if result.findings or result.ordinary else ["before", "inertias_only"]
    gaps = {kind: getattr(result.gap, kind) for kind in kinds}
    return Bars.of_gaps(
        (name, f"floor {result.floor[k]:.2g} {result.units[k]}", {kind: float(gaps[kind][k]) for kind in kinds})
        for k, name in enumerate(result.channels)
        if any(math.isfinite(values[k]) for values in gaps.values())
    )


def _motion_bars(again: SimulatedAgain) -> Bars:
    names, kinds = again.errors["before"], ("before", "after")
    return Bars.of_gaps((name, "", {kind: again.errors[kind][name] for kind in kinds}) for name in names)


# --- Which channels, against what ---


def _telling_channels(result: GapResult) -> list[int]:
    """Channels whose remainder is worth a look: where something was named or is missing, then where most improved."""
    if result.verdict == "no gap" or not len(result.trace.stamps):
        return []
    places = [finding.joint for finding in result.findings] + [entry.joint for entry in result.unexplained]
    named = [k for place in places if place for k, name in enumerate(result.channels) if is_of(name, place)]
    improved = np.argsort(-np.nan_to_num(result.gap.inertias_only - result.gap.after), kind="stable")
    everywhere = [int(k) for k in improved[:3]] if not named or "" in places else []
    return list(dict.fromkeys(named + everywhere))[:_MOST_CHANNELS]


def _located(result: GapResult) -> list[Located]:
    """Where the gap lives, for channels in which inertias leave one."""
    gaps = dict(zip(result.channels, result.gap.inertias_only, strict=True))
    return [
        entry for entry in result.located if gaps.get(entry.channel, 0.0) > REACHED and math.isfinite(entry.velocity)
    ]


def _remainder(page: GapPage, channel: int) -> ChannelResiduals:
    result, trace = page.result, page.result.trace
    rigid = page.rigid[:, channel]
    return ChannelResiduals(
        result.channels[channel],
        result.units[channel],
        trace.measured[:, channel] - rigid,
        trace.after[:, channel] - rigid,
        float(result.floor[channel]),
    )


def _variables(page: GapPage, channel: int) -> Iterator[Against]:
    """Motion of the channel's joint and of those that it depends on, load, time."""
    result, trace = page.result, page.result.trace
    name = result.channels[channel]
    others = [entry.depends_on for entry in result.unexplained if is_of(name, entry.joint)]
    for joint in [name, *others]:
        if joint in page.joints:
            column, of = page.joints.index(joint), "" if joint == name else f" of {joint}"
            unit = page.units[column]
            yield Against(f"position{of}", unit, trace.position[:, column])
            yield Against(f"velocity{of}", f"{unit}/s", trace.velocity[:, column])
    yield Against("load", result.units[channel], trace.load[:, channel])
    yield Against("time", "s", elapsed(trace.stamps))


def _overlay_channels(result: GapResult) -> list[int]:
    """Measured channels, the worst before first."""
    order = np.argsort(-np.nan_to_num(result.gap.before), kind="stable")
    return [int(k) for k in order if np.any(np.isfinite(result.trace.measured[:, k]))][:MOST_DRAWN]


def _overlay(page: GapPage, channel: int) -> Picture:
    result, trace = page.result, page.result.trace
    new = after_pause(trace.stamps)
    lines = {key: np.where(new, np.nan, getattr(trace, key)[:, channel]) for key in ("measured", "before", "after")}
    return overlay_picture(
        result.channels[channel], result.units[channel], elapsed(trace.stamps), lines, _SECONDS["efforts"]
    )


def _worst_joints(again: SimulatedAgain) -> list[int]:
    """Joints whose simulation was judged, the worst before first."""
    before = again.errors["before"]
    judged = [index for index, joint in enumerate(again.joints) if joint in before]
    return sorted(judged, key=lambda index: -before[again.joints[index]])[:MOST_DRAWN]


def _motion(again: SimulatedAgain, joint: int) -> Picture:
    lines = {key: getattr(again, key)[:, joint] for key in ("measured", "before", "after")}
    return overlay_picture(again.joints[joint], again.units[joint], again.times, lines, _SECONDS[again.kind])


# --- The model file ---


def _old(known: Sequence[KnownEffect], finding: Finding, parameter: str) -> str:
    """What the model said of a finding's parameter before."""
    for effect in known:
        if (effect.effect, effect.joint) == (finding.effect, finding.joint) and parameter in effect.parameters:
            return gap_words.measured(effect.parameters[parameter])
    return "none"


def _links(page: GapPage) -> Iterator[dict[str, Any]]:
    """Of every body: name, old and new mass, centre of mass and central inertia, and the distance between the two."""
    for name, old, new in zip(page.result.bodies, page.file.nominal, page.result.inertias, strict=True):
        pseudo = pseudo_inertia.from_parameters(np.array([old, new]))
        distance = float(spd.distance(pseudo[0], pseudo[1]))
        yield {"name": name, "old": _body(old), "new": _body(new), "distance": distance, "changed": distance > _CHANGED}


def _body(parameters: FloatArray) -> dict[str, Any]:
    return {
        "mass": float(parameters[0]),
        "com": np.round(1e3 * pseudo_inertia.centre_of_mass(parameters), 1) + 0.0,  # no minus before a zero
        "inertia": np.diag(pseudo_inertia.central_inertia(parameters)),
    }
