"""Buffer of the last samples, from which rows of channels that turn out bad can be revoked."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class BufferedSample:
    """Rows of one sample.

    Attributes:
        number: Its number in the sequence of all samples.
        coefficients, targets: ``(channels, D)`` and ``(channels,)``; a target is NaN where there is no row.
        elapsed: Time since the previous sample [s].
        regimes: ``(channels,)``, see :mod:`geomid_ros.estimation.summary`.
        state: State of the motion ``(S,)``.
    """

    number: int
    coefficients: FloatArray
    targets: FloatArray
    elapsed: float
    regimes: IntArray
    state: FloatArray

    @property
    def rows(self) -> tuple[FloatArray, FloatArray, float, IntArray, FloatArray]:
        """Arguments of :meth:`RowSummary.add`, which takes them for several samples."""
        return self.coefficients, self.targets, self.elapsed, self.regimes, self.state


@dataclass(frozen=True)
class _Exclusion:
    """Channels whose rows are not used, from sample number ``begin`` up to, but not including, ``end``."""

    reason: str
    channels: tuple[int, ...]
    begin: int
    end: float = np.inf


class RevocableBuffer:
    """Queue of samples. Until a sample is removed, the choice of its rows that are left out can change."""

    def __init__(self) -> None:
        self.rows = 0
        """Number of rows that are not left out."""
        self.rejected: Counter[str] = Counter()
        """Number of rows that are left out, by reason."""
        self._instants: deque[BufferedSample] = deque()
        self._left_out: tuple[_Exclusion, ...] = ()

    @property
    def first(self) -> float:
        """Number of the first sample; infinite if there is none."""
        return self._instants[0].number if self._instants else np.inf

    @property
    def instants(self) -> list[BufferedSample]:
        """All samples, with the targets that are used now."""
        return [self._without_excluded(instant)[0] for instant in self._instants]

    @property
    def idle(self) -> bool:
        """True if there is no sample, and no rows of future samples will be left out."""
        return not self._instants and not self._left_out

    def append(self, instant: BufferedSample) -> None:
        """Add the next sample."""
        self._instants.append(instant)
        self._count(*self._without_excluded(instant))

    def pop(self) -> tuple[BufferedSample, Counter[str]]:
        """Remove and return the first sample, with the targets used now, and the number of rejected rows by reason."""
        instant, rejected = self._without_excluded(self._instants.popleft())
        self.rows -= _rows(instant)
        self.rejected -= rejected
        self._left_out = tuple(span for span in self._left_out if span.end > instant.number)
        return instant, rejected

    def leave_out(self, reason: str, channels: Sequence[int], begin: int) -> bool:
        """Leave out the rows of ``channels`` from sample number ``begin`` on, including future ones.

        Returns False if they were left out before for this reason."""
        exclusion = _Exclusion(reason, tuple(channels), begin)
        same = [span for span in self._left_out if replace(span, begin=begin) == exclusion]
        if any(span.begin <= begin for span in same):
            return False
        return self._change([*(span for span in self._left_out if span not in same), exclusion])

    def restore_rows(self, reason: str, begin: int) -> bool:
        """Use the rows left out for this reason again, from sample number ``begin`` on; False if there are none."""
        same = [span for span in self._left_out if span.reason == reason and span.end == np.inf]
        return self._change([replace(span, end=begin) if span in same else span for span in self._left_out])

    def _change(self, left_out: Sequence[_Exclusion]) -> bool:
        before, self._left_out = self._left_out, tuple(left_out)
        if self._left_out == before:
            return False
        self.rows, self.rejected = 0, Counter()
        for instant in self._instants:
            self._count(*self._without_excluded(instant))
        return True

    def _count(self, instant: BufferedSample, rejected: Counter[str]) -> None:
        self.rows += _rows(instant)
        self.rejected += rejected

    def _without_excluded(self, instant: BufferedSample) -> tuple[BufferedSample, Counter[str]]:
        """Return the sample without the rows that are left out, and their numbers by reason."""
        rejected: Counter[str] = Counter()
        if not self._left_out:
            return instant, rejected
        targets = instant.targets.copy()
        for span in self._left_out:
            if span.begin <= instant.number < span.end:
                channels = list(span.channels)
                rejected[span.reason] += int(np.count_nonzero(np.isfinite(targets[channels])))
                targets[channels] = np.nan
        return replace(instant, targets=targets), rejected


def _rows(instant: BufferedSample) -> int:
    return int(np.count_nonzero(np.isfinite(instant.targets)))
