"""A target that is broken in every way which the fuzzer must find."""

from __future__ import annotations

import os
from pathlib import Path
from random import Random

from geomid_ros.errors import InputError


class Broken:
    """Right but for some inputs, by their number."""

    def __init__(self, folder: Path) -> None:
        del folder
        self._index = -1

    def attempt(self, _: Random) -> None:
        """What input 3 and so on do."""
        self._index += 1
        if self._index == 3:
            raise KeyError("another error")
        if self._index == 5:
            while True:
                pass
        if self._index == 7:
            bytearray(2**31)
        if self._index == 9:
            raise InputError("refused, as it should be")
        if self._index == 11:
            os.abort()  # as a fault in a compiled library does
