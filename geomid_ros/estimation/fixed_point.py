"""Faster fixed-point iterations ``x <- g(x)``: Anderson's extrapolation (Walker & Ni, SIAM J. Numer. Anal., 2011)."""

from __future__ import annotations

from collections import deque

import numpy as np

from geomid_ros.types import FloatArray

_REMEMBERED = 6  # last rounds
_ROUNDING = 1e-8  # of the least squares
_FURTHEST = 30.0  # times the last round's move; g is not as linear as that


class Extrapolation:
    """Where the next round begins: at the combination of the last rounds that, if g were linear, would move least."""

    def __init__(self) -> None:
        self._rounds: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=_REMEMBERED)

    def next(self, begun: FloatArray, ended: FloatArray) -> FloatArray:
        """The next x ``(n,)`` after a round that began at x and ended at g(x)."""
        self._rounds.append((ended, ended - begun))
        ends, moves = (np.array(each).T for each in zip(*self._rounds, strict=True))
        shares, *_ = np.linalg.lstsq(np.diff(moves), moves[:, -1], rcond=_ROUNDING)
        further = np.diff(ends) @ shares
        if not np.max(np.abs(further)) <= _FURTHEST * np.max(np.abs(ended - begun)):
            self._rounds.clear()
            return ended
        return np.asarray(ended - further)
