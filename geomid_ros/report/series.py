"""Channels over time for pictures and pages: without long pauses, and with no more points than are visible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.samples import Samples
from geomid_ros.report.page import line_path, number, ticks
from geomid_ros.session.session import Session
from geomid_ros.types import BoolArray, FloatArray, IntArray

MOST_DRAWN = 12
"""Largest number of channels drawn over time."""
BINS = 500
"""Number of bins of a long line; each keeps its smallest and largest value."""

_CORE = (0.5, 99.5)  # percentiles of ordinary values of a channel


@dataclass(frozen=True, eq=False)
class Series:
    """Channel over time, in ``unit``: ``times`` [s], the ``measured`` values, those of the URDF (``nominal``) and of
    the identified model (``predicted``); ``(N,)`` each, NaN where absent."""

    name: str
    unit: str
    times: FloatArray
    measured: FloatArray
    nominal: FloatArray
    predicted: FloatArray

    @property
    def rms(self) -> tuple[float, float]:
        """Residual RMS of the URDF and of the identified model; NaN without a common sample."""
        return _rms(self.measured - self.nominal), _rms(self.measured - self.predicted)

    @property
    def ratio(self) -> float:
        """RMS after divided by RMS before: below 1 is better; NaN if undefined."""
        before, after = self.rms
        return after / before if before > 0.0 else float("nan")


def series_of(session: Session, estimate: Estimate, batches: Sequence[Samples]) -> list[Series]:
    """Return the channels measured in at least one sample; the batches are in the order of time."""
    stamps = np.concatenate([samples.stamps for samples in batches])
    times = (stamps - stamps[0]) * 1e-9
    both = estimate.predictor.beside(session.model.described_parameters)
    pairs = zip(*(session.model.predict(samples, *both) for samples in batches), strict=True)
    measured, predicted = map(np.concatenate, pairs)
    return [
        Series(channel.name, channel.unit, times, measured[:, index], *predicted[:, index, ::-1].T)
        for index, channel in enumerate(session.model.channels)
        if np.any(np.isfinite(measured[:, index]))
    ]


@dataclass(frozen=True, eq=False)
class Clock:
    """Map from stamps to seconds since the first one; pauses that would leave little room for the rest are shortened.

    ``stamps (K,)`` [s] ascending, ``seconds (K,)`` their positions on the axis.
    """

    stamps: FloatArray
    seconds: FloatArray
    label: str

    @staticmethod
    def of(series: Sequence[Series]) -> Clock:
        """Return the clock of some channels."""
        stamps = np.unique(np.concatenate([channel.times for channel in series]))
        stamps = stamps[np.isfinite(stamps)]
        if len(stamps) < 2:
            return Clock(np.array([0.0, 1.0]) + stamps.sum(), np.array([0.0, 1.0]), "time [s]")
        steps = np.diff(stamps)
        recorded = float(np.sum(steps[~_is_pause(steps)]))
        pauses = _is_pause(steps) & (steps > 0.1 * recorded)
        seconds = np.concatenate([[0.0], np.cumsum(np.where(pauses, 0.03 * recorded, steps))])
        return Clock(stamps, seconds, "time [s], pauses shortened" if np.any(pauses) else "time [s]")

    def at(self, times: FloatArray) -> FloatArray:
        """Convert ``times`` to seconds on the axis."""
        return np.interp(times, self.stamps, self.seconds)


def elapsed(stamps: IntArray) -> FloatArray:
    """Seconds since the first stamp [ns], ``(N,)``, without pauses between recordings. A recording may begin before the
    one in front of it."""
    steps = np.diff(stamps) * 1e-9
    period = float(np.median(steps)) if len(steps) else 0.0
    durations = np.where(_is_pause(steps) | (steps <= 0.0), period, steps) if len(steps) else steps
    return np.concatenate([[0.0], np.cumsum(durations)])[: len(stamps)]


def _rms(residuals: FloatArray) -> float:
    finite = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def limits(channel: Series) -> tuple[float, float]:
    """Limits of y: all measured and identified values but 1 %, and nominal values within one such span of them."""
    core = np.concatenate([channel.measured, channel.predicted])
    everything = np.concatenate([core, channel.nominal])
    everything = everything[np.isfinite(everything)]
    if len(everything) == 0:
        return -1.0, 1.0
    core = core[np.isfinite(core)]
    if len(core) == 0 or np.ptp(np.percentile(core, _CORE)) == 0.0:
        core = everything
    low, high = np.percentile(core, _CORE)
    span = max(high - low, 1e-3 * max(abs(low), abs(high))) or 1.0
    bottom, top = max(everything.min(), low - span), min(everything.max(), high + span)
    margin = max(0.07 * (top - bottom), 0.5 * (span - (top - bottom)))
    return float(bottom - margin), float(top + margin)


def thinned(times: FloatArray, values: FloatArray, clock: Clock, bins: int = BINS) -> tuple[FloatArray, FloatArray]:
    """Thin a line for drawing: keep all peaks, drop invisible points, and break it by NaN at gaps in time."""
    finite = np.flatnonzero(np.isfinite(times) & np.isfinite(values))
    order = finite[np.argsort(times[finite], kind="stable")]
    times, values = times[order], values[order]
    if len(times) < 3:
        return clock.at(times), values
    gaps = np.flatnonzero(_is_pause(np.diff(times)))
    kept = np.union1d(_extremes(values, bins), [*gaps, *(gaps + 1)]).astype(np.int64)
    breaks = np.searchsorted(kept, gaps + 1)
    return np.insert(clock.at(times[kept]), breaks, np.nan), np.insert(values[kept], breaks, np.nan)


def _is_pause(steps: FloatArray) -> BoolArray:
    """True for time steps longer than five median steps."""
    return steps > 5.0 * np.median(steps)


def _extremes(values: FloatArray, bins: int) -> IntArray:
    """Indices of the smallest and the largest value in each of at most ``bins`` bins, and of both ends."""
    if len(values) <= 2 * bins:
        return np.arange(len(values))
    length = -(-len(values) // bins)
    padded = np.pad(values, (0, -len(values) % length), mode="edge").reshape(-1, length)
    starts = np.arange(len(padded)) * length
    picked = np.concatenate([[0], starts + padded.argmin(axis=1), starts + padded.argmax(axis=1), [len(values) - 1]])
    return np.unique(np.minimum(picked, len(values) - 1))


# --- For pages, whose script reads off values and zooms ---

SCRIPT = "traces.js"
WIDTH, HEIGHT = 20_000, 4_000
"""Size of a panel in the units of its lines; the same as in ``traces.js``."""

_MOST_POINTS = 200_000  # per page: two megabytes
_TIMES = 5  # labels of the time axis


def traces(series: Sequence[Series]) -> list[dict[str, Any]]:
    """Return what the template shows of the channels, each in as many points as fit the page."""
    if not series:
        return []
    clock = Clock.of(series)
    bins = max(1, min(BINS, _MOST_POINTS // (6 * len(series))))  # three lines, two points each
    return [_trace(channel, clock, bins) for channel in series]


def _trace(channel: Series, clock: Clock, bins: int) -> dict[str, Any]:
    """Panel of a channel: values at its edges, labels of its axes with positions in percent, and the path of each line
    by kind."""
    low, high = limits(channel)
    end = float(clock.seconds[-1])
    kinds = {"measured": channel.measured, "before": channel.nominal, "after": channel.predicted}

    def path(values: FloatArray) -> str:
        seconds, heights = thinned(channel.times, values, clock, bins)
        return line_path(WIDTH * seconds / end, HEIGHT * (high - heights) / (high - low))

    before, after = map(number, channel.rms)
    return {
        "name": channel.name,
        "unit": channel.unit,
        "before": before,
        "after": after,
        "low": low,
        "high": high,
        "end": end,
        "times": [f"{second:.4g}" for second in np.linspace(0.0, end, _TIMES)],
        "clock": clock.label,
        "ticks": [(f"{tick:g}", 100.0 * (high - tick) / (high - low)) for tick in ticks(low, high, 4)],
        "lines": {kind: path(values) for kind, values in kinds.items()},
    }
