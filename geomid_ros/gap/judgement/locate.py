"""Where a remainder lives: the share of it that a smooth curve of one variable explains."""

from __future__ import annotations

import numpy as np

from geomid_ros.gap.evidence.features import hats, knots
from geomid_ros.gap.evidence.record import Records
from geomid_ros.gap.result import Located
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

_KNOTS = 12


def located(model: MeasurementModel, records: Records, residual: FloatArray, load: FloatArray) -> tuple[Located, ...]:
    """For each channel of ``residual (N, C)``; a wrench channel has no joint, only load and time."""
    samples = records.samples
    found = []
    for index, channel in enumerate(model.channels):
        values = residual[:, index]
        own = channel.joint is not None
        velocity = samples.velocity[:, index] if own else np.zeros(len(values))
        position = samples.position[:, index] if own else np.zeros(len(values))
        reversals = np.tanh(velocity / max(0.05 * float(np.std(velocity)), 1e-9))
        variables = (velocity, position, load[:, index], samples.seconds, reversals)
        found.append(Located(channel.name, *(share(values, variable) for variable in variables)))
    return tuple(found)


def strongest(found: Located) -> str:
    """The variable that explains most of a channel's remainder, ``unknown`` where none explains any of it."""
    shares = {name: float(getattr(found, name)) for name in ("velocity", "position", "load", "time", "reversals")}
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] > 0.0 else "unknown"


def share(values: FloatArray, variable: FloatArray) -> float:
    """Share of the mean square of ``values (N,)`` that a piecewise linear curve of a variable explains, 0 to 1, less
    what it would explain of noise."""
    usable = np.isfinite(values)
    values, variable = values[usable], variable[usable]
    if len(values) <= _KNOTS or np.ptp(variable) == 0.0:
        return 0.0
    curves = hats(variable, knots(variable), _KNOTS)
    solution, _, rank, _ = np.linalg.lstsq(curves, values, rcond=1e-9)
    left = float(np.sum((values - curves @ solution) ** 2)) / (len(values) - int(rank))
    return float(np.clip(1.0 - left / max(float(np.mean(values**2)), 1e-300), 0.0, 1.0))
