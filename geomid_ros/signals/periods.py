"""The time between messages, by their stamps."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import IntArray

_FEWEST = 32  # messages that the period is inferred from
_FEWEST_IN_BURSTS = 320
_SHORT, _IN_BURSTS = 0.25, 0.2  # of the mean step; the share of steps that are shorter, where messages come in bursts


def in_bursts(stamps: IntArray) -> bool:
    """Whether more than a fifth of the steps between increasing stamps are shorter than a quarter of the mean step."""
    steps = np.diff(stamps)
    return bool(np.mean(steps < _SHORT * np.mean(steps)) > _IN_BURSTS)


def inferred_period(stamps: IntArray) -> tuple[float, bool] | None:
    """The time between messages [ns] by the first stamps, and whether they come in bursts; None if too few.

    It is the median step; but where messages come in bursts or pairs, of which the steps say nothing, the time from
    the beginning of a burst to that of a later one, by the number of messages between.
    """
    if len(stamps) < _FEWEST:
        return None
    if not in_bursts(stamps[:_FEWEST]):
        return float(np.median(np.diff(stamps[:_FEWEST]))), False
    if len(stamps) < _FEWEST_IN_BURSTS:
        return None
    steps = np.diff(stamps[:_FEWEST_IN_BURSTS])
    begins = np.flatnonzero(steps > np.mean(steps)) + 1
    return float(stamps[begins[-1]] - stamps[begins[0]]) / float(begins[-1] - begins[0]), True
