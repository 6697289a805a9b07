"""The unknown: free curves of one or two variables, which compete with the names for what is left."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geomid_ros.gap.candidates import CurveCandidate, CurveTerm, Term
from geomid_ros.gap.evidence.record import Records
from geomid_ros.model.effects import Situation
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

POSITION, VELOCITY, LOAD, TIME = "position", "velocity", "load", "time"
_PERIODS = range(2, 49)  # per turn of the joint
_HANDICAP = 1.0  # in parameters: of as good a name and curve the name is taken


class Curves:
    """Columns of free curves on some records; the places of their knots are those of the first records."""

    def __init__(self, model: MeasurementModel, records: Records, situation: Situation) -> None:
        self._model = model
        joints = model.layout.efforts
        self._knots = {
            (kind, joint): knots(values)
            for joint in joints
            for kind, values in self._variables(records, situation, joint).items()
        }
        self._times = (int(records.samples.stamps[0]), int(records.samples.stamps[-1]))
        self.candidates = [c for joint in joints for c in self._candidates(records, situation, joint)]

    @staticmethod
    def _variables(records: Records, situation: Situation, joint: int) -> dict[str, FloatArray]:
        return {
            POSITION: records.samples.position[:, joint],
            VELOCITY: records.samples.velocity[:, joint],
            LOAD: situation.predicted[:, joint],
        }

    def _candidates(self, records: Records, situation: Situation, joint: int) -> Iterator[CurveCandidate]:
        for kind, name, matrix in self._matrices(records, situation, joint):
            terms = tuple(CurveTerm(joint, name, index) for index in range(matrix.shape[1]))
            look_elsewhere = 1.0 if name.startswith("wave") else 0.0
            dry = name.startswith("friction by")
            yield CurveCandidate(kind, name, joint, terms, len(terms) + _HANDICAP + look_elsewhere, dry)

    def columns(self, records: Records, situation: Situation) -> dict[Term, dict[int, FloatArray]]:
        """Columns of all curves' terms."""
        return {
            CurveTerm(joint, name, index): {joint: column}
            for joint in sorted({candidate.joint for candidate in self.candidates})
            for _, name, matrix in self._matrices(records, situation, joint)
            for index, column in enumerate(matrix.T)
        }

    def _matrices(self, records: Records, situation: Situation, joint: int) -> Iterator[tuple[str, str, FloatArray]]:
        samples, sign = records.samples, situation.sign[:, joint]
        position = samples.position[:, joint]
        for kind, values in self._variables(records, situation, joint).items():
            ends = self._knots[kind, joint]
            yield kind, f"{kind} curve", hats(values, ends, 8)
            if kind != VELOCITY:
                yield kind, f"friction by {kind}", sign[:, None] * hats(values, ends, 5)
        for waves in _PERIODS:
            yield POSITION, f"wave {waves}", np.stack([np.sin(waves * position), np.cos(waves * position)], axis=1)
        time = (samples.stamps - self._times[0]) / max(self._times[1] - self._times[0], 1)
        yield TIME, "drift", (2.0 * time - 1.0)[:, None]
        yield TIME, "drift from the start", _time_in_stretch(records)[:, None]
        yield TIME, "course", np.asarray(np.polynomial.legendre.legvander(2.0 * time - 1.0, 4)[:, 1:], dtype=np.float64)
        for other, name in enumerate(self._model.robot.joint_names):
            if other != joint:
                q, v = samples.position[:, other], samples.velocity[:, other]
                yield name, f"{name} speed", v[:, None]
                yield name, f"{name} friction", situation.sign[:, other, None]
                yield name, f"{name} position", np.stack([q, q**2, q**3], axis=1)
                sums = (np.sin(q + position), np.cos(q + position), np.sin(q - position), np.cos(q - position))
                yield name, f"{name} and position", np.stack([np.sin(q), np.cos(q), *sums], axis=1)


def knots(values: FloatArray) -> tuple[float, float]:
    """Where the first and the last knot of curves of a variable lie, with these ``values (N,)``."""
    low, high = np.quantile(values, [0.005, 0.995])
    return float(low), float(high)


def hats(values: FloatArray, ends: tuple[float, float], count: int) -> FloatArray:
    """Piecewise linear functions of a variable with knots between two ends, which add up to 1, ``(N, count)``."""
    low, high = ends
    place = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0) * (count - 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(count))))


def _time_in_stretch(records: Records) -> FloatArray:
    """Time since the beginning of each sample's stretch ``(N,)``, the longest one's last being 1."""
    stamps = records.samples.stamps
    starts = np.array([part.stamps[0] for part in records.dense])
    since: FloatArray = (stamps - starts[records.segment]).astype(np.float64)
    return since / max(float(np.max(since)), 1.0)
