"""Analyses that nobody made: scores and remainders as a test says, for the rules of judgement alone.

The robot is the arm of :mod:`planted` with three channels, its joints' efforts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import AnyCandidate, Candidate, CurveCandidate, CurveTerm
from geomid_ros.gap.judgement.confidence import Evidence
from geomid_ros.gap.result import Confidence, Rival
from geomid_ros.model.effects import Quantity
from geomid_ros.types import FloatArray

from . import planted

MODEL = planted.model()
JOINTS = MODEL.robot.joint_names
CANDIDATES = library.candidates(MODEL)
GUESSED, IDENTIFIED = 20.0, 100.0  # how certain the inertias are


def named(effect: str, joint: int | None = 1) -> Candidate:
    """A candidate, the first one of its constants."""
    return next(c for c in CANDIDATES if c.name == effect and c.joint == joint)


PAYLOAD = next(c for c in CANDIDATES if c.payload == len(MODEL.identified) - 1)


def curve(joint: int, variable: str = "position") -> CurveCandidate:
    """A free curve at a joint."""
    return CurveCandidate(variable, "made up", joint, (CurveTerm(joint, "made up", 0),), 2.0)


@dataclass(eq=False)
class Fit:
    """A fit: its score, and what it leaves of three channels, each of a floor of one; and of ``unseen`` data."""

    score: float
    squares: FloatArray
    chosen: tuple[AnyCandidate, ...] = ()
    unseen: Sequence[float] = ()


@dataclass(kw_only=True)
class Judged:
    """What is said of a ``name`` at the second joint, on which everything depends unless a test says otherwise.

    ``loss``: how much worse the score is without it; ``losses``: without each of the ``others``; ``instead``: with a
    curve in its place. ``without``, ``bare``: sums of squares of each channel without the name and without any,
    those of the whole being 1. ``after``, ``expected``, ``unnamed``: remainders of ``counts`` unseen instants with all
    names, as they should be, and without the name; ``with_curves``: with free curves, too, those of ``after`` unless
    given. ``reached``: the channels that it can change. ``outdoing``: remainders of unseen data with each of some names
    in its place, with which the score is worse by ``outdoing_loss``.
    """

    name: Candidate = field(default_factory=lambda: named("viscous_friction"))
    loss: float = 1000.0
    others: Sequence[AnyCandidate] = ()
    losses: Mapping[AnyCandidate, float] = field(default_factory=dict)
    instead: float | None = None
    rivals: Sequence[Rival] = ()
    without: Sequence[float] = (1.0, 4.0, 1.0)
    bare: Sequence[float] = (1.0, 4.0, 1.0)
    after: Sequence[float] = (1.0, 1.0, 1.0)
    with_curves: Sequence[float] | None = None
    expected: Sequence[float] = (1.0, 1.0, 1.0)
    unnamed: Sequence[float] = (1.0, 3.0, 1.0)
    counts: Sequence[float] = (1e4, 1e4, 1e4)
    reached: Sequence[int] = (1,)
    certainty: float = GUESSED
    outdoing: Mapping[Candidate, Sequence[float]] = field(default_factory=dict)
    outdoing_loss: float = 0.0

    @property
    def analysis(self) -> Any:
        """As :class:`geomid_ros.gap.search.analysis.Analysis`."""
        whole = Fit(0.0, np.ones(3), (self.name, *self.others))

        def without(found: Fit, candidate: AnyCandidate) -> Fit:
            rest = tuple(c for c in found.chosen if c is not candidate)
            if candidate is self.name:
                return Fit(self.loss, np.array(self.without), rest)
            return Fit(self.losses.get(candidate, self.loss), np.ones(3), rest)

        def instead(found: Fit, _: AnyCandidate) -> Fit | None:
            return None if self.instead is None else Fit(self.instead, np.ones(3), (*found.chosen, curve(1, "instead")))

        search = SimpleNamespace(
            design=SimpleNamespace(reached=lambda _: list(self.reached)),
            prior=SimpleNamespace(certainty=self.certainty, terms=(), link_spreads=np.array([0.2])),
            without=without,
            instead=instead,
            rivals=lambda *_: [
                Fit(self.outdoing_loss, np.ones(3), (other,), unseen) for other, unseen in self.outdoing.items()
            ],
        )
        search.unchanged = lambda _: search
        bare = Fit(0.0, np.array(self.bare))
        return SimpleNamespace(search=search, whole=whole, names=whole, bare=bare)

    @property
    def unseen(self) -> Any:
        """As :class:`geomid_ros.gap.judgement.held_out.HeldOut`."""
        gap = SimpleNamespace(after=np.array(self.after), expected=np.array(self.expected))
        return SimpleNamespace(
            counts=np.array(self.counts),
            gap=gap,
            with_curves=np.array(self.after if self.with_curves is None else self.with_curves),
            times_floor=lambda found: np.array(found.unseen or self.unnamed, dtype=float),
        )

    @property
    def evidence(self) -> Evidence:
        """For the name."""
        return Evidence(
            model=MODEL,
            analysis=self.analysis,
            unseen=self.unseen,
            candidate=self.name,
            rivals=self.rivals,
            loss=self.loss,
        )

    def confidence(self, mass: float = 1.0, std: float = 0.01) -> Confidence:
        """How sure the name is; of a payload with this mass."""
        return self.evidence.confidence({"mass": Quantity(mass, std, "kg")})
