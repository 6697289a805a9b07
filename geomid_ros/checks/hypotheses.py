"""What may be wrong with a recording as a whole, and the rules by which one cause is named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geomid_ros.checks.evidence import Evidence
from geomid_ros.types import IntArray

KINDS = {
    "sign": "efforts are reversed",
    "order": "efforts of two joints are swapped",
    "names": "names of joints are swapped",
    "gain": "efforts are in another unit",
    "magnitude": "efforts have no sign",
    "friction": "more friction is compensated than there is",
    "zero": "the zero of a joint is off",
    "axis": "a joint turns in the opposite direction",
    "absolute": "the position of a joint includes that of another one",
    "description": "the robot description cannot be that of this robot",
    "frozen": "the position of a joint is frozen while the joint moves",
    "degrees": "positions are in degrees",
    "gravity": "gravity acts in another direction",
    "compensated": "gravity is not in the efforts",
    "offset": "the offset of an effort changes during the recording",
    "drift": "the gain of efforts changes during the recording",
    "switched": "gravity is in the efforts only part of the time",
    "load": "the payload changes during the recording",
    "slip": "the zero of a position changes during the recording",
    "late": "efforts are delayed against the motion",
    "unrelated": "efforts follow neither gravity nor motion",
    "unexplained": "the efforts of a joint are not explained by this robot",
    "constant": "an effort never changes",
    "stream": "messages are not as a driver should send them",
    "still": "the robot does not move",
    "wrench": "a wrench sensor is declared wrongly",
}
"""What may be wrong."""

FOLLOWS = 0.85
"""A channel follows the model if no more than this share of its standard deviation is left."""
_MOST_LEFT = {"sign": FOLLOWS, "order": FOLLOWS, "names": 0.7}  # wrists are alike: of them all would fit a little
_BETTER = 0.75
_SCATTER = 0.15  # of the log of a standard deviation over some 50 independent instants, one and a half standard errors
_MISFIT = 0.1  # of the gain: a cause that is true explains no channel worse
_GAIN = 0.25  # nats per instant
GAIN_OF_ORDER = 0.4
"""The least gain where joints are exchanged or counted otherwise [nats per instant]: there are many ways, and wrists
are alike."""
_OF_MANY = ("order", "names", "zero", "axis", "absolute")
_OVERWHELMING = 0.5  # nats per instant: then it may be the links alone that become much more probable
_LEAST = 10.0  # nats in all
_RIVAL = 0.1  # nats per instant


@dataclass(frozen=True, kw_only=True)
class Cause:
    """What a recording seems to be.

    Attributes:
        kind: one of :data:`KINDS`.
        sentence: what is wrong, and what to do.
        settings: the parameters that mend it, by full name; empty if none does.
        places: the joints, or the topic, that it is about.
    """

    kind: str
    sentence: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    places: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is wrong with a recording.

    Attributes:
        cause: what explains it best.
        sure: whether the cause is named; otherwise it is suspected.
        rivals: other causes that explain it as well.
    """

    cause: Cause
    sure: bool = True
    rivals: tuple[Cause, ...] = ()

    @property
    def sentence(self) -> str:
        """All of it."""
        if not self.sure:
            return f"Possibly: {self.cause.sentence}"
        others = "; or: ".join(rival.sentence for rival in self.rivals)
        return f"{self.cause.sentence}; or: {others}" if others else self.cause.sentence


@dataclass(frozen=True, eq=False, kw_only=True)
class Hypothesis:
    """A cause that was tried.

    Attributes:
        cause: what it says.
        evidence: of the recording if it is so.
        choices: among how many of its kind it was chosen.
        sources: ``(C,)`` which measured channel each judged one is.
        concerned: the channels that it changes.
        allowed: whether what is known beside the evidence allows it.
        alone: whether it may be named by itself, or only beside another cause.
        settled: whether what is known beside the evidence settles it.
    """

    cause: Cause
    evidence: Evidence
    choices: int
    sources: IntArray
    concerned: Sequence[int]
    allowed: bool = True
    alone: bool = True
    settled: bool = False

    @property
    def score(self) -> float:
        """The log evidence, less what the choice among many costs."""
        return self.evidence.log - float(np.log(self.choices))

    def gain(self, nominal: Evidence, instants: int) -> float:
        """What it gains per instant [nats]."""
        return (self.score - nominal.log) / instants

    def is_better(self, nominal: Evidence, instants: int) -> bool:
        """Whether the evidence asks for it."""
        least = GAIN_OF_ORDER if self.cause.kind in _OF_MANY else _GAIN
        gain = self.gain(nominal, instants)
        return gain > least and gain * instants > _LEAST

    def is_consistent(self, nominal: Evidence, instants: int) -> bool:
        """Whether what it explains worse than it is, of the channels concerned, is little beside what it gains.

        What has lost its sign is smoother than what it should be, and compared with nothing.
        """
        if self.cause.kind == "magnitude":
            return True
        concerned = list(self.concerned)
        worse = np.log(self.evidence.sigmas[concerned] / nominal.sigmas[self.sources][concerned])
        return float(np.sum(worse[worse > _SCATTER])) < _MISFIT * self.gain(nominal, instants)

    def explains(self, nominal: Evidence, instants: int) -> bool:
        """Whether the channels concerned follow the model then, and one of them much better than as it is.

        A channel is compared with itself as it was measured: noise that is given to a joint which explains nothing
        anyway explains nothing.
        """
        concerned = list(self.concerned)
        after = self.evidence.sigmas[concerned]
        before = nominal.sigmas[self.sources][concerned]
        if self.cause.kind in _MOST_LEFT and np.any(after > _MOST_LEFT[self.cause.kind]):
            return False
        if self.cause.kind == "gain":  # of which the friction that is fitted as it is explains as much
            return bool(np.any(after < FOLLOWS))
        return bool(np.any(after < _BETTER * before)) or self.gain(nominal, instants) > _OVERWHELMING

    def is_named(self, nominal: Evidence, instants: int) -> bool:
        """Whether all speaks for it."""
        if not self.allowed:
            return False
        if self.settled:
            return True
        asked_for = self.is_better(nominal, instants) and self.is_consistent(nominal, instants)
        return asked_for and self.explains(nominal, instants)


def decide(tried: Sequence[Hypothesis], nominal: Evidence, instants: int) -> Finding | None:
    """What is wrong: the best hypothesis if all speaks for it, told as suspected if only the evidence does."""
    aside = [h.score for h in tried if not h.alone and h.is_named(nominal, instants)]
    least = max(aside, default=-np.inf) - _RIVAL * instants  # what explains less is explained by what is not named
    ordered = sorted((h for h in tried if h.settled or h.score > least), key=lambda hypothesis: -hypothesis.score)
    named = [hypothesis for hypothesis in ordered if hypothesis.is_named(nominal, instants)]
    better = [h for h in ordered if h.allowed and h.alone and h.is_better(nominal, instants)]
    misfits = [h for h in better if not h.is_consistent(nominal, instants)]
    better = [h for h in better if h not in misfits and not any(_contradicts(o, h) for o in misfits)]
    best = next((h for h in named if h in better and not any(_contradicts(o, h) for o in better)), None)
    if best is None and not any(
        h.allowed and h.alone and h.cause.kind != "gain" and h.gain(nominal, instants) > _RIVAL for h in tried
    ):
        best = next((h for h in named if h.settled), None)
    if best is None:
        return Finding(cause=better[0].cause, sure=False) if better else None
    near = best.score - _RIVAL * instants
    rivals = {(h.cause.kind, h.cause.places): h.cause for h in reversed(named) if h.score > near}
    rivals.pop((best.cause.kind, best.cause.places))
    return Finding(cause=best.cause, rivals=tuple(rivals.values()))


def _contradicts(other: Hypothesis, best: Hypothesis) -> bool:
    """Whether a better one, which is not named, is about the same channels."""
    return other.score > best.score and not set(best.concerned).isdisjoint(other.concerned)
