"""Designs of one link and two channels from random columns: fits that take milliseconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from geomid_ros.gap.candidates import AnyCandidate, Candidate, CurveCandidate, CurveTerm, EffectTerm, Term
from geomid_ros.gap.evidence.design import Design
from geomid_ros.gap.evidence.noise import Autoregression
from geomid_ros.gap.fitting.prior import Prior
from geomid_ros.model.effects import EFFECTS, AtJoint, Effect, OnLink
from geomid_ros.model.effects.payload import Payload
from geomid_ros.types import FloatArray

ROWS, CHANNELS = 400, 2
NOISE = 0.1
LINK = np.array([2.0, 0.2, 0.0, -0.1, 0.3, 0.0, 0.3, 0.0, 0.0, 0.3])
"""Parameters of the link's body."""
PRIOR = Prior(inertias=LINK, spread=0.2, terms=(), values=np.zeros(0), spreads=np.zeros(0), certainty=4.0)


def at(effect: Effect | str, joint: int, penalty: float | None = None, scout: bool = True) -> Candidate:
    """An effect at a joint."""
    effect = EFFECTS[effect]() if isinstance(effect, str) else effect
    terms = tuple(EffectTerm(part, AtJoint(joint)) for part in effect.parts)
    return Candidate(effect, AtJoint(joint), terms, len(terms) if penalty is None else penalty, scout)


def curve(joint: int, variable: str, name: str, count: int = 1) -> CurveCandidate:
    """A free curve at a joint."""
    return CurveCandidate(variable, name, joint, tuple(CurveTerm(joint, name, k) for k in range(count)), count + 1.0)


PAYLOAD = Candidate(Payload(), OnLink(0, 0), (), 4.0)


class Recording:
    """Random columns, one for each term, each at its own channel; and what is measured.

    ``alike``: of a term whose column is another's but for a tenth of noise.
    """

    def __init__(self, seed: int, candidates: Sequence[AnyCandidate], alike: Mapping[Term, Term] | None = None) -> None:
        self._rng = np.random.default_rng(seed)
        self.coefficients = self._rng.normal(size=(ROWS, CHANNELS, len(LINK)))
        terms = dict.fromkeys(term for candidate in candidates for term in candidate.terms)
        self.columns = {term: self._rng.normal(size=ROWS) for term in terms}
        for term, other in (alike or {}).items():
            self.columns[term] = self.columns[other] + 0.1 * self._rng.normal(size=ROWS)

    def channel(self, term: Term) -> int:
        """The channel that a term reaches."""
        return term.joint if isinstance(term, CurveTerm) else term.place.joint  # type: ignore[union-attr]

    def targets(self, planted: Mapping[Term, float], link: FloatArray = LINK, noise: float = NOISE) -> FloatArray:
        """What is measured of a robot with these coefficients."""
        targets = self.coefficients @ link + noise * self._rng.normal(size=(ROWS, CHANNELS))
        for term, value in planted.items():
            targets[:, self.channel(term)] += value * self.columns[term]
        return np.asarray(targets)

    def design(self, planted: Mapping[Term, float], link: FloatArray = LINK, noise: float = NOISE) -> Design:
        """Of a robot with these coefficients."""
        return self.design_of(self.targets(planted, link, noise))

    def design_of(self, targets: FloatArray) -> Design:
        """Of what is measured."""
        columns = {term: {self.channel(term): column} for term, column in self.columns.items()}
        records: Any = SimpleNamespace(segment=np.zeros(ROWS, dtype=np.int64))
        white = (Autoregression.white(),) * CHANNELS
        return Design.make(self.coefficients, targets, np.ones((ROWS, CHANNELS), dtype=bool), columns, white, records)
