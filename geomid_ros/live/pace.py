"""How often an estimate is worth making: in proportion to what is new."""

from __future__ import annotations

NEW_SHARE = 1.0 / 11.0
"""Of what is remembered: an estimate is worth making once as much is new. The data have grown by a tenth, and standard
deviations that fall with their root by a twentieth; what is estimated moves by less than a third of its own."""
_PERIODS = 10  # after which it is worth making anyway


class Pace:
    """Says at the end of each period whether an estimate is worth making."""

    def __init__(self) -> None:
        self._seen = 0  # rows, a period ago
        self._skipped = 0  # periods since it was worth making

    def worth(self, rows: int, much_is_new: bool) -> bool:
        """Whether an estimate is worth making: where much is new, at every tenth period, and once no more data come.

        Args:
            rows: so many there are now, some of which the last estimate does not know.
            much_is_new: whether at least :data:`NEW_SHARE` is.
        """
        ceased, self._seen = rows == self._seen, rows
        self._skipped += 1
        if not (much_is_new or ceased or self._skipped == _PERIODS):
            return False
        self._skipped = 0
        return True
