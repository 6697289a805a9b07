"""Which feet stand: told by what their legs bear, for a while before and after."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray, FloatArray, IntArray

LIFTED = 0.1
"""A foot in the air seems to bear less, as a share of what each bears when all stand: inertias are not known yet."""


class Stance:
    """Says of samples which feet may touch the ground. A foot is in the air while, from a while before to a while
    after, its leg bears next to nothing: samples are held until that is known."""

    def __init__(self, loads: Callable[[Samples], FloatArray], cutoff: float) -> None:
        """
        Args:
            loads: shares ``(N, feet)`` of the weight that the feet seem to bear, see
                :meth:`~geomid_ros.model.contacts.Legs.loads`.
            cutoff: of the low-pass on all signals [Hz].
        """
        self._loads = loads
        self._span = round(1e9 / cutoff)  # the low-pass smears a change over so much to both sides
        self._held: Samples | None = None
        self._before = 0  # of the samples that are held, so many are known already, and serve those after them
        self._borne = np.zeros((0, 0))  # by the feet at the samples that are held

    def known(self, new: Samples) -> Samples | None:
        """Take samples in the order of time, and return those of which is known which feet stand."""
        parts = [found for part in _in_order(new) if (found := self._take(part)) is not None]
        return Samples.concatenate(parts) if parts else None

    def _take(self, new: Samples) -> Samples | None:
        borne = self._loads(new)
        if self._held is not None and new.stamps[0] > self._held.stamps[-1]:
            new = Samples.concatenate([self._held, new])
            borne = np.concatenate([self._borne, borne])
        else:
            self._before = 0
        stamps, begin = new.stamps, self._before
        end = int(np.searchsorted(stamps, stamps[-1] - self._span, side="right"))
        oldest = int(np.searchsorted(stamps, stamps[end] - self._span))
        kept = slice(min(oldest, end), None)
        self._held, self._borne, self._before = new.select(kept), borne[kept], max(end, begin) - kept.start
        if end <= begin:
            return None
        standing = _within(stamps, ~(borne < LIFTED), self._span)[begin:end]
        return replace(new.select(slice(begin, end)), standing=standing)


def _within(stamps: IntArray, true: BoolArray, span: int) -> BoolArray:
    """Whether anything is ``true (N, feet)`` at most ``span`` before or after each of ``stamps (N,)``."""
    first, last = np.searchsorted(stamps, stamps - span), np.searchsorted(stamps, stamps + span, side="right")
    count = np.concatenate([np.zeros((1, true.shape[1]), dtype=np.int64), np.cumsum(true, axis=0)])
    return np.asarray(count[last] > count[first])


def _in_order(samples: Samples) -> list[Samples]:
    """The parts between which the clock was set back."""
    ends = np.flatnonzero(np.diff(samples.stamps) <= 0) + 1
    bounds = [0, *ends.tolist(), len(samples)]
    return [samples.select(slice(*bounds[k : k + 2])) for k in range(len(bounds) - 1)]
