"""What is drawn as SVG: paths of lines and of dots, and round numbers for an axis."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray, IntArray

_ROUND = np.array([1.0, 2.0, 2.5, 5.0, 10.0])


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers at equal distances between two ends, of which they leave ``most`` intervals or fewer."""
    least = (high - low) / most
    power = 10.0 ** np.floor(np.log10(least))
    step = power * _ROUND[np.searchsorted(_ROUND, 0.999 * least / power)]
    whole = np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)
    found: list[float] = (step * whole + 0.0).tolist()  # + 0: zero has no sign
    return found


def line_path(x: FloatArray, y: FloatArray) -> str:
    """The path of a line in whole units that is broken where it is NaN."""
    breaks = np.flatnonzero(np.isnan(x) | np.isnan(y))
    runs = np.split(np.column_stack([x, y]), breaks)
    known = (run[np.all(np.isfinite(run), axis=1)] for run in runs)
    return "".join("M" + " ".join(map(str, _whole(run).ravel().tolist())) for run in known if len(run))


def dots_path(x: FloatArray, y: FloatArray) -> str:
    """The path of dots in whole units, to be drawn with round ends; none where a value is NaN."""
    dots = np.column_stack([x, y])
    places = _whole(dots[np.all(np.isfinite(dots), axis=1)])
    return "".join(f"m{right} {down}h0" for right, down in np.diff(places, axis=0, prepend=0).tolist())


def _whole(values: FloatArray) -> IntArray:
    return np.rint(values).astype(np.int64)
