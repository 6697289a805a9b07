"""``gap.json``: the result of the gap workflow for programs; :class:`GapFile` is its schema.

Its ``format`` is 1. Effects are as in the sidecar. ``confidence`` of a finding or a link is its probability as a word:
``confident`` above .95, ``tentative`` from .5, ``ambiguous``. Missing numbers (a channel without measurements, say) are
null.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np

from geomid_ros.checks.causes import Cause
from geomid_ros.checks.causes import RecordingFault as Doubt
from geomid_ros.errors import InputError
from geomid_ros.files.models.estimate_file import by_channel
from geomid_ros.files.schema import FORMAT, attributes_entry, from_document, read_document, to_document
from geomid_ros.gap.result import GapErrors, GapResult, GapSummary, Rival, Trace, effort_gains
from geomid_ros.model.effects import KnownEffect, effect_class
from geomid_ros.types import FloatArray

_KINDS = ("before", "inertias_only", "after", "expected")
ErrorsByStage: TypeAlias = Mapping[str, Mapping[str, float]]
Parameters: TypeAlias = Annotated[FloatArray, (10,)]


@dataclass(frozen=True, eq=False, kw_only=True)
class BodyEntry:
    """A body with its parameters ``(10,)`` before and after the search."""

    name: str
    before: Parameters
    after: Parameters


@dataclass(frozen=True, kw_only=True)
class CauseEntry(Cause):
    """A cause that makes a recording doubtful, with its rivals."""

    sure: bool
    rivals: tuple[Cause, ...]

    @property
    def doubt(self) -> str:
        """The cause and its rivals in one sentence."""
        return Doubt(cause=self, sure=self.sure, rivals=self.rivals).sentence


@dataclass(frozen=True, eq=False, kw_only=True)
class GapFile(GapSummary):
    """Everything that the page of a gap needs.

    Attributes:
        source: names it in messages.
        gap: residuals of held-out samples by channel, in units of the noise floor: ``before``, ``inertias_only``,
            ``after`` (the written model, which contains the confident findings), ``expected`` and ``moving``.
        floor: standard deviation of the noise by channel [N m, N], with efforts corrected by the gains that were found.
        resimulated: errors ``before`` and ``after`` of held-out data simulated in short windows, by joint or wrench
            channel, in units of the error due to noise; None if they were not simulated.
        closed_loop: the same for efforts in closed loop under the recorded commands.
        units: by channel.
        bodies: before and after.
        robot, recordings: names.
        known: effects of the model before.
        judged_seconds, not_simulated: duration of held-out data; why nothing was simulated, or empty.
        causes, warnings, notes: causes that make the recording doubtful, with the ``settings`` that fix it; remarks on
            it and on the model that it was compared with; choices made for the user.
    """

    source: str
    gap: ErrorsByStage
    floor: Mapping[str, float]
    resimulated: ErrorsByStage | None
    closed_loop: ErrorsByStage | None
    units: Mapping[str, str]
    bodies: tuple[BodyEntry, ...]
    robot: str
    recordings: tuple[str, ...]
    judged_seconds: float
    known: tuple[KnownEffect, ...]
    not_simulated: str
    causes: tuple[CauseEntry, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @staticmethod
    def of(document: Mapping[str, Any], source: str) -> GapFile:
        """Read the content of a document. Raises InputError naming the ``source`` and the fault."""
        return from_document(GapFile, {**document, "source": source}, f"{source}:")

    @property
    def nominal(self) -> FloatArray:
        """Parameters of the bodies before ``(bodies, 10)``."""
        return np.array([body.before for body in self.bodies]).reshape(-1, 10)

    @property
    def doubts(self) -> list[str]:
        """Sentences on what makes the recording doubtful."""
        return [cause.doubt for cause in self.causes]

    @property
    def result(self) -> GapResult:
        """The result without samples. Raises InputError naming the source if it is inconsistent."""
        channels, floor = tuple(self.floor), np.array([*self.floor.values()])
        if missing := [key for key in (*_KINDS, "moving") if self.gap.get(key, {}).keys() != {*channels}]:
            raise InputError(f"{self.source}: gap.{missing[0]} does not say a number for each channel of the floor")
        if {*channels} - self.units.keys():
            raise InputError(f"{self.source}: units does not say one for each channel of the floor")
        errors = {key: np.array([*item.values()]) for key, item in self.gap.items()}
        motion, nothing = np.zeros((0, 0)), np.zeros((0, len(channels)))  # the file has no samples
        predicted = dict.fromkeys(("load", "measured", "before", "inertias_only", "after"), nothing)
        return GapResult(
            **{field.name: getattr(self, field.name) for field in fields(GapSummary)},
            channels=channels,
            units=tuple(self.units[name] for name in channels),
            floor=floor * effort_gains(self.findings, channels),
            gap=GapErrors(*(errors[kind] for kind in _KINDS)),
            moving=errors["moving"],
            trace=Trace(stamps=np.zeros(0, dtype=np.int64), position=motion, velocity=motion, **predicted),
            bodies=tuple(item.name for item in self.bodies),
            inertias=np.array([item.after for item in self.bodies]).reshape(-1, 10),
            coefficients=np.zeros(0),
            beside=(),
            folded={},
            newly_folded={},
        )


def read_gap(path: Path) -> dict[str, Any]:
    """Read a ``gap.json``. Raises InputError naming it."""
    return read_document(path, "gap report", ("findings",))


@dataclass(frozen=True, kw_only=True)
class OpenFinding(KnownEffect):
    """A finding and its ``rivals``."""

    rivals: tuple[Rival, ...] = ()


def read_open_findings(path: Path) -> tuple[list[OpenFinding], dict[str, float]]:
    """Read the findings of a ``gap.json`` that have rivals, and the noise floor of its channels [N m, N].

    Raises InputError naming the file and the fault, or that no finding is open.
    """
    document = read_gap(path)
    found = from_document(tuple[OpenFinding, ...], document["findings"], f"{path}: findings")
    findings = [finding for finding in found if finding.rivals]
    for rival in (rival for finding in findings for rival in finding.rivals):
        effect_class(rival.effect)
    if not findings:
        raise InputError(f"{path}: no finding has a rival; nothing to discriminate")
    floor = from_document(dict[str, float], document.get("floor") or {}, f"{path}: floor")
    return findings, {name: value for name, value in floor.items() if np.isfinite(value)}


def is_open(result: GapResult) -> bool:
    """True if an uncertain finding has rivals, so that a motion may discriminate between them."""
    return any(finding.rivals and finding.settled_by for finding in result.findings)


def gap_document(result: GapResult, simulations: Mapping[str, ErrorsByStage]) -> dict[str, Any]:
    """Document of a result. ``simulations`` has the errors {before, after} of ``windows`` and ``closed_loop``."""
    channels, gap = result.channels, result.gap
    return {
        "format": FORMAT,
        **attributes_entry(result, "verdict", "unexplained", "unjudged", "ordinary"),
        "findings": [to_document(item) | attributes_entry(item, "confidence", "sentence") for item in result.findings],
        "links": [to_document(item) | attributes_entry(item, "confidence", "sentence") for item in result.links],
        "gap": {kind: by_channel(channels, getattr(gap, kind)) for kind in _KINDS}
        | {"moving": by_channel(channels, result.moving)},
        "floor": by_channel(channels, result.corrected_floor),
        "resimulated": to_document(simulations.get("windows")),
        "closed_loop": to_document(simulations.get("closed_loop")),
    }


def page_entries(result: GapResult, nominal: FloatArray) -> dict[str, Any]:
    """Further entries of a ``gap.json``: units, location of the gap, candidates, and the bodies before and after.

    Args:
        result: the result of the search.
        nominal: parameters of the result's bodies before ``(bodies, 10)``.
    """
    bodies = zip(result.bodies, nominal, result.inertias, strict=True)
    return {
        "units": dict(zip(result.channels, result.units, strict=True)),
        **attributes_entry(result, "located", "ranking"),
        "bodies": [to_document(BodyEntry(name=name, before=before, after=after)) for name, before, after in bodies],
        "cutoff": result.cutoff,
        "seconds": round(result.seconds, 3),
    }
