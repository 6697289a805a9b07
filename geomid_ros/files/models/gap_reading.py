"""What the page of a gap needs beside ``gap.json``'s findings, and the result read again from both."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effect_forms import finite
from geomid_ros.files.models.gap_results import FORMAT
from geomid_ros.files.models.sidecar import effect_of
from geomid_ros.gap.result import (
    Finding,
    Gap,
    GapResult,
    LinkChange,
    Located,
    Ranked,
    Rival,
    Trace,
    Unexplained,
    effort_gains,
)
from geomid_ros.model.effects import Quantity
from geomid_ros.types import FloatArray

_MOST_BYTES = 20_000_000


def page_entries(result: GapResult, nominal: FloatArray) -> dict[str, Any]:
    """Further entries of a ``gap.json``: units, where the gap lives, candidates, and the bodies before and after.

    Args:
        result: what was found.
        nominal: parameters of the result's bodies before ``(bodies, 10)``.
    """
    bodies = zip(result.bodies, nominal.tolist(), result.inertias.tolist(), strict=True)
    return {
        "units": dict(zip(result.channels, result.units, strict=True)),
        "located": [_finite(asdict(entry)) for entry in result.located],
        "ranking": [_finite(asdict(entry)) for entry in result.ranking],
        "bodies": [{"name": name, "before": before, "after": after} for name, before, after in bodies],
        "cutoff": result.cutoff,
        "seconds": round(result.seconds, 3),
    }


def _finite(entry: dict[str, Any]) -> dict[str, Any]:
    return {key: finite(value) if isinstance(value, float) else value for key, value in entry.items()}


def read_gap(path: Path) -> dict[str, Any]:
    """Read a ``gap.json``. Raises InputError naming it."""
    try:
        document = json.loads(read_text(path, "gap report", _MOST_BYTES))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: the gap report cannot be read ({error})") from error
    if not isinstance(document, dict) or not isinstance(document.get("findings"), list):
        raise InputError(f"{path}: not a gap.json, it has no list 'findings'")
    if document.get("format") != FORMAT:
        raise InputError(f"{path}: has format {document.get('format')}, this version reads format {FORMAT}")
    return document


def gap_of(document: Mapping[str, Any], source: str) -> tuple[GapResult, FloatArray]:
    """The result of a document, without samples, and the bodies' parameters before ``(bodies, 10)``.

    Raises:
        InputError: a finding is none.
        AttributeError, KeyError, TypeError, ValueError: the document lacks something.
    """
    return _result(document, source), _bodies(document, "before")


def _result(document: Mapping[str, Any], source: str) -> GapResult:
    floor, gap = document["floor"], document["gap"]
    findings = tuple(_finding(entry, f"{source}: findings[{k}]") for k, entry in enumerate(document["findings"]))
    return GapResult(
        verdict=document["verdict"],
        findings=findings,
        links=tuple(_change(entry) for entry in document["links"]),
        unexplained=tuple(
            Unexplained(entry["joint"], entry["depends_on"], number(entry["gap"])) for entry in document["unexplained"]
        ),
        channels=tuple(floor),
        units=tuple(document["units"][name] for name in floor),
        floor=_row(floor.values()) * effort_gains(findings, tuple(floor)),
        cutoff=float(document["cutoff"]),
        gap=Gap(*(_row(gap[kind].values()) for kind in ("before", "inertias_only", "after", "expected"))),
        moving=_row(gap["moving"].values()),
        located=tuple(Located(**_with_row(entry)) for entry in document["located"]),
        ranking=tuple(Ranked(**_with_row(entry)) for entry in document["ranking"]),
        trace=_no_trace(len(floor)),
        bodies=tuple(str(entry["name"]) for entry in document["bodies"]),
        inertias=_bodies(document, "after"),
        coefficients=np.zeros(0),
        beside=(),
        ordinary=tuple(effect_of(entry, f"{source}: ordinary[{k}]") for k, entry in enumerate(document["ordinary"])),
        folded={},
        seconds=float(document["seconds"]),
    )


_OF_WORDS = {"confident": 0.99, "tentative": 0.7, "ambiguous": 0.3}


def _finding(entry: Mapping[str, Any], where: str) -> Finding:
    effect = effect_of(entry, where)
    return Finding(
        effect=effect.effect,
        joint=effect.joint,
        link=effect.link,
        parameters=effect.parameters,
        probability=_probability(entry),
        rivals=tuple(Rival(own["effect"], own["joint"], number(own["loss"])) for own in entry["rivals"]),
        separability=number(entry["separability"]),
        loss=number(entry["loss"]),
        share=number(entry["share"]),
        was={name: number(value) for name, value in entry["was"].items()},
        sentence=str(entry["sentence"]),
        settled_by=str(entry["settled_by"]),
        moment=_quantities(entry["moment"]),
    )


def _change(entry: Mapping[str, Any]) -> LinkChange:
    return LinkChange(
        link=entry["link"],
        joint=entry["joint"],
        mass=_quantities({"mass": entry["mass"]})["mass"],
        was=number(entry["was"]),
        loss=number(entry["loss"]),
        probability=_probability(entry),
        moment=_quantities(entry["moment"]),
    )


def _probability(entry: Mapping[str, Any]) -> float:
    """Of an older file, which has a word alone, one that this word stands for."""
    return float(entry["probability"]) if "probability" in entry else _OF_WORDS[entry["confidence"]]


def _quantities(entries: Mapping[str, Any]) -> dict[str, Quantity]:
    return {name: Quantity(number(own["value"]), number(own["std"]), own["unit"]) for name, own in entries.items()}


def _with_row(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: math.nan if value is None else value for key, value in entry.items()}


def number(value: Any) -> float:
    """A number of a document; what is null there is NaN."""
    return math.nan if value is None else float(value)


def _row(values: Any) -> FloatArray:
    return np.array([number(value) for value in values])


def _bodies(document: Mapping[str, Any], key: str) -> FloatArray:
    return np.array([entry[key] for entry in document["bodies"]], dtype=float).reshape(-1, 10)


def _no_trace(channels: int) -> Trace:
    """No samples."""
    nothing: Sequence[FloatArray] = [np.zeros((0, channels))] * 5
    motion = np.zeros((0, 0))
    load, measured, before, inertias_only, after = nothing
    return Trace(
        stamps=np.zeros(0, dtype=np.int64),
        position=motion,
        velocity=motion,
        load=load,
        measured=measured,
        before=before,
        inertias_only=inertias_only,
        after=after,
    )
