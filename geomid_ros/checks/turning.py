"""Whether a gyroscope turns as the legs say: its clock and its axes.

Feet that all stand tell how the base turns, by the encoders alone: the points where they touch do not move. No mass and
no effort is asked, so that nothing of what is identified can hide what is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.evidence import HALF
from geomid_ros.checks.instants import FEWEST, STEP
from geomid_ros.model.contacts import Legs
from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray, FloatArray

_SHIFTS = STEP * np.arange(-10, 11)  # [ns]
_TURNED = np.radians(10.0)  # the encoders' zeros, and feet that roll, make a few degrees


@dataclass(frozen=True, eq=False)
class _Turning:
    """How a gyroscope compares with the legs.

    Attributes:
        late: by how much its stamps are late [s].
        angle: that it is turned by [rad].
        before, after: shares of the legs' turning that it leaves as it is, and with all of this undone.
    """

    late: float
    angle: float
    before: float
    after: float


def gyroscope(legs: Legs, stretch: Samples) -> tuple[Finding, ...]:
    """What is wrong with the gyroscope of a base, if both halves of a ``stretch`` on all feet show the same."""
    measured, seconds = stretch.base_velocity[:, 3:], stretch.seconds
    turning = legs.turning(stretch)
    known = np.flatnonzero(_interior(stretch) & np.isfinite(turning).all(axis=1))
    if len(known) < 2 * FEWEST:
        return ()
    moved = np.array(
        [[np.interp(seconds[known] + 1e-9 * shift, seconds, axis) for axis in measured.T] for shift in _SHIFTS]
    ).transpose(0, 2, 1)
    parts = [(turning[known[half]], moved[:, half]) for half in np.array_split(np.arange(len(known)), 2)]
    if not all(np.any(by_legs) and np.all(np.any(shifted, axis=(1, 2))) for by_legs, shifted in parts):
        return ()  # only what both say that the base turns can be compared
    halves = [_compared(*part) for part in parts]
    if any(each.after > HALF * min(each.before, HALF) for each in halves):
        return ()
    late, angle = (np.array([getattr(each, name) for each in halves]) for name in ("late", "angle"))
    off = 1e9 * abs(float(np.mean(late)))
    if off > STEP and np.ptp(late) < HALF * abs(np.mean(late)):
        word = ("late" if np.mean(late) > 0.0 else "early") + (" or more" if off > _SHIFTS[-2] else "")
        return (_finding(f"its stamps are {1e-6 * off:.0f} ms {word}: synchronise its clock with that of the joints"),)
    if np.mean(angle) > _TURNED and np.ptp(angle) < HALF * np.mean(angle):
        degrees = np.degrees(np.mean(angle))
        return (
            _finding(f"it is turned by about {degrees:.0f} degrees against its frame in the URDF: correct the frame"),
        )
    return ()


def _finding(what: str) -> Finding:
    sentence = f"the IMU does not turn as the base does by legs that all stand: {what}"
    return Finding(cause=Cause(kind="imu", sentence=sentence))


def on_all_feet(legs: Legs, samples: Samples) -> Samples:
    """The instants around which all feet bear half of an equal share or more, as far as is known."""
    bearing = np.all(samples.standing, axis=1)
    bearing[bearing] = np.all(legs.loads(samples.select(bearing)) > HALF, axis=1)
    return samples.select(_around(samples, bearing))


def _around(samples: Samples, true: BoolArray) -> BoolArray:
    """Whether all around each instant, within all shifts, are ``true (N,)``."""
    first = np.searchsorted(samples.stamps, samples.stamps + _SHIFTS[0], side="left")
    last = np.searchsorted(samples.stamps, samples.stamps + _SHIFTS[-1], side="right")
    count = np.append(0, np.cumsum(~true))
    return np.asarray(count[last] == count[first])


def _interior(stretch: Samples) -> BoolArray:
    """The instants ``(N,)`` around which nothing is missing for any shift."""
    stamps = stretch.stamps
    runs = np.append(0, np.cumsum(np.diff(stamps) > 2 * STEP))
    ends = [np.clip(np.searchsorted(stamps, stamps + shift), 0, len(stamps) - 1) for shift in _SHIFTS[[0, -1]]]
    inside = (stamps + _SHIFTS[0] >= stamps[0]) & (stamps + _SHIFTS[-1] <= stamps[-1])
    return np.asarray(inside & np.all([runs[end] == runs for end in ends], axis=0))


def _compared(turning: FloatArray, moved: FloatArray) -> _Turning:
    """By what the legs say ``(N, 3)``, and what the gyroscope does at each shift ``(shifts, N, 3)``."""
    whole = float(np.sum(turning**2))
    turned = [_turned(turning, each) for each in moved]
    left = np.array(
        [np.sum((turning - size * each @ axes.T) ** 2) for (axes, size), each in zip(turned, moved, strict=True)]
    )
    best = int(np.argmin(left))
    axes, _ = turned[best]
    late = float(_SHIFTS[best])
    if 0 < best < len(left) - 1:
        before, own, after = left[best - 1 : best + 2]
        late += STEP * 0.5 * (before - after) / (before - 2.0 * own + after)
    angle = float(np.arccos(np.clip(0.5 * (np.trace(axes) - 1.0), -1.0, 1.0)))
    as_it_is = float(np.sum((turning - moved[len(moved) // 2]) ** 2))
    return _Turning(1e-9 * late, angle, as_it_is / whole, float(left[best]) / whole)


def _turned(turning: FloatArray, measured: FloatArray) -> tuple[FloatArray, float]:
    """The rotation ``(3, 3)`` and the factor that make one of the other (Kabsch 1976; Umeyama 1991)."""
    left, sizes, right = np.linalg.svd(turning.T @ measured)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray(left * signs @ right), float(sizes @ signs / np.sum(measured**2))
