"""Whether efforts belong to the motion that they are recorded with, or to that of a little earlier or later.

To first order a lag adds the derivative of the efforts, times the lag. What the links take tells it: friction turns
about at once, and what is left unexplained there looks like a lag. So it is fitted beside the curves of friction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.changes import hypothesis
from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.flexible import FlexibleFit, by_channel
from geomid_ros.checks.hypotheses import Hypothesis
from geomid_ros.checks.instants import FEWEST, STEP
from geomid_ros.checks.subject import Subject
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_PAIRS = 200
_USUAL = 0.1  # [s] a lag that is tried
_LEAST, _MOST = 0.03, 0.3  # [s] less hardly matters behind the filter; where more fits, it is no lag
_COMMON = 0.8  # of what lags of their own explain: then they have one in common
_TOLD = 0.9  # what is left of a channel whose lag can be told, over what is left without


@dataclass(frozen=True, eq=False)
class Pairs:
    """Instants, and as many a little later."""

    now: Samples
    later: Samples

    @staticmethod
    def of(dense: Samples) -> Pairs | None:
        """At most 200 pairs among all instants of a stretch; None if they are too few."""
        first = np.flatnonzero(np.diff(dense.stamps) < 2 * STEP)
        if len(first) < FEWEST:
            return None
        first = first[:: -(-len(first) // _PAIRS)]
        return Pairs(dense.select(first), dense.select(first + 1))


class Lags:
    """Looks for efforts that come late or early."""

    def __init__(self, subject: Subject, pairs: Pairs) -> None:
        """
        Args:
            subject: what is judged.
            pairs: instants of a stretch of it.
        """
        self._subject, self._pairs = subject, pairs
        self._names = subject.names
        self._world = subject.world(pairs.now)
        self._fit = FlexibleFit(self._world, pairs.now, subject.joints)

    def hypotheses(self, nominal: Evidence) -> Iterator[Hypothesis]:
        """Lags, as far as they explain anything; ``nominal`` is the evidence of none."""
        instants = len(self._subject.samples)
        count = len(self._names)
        rates = -_USUAL * self._rates()
        common = gain = self._fit.gain(rates[:, :, None])
        lag = _USUAL * float(gain.coefficients[0])
        if _LEAST < abs(lag) < _MOST:
            cause = words.all_late(self._names, lag)
            yield hypothesis(cause, [*range(count)], gain, nominal, instants, 1)
        if count == 1:
            return
        alone = by_channel(rates[:, :, None])
        gain = self._fit.gain(alone)
        if common.per_instant > _COMMON * gain.per_instant:
            return
        lags = _USUAL * gain.coefficients
        told = gain.ratios < _TOLD
        if np.any(told & (np.abs(lags) >= _MOST)):  # what fits there is no lag, so it may be none elsewhere
            return
        main = [*np.flatnonzero(told & (np.abs(lags) > _LEAST))]
        if len(main) == 1:
            gain = self._fit.gain(alone[:, :, main])
        if main:
            cause = words.some_late([self._names[c] for c in main], lags[main])
            yield hypothesis(cause, main, gain, nominal, instants, count)

    def _rates(self) -> FloatArray:
        """By how much the efforts of the fitted links change ``(N, C)`` [N m/s]."""
        links = self._subject.prior + self._subject.factor @ self._world.links(self._fit.links)
        later = self._subject.regressor(self._pairs.later) @ links
        times = (self._pairs.later.stamps - self._pairs.now.stamps) * 1e-9
        return np.asarray((later - self._fit.rigid) / times[:, None])
