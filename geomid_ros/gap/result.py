"""What the gap workflow found, with all that its tables, pictures and files need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from geomid_ros.model.effects import KnownEffect, Quantity, Values, effect_class, values_of
from geomid_ros.types import FloatArray, IntArray

Confidence: TypeAlias = Literal["confident", "tentative", "ambiguous"]
Verdict: TypeAlias = Literal["no gap", "named", "incomplete", "unexplained"]


SURE, LIKELY = 0.95, 0.5
"""The least probabilities of a name that is sure, and of one that is tentative; a less likely one has rivals that
make up for it, see :attr:`Finding.is_likely`."""


def confidence_of(probability: float) -> Confidence:
    """A probability in a word."""
    return "confident" if probability > SURE else "tentative" if probability >= LIKELY else "ambiguous"


@dataclass(frozen=True)
class Rival:
    """Another name for the same remainder; ``loss`` is by how much its score is worse (differences of -2 log p)."""

    effect: str
    joint: str
    loss: float


@dataclass(frozen=True, kw_only=True)
class Finding(KnownEffect):
    """A named effect.

    Attributes:
        probability: of the name, beside nothing and its rivals.
        rivals: other names for the same remainder.
        separability: share of the effect's columns, 0 to 1, outside the span of the inertias and the other findings for
            this motion.
        loss: how much worse the score is without it.
        share: of the gap that it closes.
        was: the parameters before, if the model had the effect: it has changed.
        sentence: all this in words.
        settled_by: the recording that would settle an ambiguity, empty when there is none.
        moment: of a payload whose mass the motion does not tell, mass times centre of mass; empty of all others.
    """

    probability: float
    rivals: tuple[Rival, ...]
    separability: float
    loss: float
    share: float
    was: Values
    sentence: str
    settled_by: str
    moment: Mapping[str, Quantity] = field(default_factory=dict)

    @property
    def confidence(self) -> Confidence:
        """The probability in a word."""
        return confidence_of(self.probability)

    @property
    def is_likely(self) -> bool:
        """Whether it, or one of its rivals, is there rather than nothing."""
        weights = np.exp(-0.5 * np.array([0.0, *(rival.loss for rival in self.rivals)]))
        return bool(self.probability * np.sum(weights) >= LIKELY)


@dataclass(frozen=True)
class LinkChange:
    """A link that is another than the model says.

    Attributes:
        link: its name.
        joint: the joint that moves it.
        mass: by how much its mass is larger [kg].
        was: the mass that the model says [kg].
        loss: how much worse the score is if it has the model's inertia.
        probability: that it has changed.
        moment: of a link whose mass may be as it was, by how much its first moment is larger [kg m], about its frame's
            origin, by axis; empty of all others.
        centre: beside a model of recordings, where that mass is in the link's frame [m], by axis.
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
        """The probability in a word."""
        return confidence_of(self.probability)

    @property
    def told(self) -> float:
        """The square of its deviations from nothing: of the mass, or of what else has changed."""
        sizes = self.moment.values() or (self.mass,)
        return max(((q.value / q.std) ** 2 for q in sizes if q.std > 0.0), default=float("inf"))

    @property
    def sentence(self) -> str:
        """In words, with the 95 % interval."""
        if self.moment:
            changes = (f"{axis} by {q.value:.3g} ± {q.std:.2g} {q.unit}" for axis, q in self.moment.items())
            by_mass = f"{self.mass.value:.2g} ± {self.mass.std:.2g} kg"
            return f"link '{self.link}' has changed: first moment {', '.join(changes)} (mass by {by_mass})"
        less = "less" if self.mass.value < 0.0 else "more"
        size = f"{abs(self.mass.value):.3g} ± {self.mass.std:.2g} kg"
        said = f"link '{self.link}' weighs {size} {less} than the {self.was:.3g} kg of the model"
        centre = ", ".join(f"{axis} {q.value:.3g} ± {q.std:.2g}" for axis, q in self.centre.items())
        return f"{said}; the difference is centred at {centre} m" if centre else said


@dataclass(frozen=True)
class Unexplained:
    """A joint or wrench channel whose remainder no name explains: ``gap`` times the floor, and on what it depends
    (``position``, ``velocity``, ``load``, ``time``, ``reversals``, ``unknown``, or the name of another joint)."""

    joint: str
    depends_on: str
    gap: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Trace:
    """Held-out data, and what the models predict of them.

    Attributes:
        stamps: ``(N,)`` [ns].
        position, velocity: of the joints ``(N, J)``.
        load: magnitude of what the final model predicts ``(N, C)``.
        measured: ``(N, C)``, NaN where not measured.
        before, inertias_only, after: what the three models predict ``(N, C)``.
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
    """The whole finding, of C channels.

    Attributes:
        verdict: in a word or two.
        findings: the named effects, the one that matters most first.
        links: those that weigh something else than the model says, without payloads.
        unexplained: what no name explains.
        unjudged: channels that move, but at no held-out instant at which the model can be blamed for what is left.
        channels, units: names and units of the rows of all per-channel arrays.
        floor: the noise's standard deviation ``(C,)``.
        cutoff: of the low-pass in whose band noise and gap are [Hz].
        gap: what the models leave of held-out data, rest and reversals included; ``after`` is the written model's.
        moving: what the written model leaves where joints move one way ``(C,)``, in units of the floor.
        located: where each channel's first remainder lives.
        ranking: all candidates, the best first.
        trace: held-out data with predictions.
        bodies, inertias: the identified links, and their parameters ``(bodies, 10)`` in the final model, payloads not
            included (pinocchio's order, about the link's origin).
        coefficients: those of the effects that the model had before, in its order; NaN where it had none or a sure
            finding's parameter is the whole.
        beside: the effects that it had beside its coefficients, without those of which a sure finding says the whole.
        ordinary: beside a URDF alone, friction, rotor inertia and offsets of all joints that no sure finding says, as
            ``identify`` finds them: a URDF says nothing of them.
        folded: by how much the attributes of joints (as ``dynamics/damping``) of a URDF and an MJCF differ from the
            model's, as these cannot say all friction; by joint and attribute.
        newly_folded: the same beyond what the model before had: what a file with a fit of its own has not folded yet.
        seconds: that the search took.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    links: tuple[LinkChange, ...]
    unexplained: tuple[Unexplained, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    floor: FloatArray
    cutoff: float
    gap: GapErrors
    moving: FloatArray
    located: tuple[Located, ...]
    ranking: tuple[Ranked, ...]
    trace: Trace
    bodies: tuple[str, ...]
    inertias: FloatArray
    coefficients: FloatArray
    beside: tuple[KnownEffect, ...]
    ordinary: tuple[KnownEffect, ...]
    folded: Mapping[tuple[str, str], float]
    newly_folded: Mapping[tuple[str, str], float]
    seconds: float
    unjudged: tuple[str, ...] = ()

    @property
    def corrected_floor(self) -> FloatArray:
        """The noise's standard deviation ``(C,)`` where efforts are divided by the gains that were found, as whoever
        reads the written model does."""
        return np.asarray(self.floor / effort_gains(self.findings, self.channels))

    @property
    def sure(self) -> tuple[Finding, ...]:
        """The findings that are in the written model."""
        return _sure(self.findings)


def effort_gains(findings: Sequence[Finding], channels: Sequence[str]) -> FloatArray:
    """Factors ``(C,)`` from true efforts to measured ones that sure findings say."""
    gains = dict.fromkeys(channels, 1.0)
    for finding in _sure(findings):
        if finding.joint in gains:
            gains[finding.joint] *= effect_class(finding.effect).effort_scale(values_of(finding))
    return np.array([gains[channel] for channel in channels])


def _sure(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    return tuple(finding for finding in findings if finding.confidence == "confident")
