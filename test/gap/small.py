"""Designs of one link and two channels from random columns: fits that take milliseconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.design import ChannelRows, Design
from geomid_ros.inference.prior import Prior
from geomid_ros.model.effects import EFFECTS, AtJoint, Effect, OnLink
from geomid_ros.model.effects.mounting import CarriedBody
from geomid_ros.types import FloatArray

ROWS, CHANNELS = 400, 2
NOISE = 0.1
LINK = np.array([2.0, 0.2, 0.0, -0.1, 0.3, 0.0, 0.3, 0.0, 0.0, 0.3])
"""Parameters of the link's body."""
PRIOR = Prior(inertias=LINK, prior_std=0.2, terms=(), values=np.zeros(0), prior_stds=np.zeros(0), certainty=4.0)


def at(effect: Effect | str, joint: int, odds: float = 0.01) -> Candidate:
    """An effect at a joint."""
    effect = EFFECTS[effect]() if isinstance(effect, str) else effect
    terms = tuple(EffectTerm(part, AtJoint(joint)) for part in effect.parts)
    return Candidate(effect, AtJoint(joint), terms, odds=odds)


PAYLOAD = Candidate(CarriedBody(), OnLink(0, 0), ())


class Recording:
    """Random columns, one for each term, each at its own channel; and what is measured.

    ``alike``: of a term whose column is another's but for a tenth of noise. ``features``, by ``block``: of the
    remainder of both channels, none by default.
    """

    def __init__(
        self, seed: int, candidates: Sequence[Candidate], alike: Mapping[EffectTerm, EffectTerm] | None = None
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self.coefficients = self._rng.normal(size=(ROWS, CHANNELS, len(LINK)))
        terms = dict.fromkeys(term for candidate in candidates for term in candidate.terms)
        self.columns = {term: self._rng.normal(size=ROWS) for term in terms}
        self.features, self.block = np.zeros((ROWS, 0)), np.zeros(0, dtype=np.intp)
        for term, other in (alike or {}).items():
            self.columns[term] = self.columns[other] + 0.1 * self._rng.normal(size=ROWS)

    def channel(self, term: EffectTerm) -> int:
        """The channel that a term reaches."""
        return term.joints[0]

    def targets(self, planted: Mapping[EffectTerm, float], link: FloatArray = LINK, noise: float = NOISE) -> FloatArray:
        """What is measured of a robot with these coefficients."""
        targets = self.coefficients @ link + noise * self._rng.normal(size=(ROWS, CHANNELS))
        for term, value in planted.items():
            targets[:, self.channel(term)] += value * self.columns[term]
        return np.asarray(targets)

    def design(self, planted: Mapping[EffectTerm, float], link: FloatArray = LINK, noise: float = NOISE) -> Design:
        """Of a robot with these coefficients."""
        return self.design_of(self.targets(planted, link, noise))

    def design_of(self, targets: FloatArray) -> Design:
        """Of what is measured."""
        channels = []
        for channel in range(CHANNELS):
            terms = [term for term in self.columns if self.channel(term) == channel]
            own = [self.columns[term] for term in terms]
            rows = np.column_stack([self.coefficients[:, channel], *own, targets[:, channel]])
            place = {term: len(LINK) + index for index, term in enumerate(terms)}
            channels.append(ChannelRows(rows, self.features, self.block, place, np.arange(len(LINK))))
        return Design.of(channels, len(LINK))
