"""What the gap workflow found, with all that its tables, pictures and files need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.types import FloatArray, IntArray

Confidence: TypeAlias = Literal["confident", "tentative", "ambiguous"]
Verdict: TypeAlias = Literal["no gap", "named", "incomplete", "unexplained"]


@dataclass(frozen=True)
class Rival:
    """Another name for the same remainder; ``loss`` is by how much its score is worse (differences of -2 log p)."""

    effect: str
    joint: str
    loss: float


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A named effect.

    ``joint``: the joint it acts at, the joint that moves the ``link`` of a payload, the topic of a wrench sensor, and
    empty for the whole robot. ``separability``: share of the effect's columns, 0 to 1, outside the span of the inertias
    and the other findings for this motion. ``loss``: how much worse the score is without it. ``share``: of the gap
    that it closes. ``sentence`` says it in words; ``settled_by`` names the recording that would settle an ambiguity,
    empty when there is none.
    """

    effect: str
    joint: str
    link: str
    parameters: Mapping[str, Quantity]
    confidence: Confidence
    rivals: tuple[Rival, ...]
    separability: float
    loss: float
    share: float
    sentence: str
    settled_by: str


@dataclass(frozen=True)
class Unexplained:
    """A joint or wrench channel whose remainder no name explains: ``gap`` times the floor, and on what it depends
    (``position``, ``velocity``, ``load``, ``time``, ``reversals``, ``unknown``, or the name of another joint)."""

    joint: str
    depends_on: str
    gap: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Trace:
    """Held-out data: ``stamps (N,)`` [ns], joints' ``position, velocity (N, joints)``, and by channel what was measured
    and what the three models predict, ``(N, channels)``, NaN where not measured. ``load (N, channels)`` is the
    magnitude of what the final model predicts."""

    stamps: IntArray
    position: FloatArray
    velocity: FloatArray
    load: FloatArray
    measured: FloatArray
    before: FloatArray
    inertias_only: FloatArray
    after: FloatArray


@dataclass(frozen=True, eq=False)
class Gap:
    """Root mean square residual of every channel in units of its noise floor, each ``(channels,)``. ``expected`` is
    what noise and the uncertainty of all that was fitted would leave after the names if the model were right."""

    before: FloatArray
    inertias_only: FloatArray
    after: FloatArray
    expected: FloatArray


@dataclass(frozen=True)
class Located:
    """Where a channel's first remainder lives: its share, 0 to 1, that a smooth curve of one variable explains."""

    channel: str
    velocity: float
    position: float
    load: float
    time: float
    reversals: float


@dataclass(frozen=True)
class Ranked:
    """A candidate of the last round, the best first: by how much it would improve, or improves, the score."""

    effect: str
    joint: str
    gain: float
    separability: float
    chosen: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class GapResult:
    """The whole finding. ``channels`` name the rows of all per-channel arrays; ``units`` are theirs, ``floor`` is the
    noise's standard deviation in them. ``inertias (bodies, 10)`` are those of the final model (pinocchio's order, about
    the link's origin), payloads not included; ``bodies`` their links. ``coefficients`` are those of the effects that
    the model had before, fitted anew, in its order, NaN where it had none or a finding's parameter is the whole;
    ``beside`` are those that it had beside its coefficients, fitted anew, without those that cannot be."""

    verdict: Verdict
    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    floor: FloatArray
    gap: Gap
    located: tuple[Located, ...]
    ranking: tuple[Ranked, ...]
    trace: Trace
    bodies: tuple[str, ...]
    inertias: FloatArray
    coefficients: FloatArray
    beside: tuple[KnownEffect, ...]
    seconds: float
