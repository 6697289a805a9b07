"""``gap.json``: what the gap workflow found, for programs; :class:`GapFile` is its schema.

Its ``format`` is 1. Effects are as in the sidecar; of a finding and of a link ``confidence`` says the probability in a
word: ``confident`` above .95, ``tentative`` from .5, ``ambiguous``. Numbers that do not exist (a channel without
measurements, say) are null.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np

from geomid_ros.checks.causes import Cause
from geomid_ros.checks.causes import Finding as Doubt
from geomid_ros.errors import InputError
from geomid_ros.files.models.estimate_file import by_channel
from geomid_ros.files.schema import FORMAT, entry, plain, read_document, structured
from geomid_ros.gap.result import (
    Finding,
    GapErrors,
    GapResult,
    LinkChange,
    Located,
    Ranked,
    Rival,
    Trace,
    Unexplained,
    effort_gains,
)
from geomid_ros.model.effects import KnownEffect, effect_class
from geomid_ros.types import FloatArray

_AS_FOUND = (
    *("verdict", "findings", "links", "unexplained", "unjudged", "ordinary"),
    *("located", "ranking", "cutoff", "seconds"),
)
"""What the file has as the result has it."""
_KINDS = ("before", "inertias_only", "after", "expected")
Errors: TypeAlias = Mapping[str, Mapping[str, float]]
Parameters: TypeAlias = Annotated[FloatArray, (10,)]


@dataclass(frozen=True, eq=False, kw_only=True)
class BodyEntry:
    """A body, and its parameters ``(10,)`` before and after."""

    name: str
    before: Parameters
    after: Parameters


@dataclass(frozen=True, kw_only=True)
class CauseEntry(Cause):
    """What makes a recording doubtful, with its rivals."""

    sure: bool
    rivals: tuple[Cause, ...]

    @property
    def doubt(self) -> str:
        """All of it in a sentence."""
        return Doubt(cause=self, sure=self.sure, rivals=self.rivals).sentence


@dataclass(frozen=True, eq=False, kw_only=True)
class GapFile:
    """All that the page of a gap needs.

    Attributes:
        source: names it in messages.
        verdict, findings, links, unexplained, unjudged, ordinary, located, ranking: see
            :class:`~geomid_ros.gap.result.GapResult`, the surest first.
        gap: ``before``, ``inertias_only``, ``after`` (the written model, in which are the findings that are confident),
            ``expected`` and ``moving``, each the residual of held-out samples in units of the floor by channel.
        floor: the noise's standard deviation by channel [N m, N], of efforts without the gains that were found.
        resimulated: ``before`` and ``after``, each the error of held-out data that are simulated again in short windows
            by joint or wrench channel, in units of what noise makes of it; None where that could not be.
        closed_loop: the same of efforts in closed loop under the recorded commands.
        units: by channel.
        bodies, cutoff, seconds: bodies before and after; of the low-pass [Hz]; that the search took.
        robot, recordings: names.
        known: effects that the model had.
        judged_seconds, not_simulated: of held-out data; why nothing was simulated, or empty.
        causes, warnings, notes: what makes the recording doubtful, with the ``settings`` that mend it; what else to
            know of it and of the model that it was compared with; what was settled for the user.
    """

    source: str
    verdict: str
    findings: tuple[Finding, ...]
    links: tuple[LinkChange, ...]
    unexplained: tuple[Unexplained, ...]
    ordinary: tuple[KnownEffect, ...]
    gap: Errors
    floor: Mapping[str, float]
    resimulated: Errors | None
    closed_loop: Errors | None
    units: Mapping[str, str]
    located: tuple[Located, ...]
    ranking: tuple[Ranked, ...]
    bodies: tuple[BodyEntry, ...]
    cutoff: float
    seconds: float
    robot: str
    recordings: tuple[str, ...]
    judged_seconds: float
    known: tuple[KnownEffect, ...]
    not_simulated: str
    causes: tuple[CauseEntry, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    unjudged: tuple[str, ...] = ()

    @staticmethod
    def of(document: Mapping[str, Any], source: str) -> GapFile:
        """The content of a document. Raises InputError naming the ``source`` and what is wrong in it."""
        return structured(GapFile, {**document, "source": source}, f"{source}:")

    @property
    def nominal(self) -> FloatArray:
        """The bodies' parameters before ``(bodies, 10)``."""
        return np.array([own.before for own in self.bodies]).reshape(-1, 10)

    @property
    def doubts(self) -> list[str]:
        """What makes the recording doubtful, in sentences."""
        return [own.doubt for own in self.causes]

    @property
    def result(self) -> GapResult:
        """The result without samples. Raises InputError naming the source for what cannot be."""
        channels, floor = tuple(self.floor), np.array([*self.floor.values()])
        if missing := [key for key in (*_KINDS, "moving") if self.gap.get(key, {}).keys() != {*channels}]:
            raise InputError(f"{self.source}: gap.{missing[0]} does not say a number for each channel of the floor")
        if {*channels} - self.units.keys():
            raise InputError(f"{self.source}: units does not say one for each channel of the floor")
        errors = {key: np.array([*own.values()]) for key, own in self.gap.items()}
        return GapResult(
            **{name: getattr(self, name) for name in _AS_FOUND},
            channels=channels,
            units=tuple(self.units[name] for name in channels),
            floor=floor * effort_gains(self.findings, channels),
            gap=GapErrors(*(errors[kind] for kind in _KINDS)),
            moving=errors["moving"],
            trace=_no_trace(len(channels)),
            bodies=tuple(own.name for own in self.bodies),
            inertias=np.array([own.after for own in self.bodies]).reshape(-1, 10),
            coefficients=np.zeros(0),
            beside=(),
            folded={},
            newly_folded={},
        )


def _no_trace(channels: int) -> Trace:
    """No samples."""
    nothing, motion = np.zeros((0, channels)), np.zeros((0, 0))
    predicted = dict.fromkeys(("load", "measured", "before", "inertias_only", "after"), nothing)
    return Trace(stamps=np.zeros(0, dtype=np.int64), position=motion, velocity=motion, **predicted)


def read_gap(path: Path) -> dict[str, Any]:
    """Read a ``gap.json``. Raises InputError naming it."""
    document = read_document(path, "gap report", ("findings",))
    structured(_Findings, document, f"{path}:")
    return document


@dataclass(frozen=True, kw_only=True)
class OpenFinding(KnownEffect):
    """A finding, and its ``rivals``."""

    rivals: tuple[Rival, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _Findings:
    findings: tuple[OpenFinding, ...]
    floor: Mapping[str, float] | None = None


def read_open_findings(path: Path) -> tuple[list[OpenFinding], dict[str, float]]:
    """The findings with rivals in a ``gap.json``, and the noise floor of its channels [N m, N].

    Raises InputError naming the file and what is wrong in it, or that nothing is open.
    """
    document = structured(_Findings, read_gap(path), f"{path}:")
    left = [finding for finding in document.findings if finding.rivals]
    for rival in (rival for finding in left for rival in finding.rivals):
        effect_class(rival.effect)
    if not left:
        raise InputError(f"{path}: no finding has a rival, so that there is nothing to settle")
    return left, {name: value for name, value in (document.floor or {}).items() if np.isfinite(value)}


def is_open(result: GapResult) -> bool:
    """Whether a finding is not sure and has rivals, so that a motion may decide."""
    return any(finding.rivals and finding.settled_by for finding in result.findings)


def gap_document(result: GapResult, simulations: Mapping[str, Errors]) -> dict[str, Any]:
    """The document of a result; ``simulations`` has the errors {before, after} of ``windows`` and ``closed_loop``."""
    channels, gap = result.channels, result.gap
    return {
        "format": FORMAT,
        **entry(result, "verdict", "unexplained", "unjudged", "ordinary"),
        "findings": [plain(own) | entry(own, "confidence") for own in result.findings],
        "links": [plain(own) | entry(own, "confidence", "sentence") for own in result.links],
        "gap": {kind: by_channel(channels, getattr(gap, kind)) for kind in _KINDS}
        | {"moving": by_channel(channels, result.moving)},
        "floor": by_channel(channels, result.corrected_floor),
        "resimulated": plain(simulations.get("windows")),
        "closed_loop": plain(simulations.get("closed_loop")),
    }


def page_entries(result: GapResult, nominal: FloatArray) -> dict[str, Any]:
    """Further entries of a ``gap.json``: units, where the gap lives, candidates, and the bodies before and after.

    Args:
        result: what was found.
        nominal: parameters of the result's bodies before ``(bodies, 10)``.
    """
    bodies = zip(result.bodies, nominal, result.inertias, strict=True)
    return {
        "units": dict(zip(result.channels, result.units, strict=True)),
        **entry(result, "located", "ranking"),
        "bodies": [plain(BodyEntry(name=name, before=before, after=after)) for name, before, after in bodies],
        "cutoff": result.cutoff,
        "seconds": round(result.seconds, 3),
    }
