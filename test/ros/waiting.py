"""Waiting for what must come some time: the machine may be busy."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE = 300.0  # [s]


def wait_until(look: Callable[[], object]) -> None:
    """Wait until ``look`` finds something."""
    end = time.monotonic() + PATIENCE
    while not look():
        assert time.monotonic() < end
        time.sleep(0.005)
