"""Result of the gap workflow, with all that its tables, pictures and files need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.model.effects import KnownEffect, Quantity, Values, effect_class
from geomid_ros.types import FloatArray, IntArray

Confidence: TypeAlias = Literal["confident", "tentative", "ambiguous"]
Verdict: TypeAlias = Literal["no gap", "named", "incomplete", "unexplained"]


SURE, LIKELY = 0.95, 0.5
"""Least probabilities of a sure and of a tentative named effect. A less likely one is kept if rivals make up for it,
see :attr:`Finding.is_likely`."""


_BEFORE = {"confident": "", "tentative": "Perhaps ", "ambiguous": "One of several explanations: "}


def confidence_of(probability: float) -> Confidence:
    """Name the confidence of a probability."""
    return "confident" if probability > SURE else "tentative" if probability >= LIKELY else "ambiguous"


@dataclass(frozen=True)
class Rival:
    """Another effect that explains the same remainder; its score is worse by ``loss`` (differences of -2 log p)."""

    effect: str
    joint: str
    loss: float


@dataclass(frozen=True, kw_only=True)
class Finding(KnownEffect):
    """A named effect.

    Attributes:
        probability: of the effect, against nothing and its rivals.
        rivals: other effects that explain the same remainder.
        separability: fraction of the effect's columns, 0 to 1, that inertias and the other findings cannot imitate for
            this motion, as far as prior and other recordings let them.
        loss: how much worse the score is without it.
        share: fraction of the gap that it closes.
        was: the parameters before, if the model had the effect, which has changed.
        settled_by: the recording that would settle an ambiguity, empty when there is none.
        moment: mass times centre of mass of a payload whose mass the motion does not identify; else empty.
    """

    probability: float
    rivals: tuple[Rival, ...]
    separability: float
    loss: float
    share: float
    was: Values
    settled_by: str
    moment: Mapping[str, Quantity] = field(default_factory=dict)

    @property
    def confidence(self) -> Confidence:
        """Confidence as a word."""
        return confidence_of(self.probability)

    @property
    def is_likely(self) -> bool:
        """True if it or one of its rivals is more likely than nothing."""
        weights = np.exp(-0.5 * np.array([0.0, *(rival.loss for rival in self.rivals)]))
        return bool(self.probability * np.sum(weights) >= LIKELY)

    @property
    def sentence(self) -> str:
        """Sentence with 95 % intervals and the former values; with the ``moment`` instead where there is one."""
        effect = effect_class(self.effect)
        where = f" at link '{self.link}'" if self.link else f" at '{self.joint}'" if self.joint else ""
        sizes, was, aside = self.parameters, self.was, ""
        if self.moment:
            sizes, was = self.moment, {}
            aside = f"; this motion does not identify its mass: {_said(self.parameters['mass'])}"
        terms = [
            f"{name} {_said(quantity)}" + (f" instead of {was[name]:.4g}" if name in was else "")
            for name, quantity in list(sizes.items())[: effect.stated_parameter_count]
        ]
        qualifier = _BEFORE[self.confidence]
        text = f"{effect.label}{where}: {', '.join(terms)} (95 % interval){aside}."
        return qualifier + text if qualifier else text[0].upper() + text[1:]


@dataclass(frozen=True)
class LinkChange:
    """A link that differs from the model.

    Attributes:
        link: its name.
        joint: the joint that moves it.
        mass: increase of its mass [kg].
        was: its mass in the model [kg].
        loss: how much worse the score is if it has the model's inertia.
        probability: that it has changed.
        moment: increase of the first moment [kg m] about the origin of the link's frame, by axis, if the mass may be
            unchanged; else empty.
        centre: position of the added mass in the link's frame [m], by axis, given a model from recordings.
    """

    link: str
    joint: str
    mass: Quantity
    was: float
    loss: float
    probability: float
    moment: Mapping[str, Quantity] = field(default_factory=dict)
    centre: Mapping[str, Quantity] = field(default_factory=dict)

    @property
    def confidence(self) -> Confidence:
        """Confidence as a word."""
        return confidence_of(self.probability)

    @property
    def squared_significance(self) -> float:
        """Squared change in standard deviations: of the mass, or of the largest part of the first moment."""
        sizes = self.moment.values() or (self.mass,)
        return max(((q.value / q.std) ** 2 for q in sizes if q.std > 0.0), default=float("inf"))

    @property
    def sentence(self) -> str:
        """Sentence; each number after ± is one standard deviation."""
        if self.moment:
            changes = (f"{axis} by {q.value:.3g} ± {q.std:.2g} {q.unit}" for axis, q in self.moment.items())
            by_mass = f"{self.mass.value:.2g} ± {self.mass.std:.2g} kg"
            return f"first moment of link '{self.link}' changed: {', '.join(changes)} (mass by {by_mass})"
        lower = "lower" if self.mass.value < 0.0 else "higher"
        size = f"{abs(self.mass.value):.3g} ± {self.mass.std:.2g} kg"
        text = f"mass of link '{self.link}' is {size} {lower} than in the model ({self.was:.3g} kg)"
        centre = ", ".join(f"{axis} {q.value:.3g} ± {q.std:.2g}" for axis, q in self.centre.items())
        return f"{text}; the difference is centred at {centre} m" if centre else text


@dataclass(frozen=True)
class Unexplained:
    """A joint or wrench channel whose remainder no named effect explains: ``gap`` times the floor, and the variable
    that it depends on (``position``, ``velocity``, ``acceleration``, ``load``, ``time``, ``reversals``, ``unknown``, or
    another joint's name)."""

    joint: str
    depends_on: str
    gap: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Trace:
    """Held-out data, and the models' predictions of them.

    Attributes:
        stamps: ``(N,)`` [ns].
        position, velocity: of the joints ``(N, J)``.
        load: magnitude of the final model's prediction ``(N, C)``.
        measured: ``(N, C)``, NaN where not measured.
        before, inertias_only, after: predictions of the three models ``(N, C)``.
    """

    stamps: IntArray
    position: FloatArray
    velocity: FloatArray
    load: FloatArray
    measured: FloatArray
    before: FloatArray
    inertias_only: FloatArray
    after: FloatArray


@dataclass(frozen=True, eq=False)
class GapErrors:
    """Residual RMS of every channel in units of its noise floor, each ``(channels,)``. ``expected`` is that of a right
    model with the named effects, due to noise and the uncertainty of the fit."""

    before: FloatArray
    inertias_only: FloatArray
    after: FloatArray
    expected: FloatArray


@dataclass(frozen=True)
class ResidualDependence:
    """Fraction of a channel's remainder, 0 to 1, that a smooth curve of each variable explains."""

    channel: str
    velocity: float
    position: float
    load: float
    time: float
    reversals: float


@dataclass(frozen=True)
class Ranked:
    """A candidate of the last round, best first, with the improvement of the score that it brings or would bring."""

    effect: str
    joint: str
    gain: float
    separability: float
    chosen: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class GapSummary:
    """Conclusions of the gap workflow, the same in a result and in its file.

    Attributes:
        verdict: in a word or two.
        findings: the named effects, the one that matters most first.
        links: those whose mass or first moment differs from the model, without payloads.
        unexplained: what no named effect explains.
        ordinary: starting from a URDF, which has none: all effects of the written model, which are the sure ones and
            those that ``identify`` finds, fitted together.
        located: variables that explain each channel's first remainder.
        ranking: all candidates, the best first.
        cutoff: of the low-pass in whose band noise and gap are [Hz].
        seconds: duration of the search.
        unjudged: channels that move, but have no held-out sample at which the model can be blamed.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    links: tuple[LinkChange, ...]
    unexplained: tuple[Unexplained, ...]
    ordinary: tuple[KnownEffect, ...]
    located: tuple[ResidualDependence, ...]
    ranking: tuple[Ranked, ...]
    cutoff: float
    seconds: float
    unjudged: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class GapResult(GapSummary):
    """Result of the gap workflow, for C channels.

    Attributes:
        channels, units: names and units of the rows of all per-channel arrays.
        floor: the noise's standard deviation ``(C,)``.
        gap: residuals of the models on held-out data, rest and reversals included; ``after`` is the written model's.
        moving: residual of the written model where joints move one way ``(C,)``, in units of the floor.
        trace: held-out data with predictions.
        bodies, inertias: the identified links, and their parameters ``(bodies, 10)`` in the final model, payloads not
            included (pinocchio's order, about the link's origin).
        coefficients: those of the effects that the model had before, in its order; NaN where it had none or a sure
            finding replaces it.
        beside: the effects that it had in addition to its coefficients, except those that a sure finding replaces.
        folded: change of the attributes of joints (as ``dynamics/damping``) of a URDF and an MJCF from the model's,
            because these cannot represent all friction; by joint and attribute.
        newly_folded: its change from the model before: what a file with a separate fit has not folded yet.
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    floor: FloatArray
    gap: GapErrors
    moving: FloatArray
    trace: Trace
    bodies: tuple[str, ...]
    inertias: FloatArray
    coefficients: FloatArray
    beside: tuple[KnownEffect, ...]
    folded: Mapping[tuple[str, str], float]
    newly_folded: Mapping[tuple[str, str], float]

    @property
    def corrected_floor(self) -> FloatArray:
        """Noise std ``(C,)`` of efforts divided by the gains that were found, as for a user of the written model."""
        return np.asarray(self.floor / effort_gains(self.findings, self.channels))

    @property
    def sure(self) -> tuple[Finding, ...]:
        """Findings that are in the written model."""
        return tuple(finding for finding in self.findings if finding.confidence == "confident")

    @property
    def added(self) -> tuple[KnownEffect, ...]:
        """Effects of the written model that the given one has not, or has otherwise."""
        return self.ordinary or self.sure


def _said(quantity: Quantity) -> str:
    unit = "" if quantity.unit == "-" else f" {quantity.unit}"
    return f"{quantity.value:.4g} ± {STDS_OF_95 * quantity.std:.2g}{unit}"


def effort_gains(findings: Sequence[Finding], channels: Sequence[str]) -> FloatArray:
    """Factors ``(C,)`` from true to measured efforts according to sure findings."""
    gains = dict.fromkeys(channels, 1.0)
    for finding in findings:
        if finding.confidence == "confident" and finding.joint in gains:
            gains[finding.joint] *= finding.cls.effort_scale(finding.values)
    return np.array([gains[channel] for channel in channels])
