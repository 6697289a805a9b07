"""Lines of channels over time for a page, whose script reads their values and zooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.report.page import line_path, number, ticks
from geomid_ros.report.series import BINS, Clock, Series, limits, thinned
from geomid_ros.types import FloatArray

SCRIPT = "traces.js"
WIDTH, HEIGHT = 20_000, 4_000
"""Of a panel, in the units of its lines; those of ``traces.js``."""

_MOST_POINTS = 200_000  # of a page: two megabytes
_TIMES = 5  # labels of the axis of time


@dataclass(frozen=True, kw_only=True)
class ChannelTrace:
    """A channel for a page.

    Attributes:
        name, unit: the channel's.
        before, after: RMS residual of the URDF and of the identified model, written.
        low, high: values at the panel's lower and upper edge.
        end: seconds at its right edge; the left one is at 0.
        times: labels of the axis of time, evenly spaced; ``clock`` is what it is called.
        ticks: labels of the other axis, and where they are in percent from the top.
        lines: by kind, the path of each.
    """

    name: str
    unit: str
    before: str
    after: str
    low: float
    high: float
    end: float
    times: Sequence[str]
    clock: str
    ticks: Sequence[tuple[str, float]]
    lines: dict[str, str]


def traces(series: Sequence[Series]) -> list[ChannelTrace]:
    """The channels, each in as many points as the page has room for."""
    if not series:
        return []
    clock = Clock.of(series)
    bins = max(1, min(BINS, _MOST_POINTS // (6 * len(series))))  # three lines, of two points each
    return [_trace(channel, clock, bins) for channel in series]


def _trace(channel: Series, clock: Clock, bins: int) -> ChannelTrace:
    low, high = limits(channel)
    end = float(clock.seconds[-1])
    kinds = {"measured": channel.measured, "before": channel.nominal, "after": channel.predicted}

    def path(values: FloatArray) -> str:
        seconds, heights = thinned(channel.times, values, clock, bins)
        return line_path(WIDTH * seconds / end, HEIGHT * (high - heights) / (high - low))

    before, after = map(number, channel.rms)
    return ChannelTrace(
        name=channel.name,
        unit=channel.unit,
        before=before,
        after=after,
        low=low,
        high=high,
        end=end,
        times=[f"{second:.4g}" for second in np.linspace(0.0, end, _TIMES)],
        clock=clock.label,
        ticks=[(f"{tick:g}", 100.0 * (high - tick) / (high - low)) for tick in ticks(low, high, 4)],
        lines={kind: path(values) for kind, values in kinds.items()},
    )
