"""Decides how often to solve, by the fraction of data that is new."""

from __future__ import annotations

NEW_SHARE = 1.0 / 11.0
"""Fraction of the remembered data that must be new for a solve: the data have then grown by a tenth, and standard
deviations have fallen by a twentieth. The estimate moves by less than a third of its standard deviation."""
_PERIODS = 10  # after which a solve is due in any case


class Pace:
    """Decides at the end of each period whether a solve is due."""

    def __init__(self) -> None:
        self._seen = 0  # number of rows one period ago
        self._skipped = 0  # periods since the last solve

    def is_due(self, rows: int, much_is_new: bool) -> bool:
        """True if a solve is due: if much is new, at every tenth period, or once no more data come.

        Args:
            rows: present number of rows, some of them newer than the last estimate.
            much_is_new: True if at least :data:`NEW_SHARE` of them is new.
        """
        ceased, self._seen = rows == self._seen, rows
        self._skipped += 1
        if not (much_is_new or ceased or self._skipped == _PERIODS):
            return False
        self._skipped = 0
        return True
