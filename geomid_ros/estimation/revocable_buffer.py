"""A buffer of the last instants, from which the rows of channels that turn out bad can be revoked."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Instant:
    """Rows of one instant.

    Attributes:
        number: Its place in the sequence of all instants.
        coefficients, targets: ``(channels, D)`` and ``(channels,)``; a target is NaN where there is no row.
        elapsed: Time since the previous sample [s].
        regimes: ``(channels,)``, see :class:`RowSummary`.
        state: ``(S,)`` of the motion.
    """

    number: int
    coefficients: FloatArray
    targets: FloatArray
    elapsed: float
    regimes: IntArray
    state: FloatArray

    @property
    def rows(self) -> tuple[FloatArray, FloatArray, float, IntArray, FloatArray]:
        """What :meth:`RowSummary.add` takes of several."""
        return self.coefficients, self.targets, self.elapsed, self.regimes, self.state


@dataclass(frozen=True)
class _LeftOut:
    """Channels whose rows are not used, from one instant on and before another."""

    reason: str
    channels: tuple[int, ...]
    begin: int
    end: float = np.inf


class RevocableBuffer:
    """A queue of instants. Which of their rows are left out can change until they leave it."""

    def __init__(self) -> None:
        self.rows = 0
        """Number of rows that are not left out."""
        self.rejected: Counter[str] = Counter()
        """Number of rows that are left out, by reason."""
        self._instants: deque[Instant] = deque()
        self._left_out: tuple[_LeftOut, ...] = ()

    @property
    def first(self) -> float:
        """The number of the first instant; infinite if there is none."""
        return self._instants[0].number if self._instants else np.inf

    @property
    def instants(self) -> list[Instant]:
        """All instants, with the targets that are used now."""
        return [self._judged(instant)[0] for instant in self._instants]

    @property
    def idle(self) -> bool:
        """Whether there is no instant, and nothing of those to come will be left out."""
        return not self._instants and not self._left_out

    def append(self, instant: Instant) -> None:
        """Add the next instant."""
        self._instants.append(instant)
        self._count(*self._judged(instant))

    def pop(self) -> tuple[Instant, Counter[str]]:
        """Remove the first instant, with the targets that are used now, and how many are not, by reason."""
        instant, rejected = self._judged(self._instants.popleft())
        self.rows -= _rows(instant)
        self.rejected -= rejected
        self._left_out = tuple(left for left in self._left_out if left.end > instant.number)
        return instant, rejected

    def leave_out(self, reason: str, channels: Sequence[int], begin: int) -> bool:
        """Leave out the rows of ``channels`` from the instant of this number on, and those to come.

        False if they were left out, for this reason, before."""
        same = [left for left in self._left_out if left.reason == reason and left.end == np.inf]
        others = [left for left in self._left_out if left not in same]
        begin = min([begin, *(left.begin for left in same)])
        return self._change([*others, _LeftOut(reason, tuple(channels), begin)])

    def take_again(self, reason: str, begin: int) -> bool:
        """Use what is left out for this reason, from the instant of this number on; False if there is nothing."""
        same = [left for left in self._left_out if left.reason == reason and left.end == np.inf]
        return self._change([replace(left, end=begin) if left in same else left for left in self._left_out])

    def _change(self, left_out: Sequence[_LeftOut]) -> bool:
        before, self._left_out = self._left_out, tuple(left_out)
        if self._left_out == before:
            return False
        self.rows, self.rejected = 0, Counter()
        for instant in self._instants:
            self._count(*self._judged(instant))
        return True

    def _count(self, instant: Instant, rejected: Counter[str]) -> None:
        self.rows += _rows(instant)
        self.rejected += rejected

    def _judged(self, instant: Instant) -> tuple[Instant, Counter[str]]:
        """The instant without the rows that are left out, and how many these are by reason."""
        rejected: Counter[str] = Counter()
        if not self._left_out:
            return instant, rejected
        targets = instant.targets.copy()
        for left in self._left_out:
            if left.begin <= instant.number < left.end:
                channels = list(left.channels)
                rejected[left.reason] += int(np.count_nonzero(np.isfinite(targets[channels])))
                targets[channels] = np.nan
        return replace(instant, targets=targets), rejected


def _rows(instant: Instant) -> int:
    return int(np.count_nonzero(np.isfinite(instant.targets)))
