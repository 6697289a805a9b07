"""Joints and moving bases with badly explained efforts: the residual is large, and a good part of the variation.

The efforts of a wrist are often mostly friction and noise: a good part remains even in sound recordings. A residual is
reported if it is large compared with the largest variation of an effort of this robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from geomid_ros.checks.causes import Cause
from geomid_ros.checks.effort_data import EffortData, largest_of_unit, moving, standardised
from geomid_ros.checks.evidence import LEAST_SIGMA, MOST
from geomid_ros.checks.sample_reservoir import FEWEST
from geomid_ros.estimation.estimate import Predictor
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import DIRECTIONS
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

WORSE = 1.05
"""RMS over that of the input's file: a smaller rise is negligible."""
_ELSE = (
    "check the axis and the sign of the position in the URDF, a coupling of its gear with that of another joint, that "
    "all of the recording is of this robot, and that nothing touched it"
)
_MASSLESS = (
    "no link that it moves has a mass in the URDF: give them an <inertial> ('geomid prior' computes it from shapes)"
)

_OF_BASE = (
    "foot loads and base motion are inconsistent: check that the clocks of the IMU and of the joints agree, that "
    "efforts are not late, the IMU's frame, and that all feet are named"
)


def badly_explained(
    channels: Sequence[tuple[str, str]],
    residual_rms: FloatArray,
    variation: FloatArray,
    hint: Callable[[str, float], str],
    *,
    before: FloatArray | float = np.inf,
    allowed: float = MOST,
    kind: str = "joint",
) -> list[Cause]:
    """Report the channels whose efforts are not explained, the worst first, and what to look at; nothing if all are.

    Args:
        channels: name and unit of each of C joints' efforts, or of the wrench on a base.
        residual_rms: ``(C,)`` RMS of the residuals of the efforts.
        variation: ``(C,)`` standard deviations of the efforts, or their RMS.
        hint: describes what to look at, from a channel's name and the fraction of its variation that is left.
        before: ``(C,)`` residual RMS of the input's file, infinite where that is not known.
        allowed: fraction of the variation that may be left.
        kind: kind of the channels.
    """
    names, units = zip(*channels, strict=True)
    share = residual_rms / np.maximum(variation, np.finfo(float).tiny)
    large = residual_rms > LEAST_SIGMA * largest_of_unit(variation, units)
    bad = large & ((share > allowed) | (residual_rms > WORSE * before))
    worst = sorted(np.flatnonzero(bad).tolist(), key=lambda joint: -share[joint])
    if not worst:
        return []
    described = ", ".join(
        f"'{names[j]}' is not explained: {100.0 * max(1.0 - share[j], 0.0):.0f} % "
        f"({residual_rms[j]:.3g} of {variation[j]:.3g} {units[j]} are left)"
        for j in worst
    )
    sentence = f"{kind} {described}; {hint(names[worst[0]], float(share[worst[0]]))}"
    return [Cause(kind="unexplained", sentence=sentence, places=tuple(names[j] for j in worst))]


def hint(subject: EffortData, joint: str, share: float) -> str:
    """Describe what to look at: friction, if together with links it explains half of the residual of a joint, a
    ``share`` of its variation; else the variable that explains most of the rest, if it leaves half of the others'."""
    if joint not in subject.names:
        moves_mass = np.any(subject.robot.supports[subject.robot.joint_names.index(joint)])
        return _ELSE if moves_mass else _MASSLESS
    channel = subject.names.index(joint)
    before, remaining = subject.nominal.sigmas[channel], dict[str, float]()
    without = subject.evidence(friction=False).sigmas[channel]
    if before**2 < MOST * min(share, without) ** 2:
        return _speed_hint(joint)
    for text, columns in _hints(subject, channel):
        unknown = np.zeros((*subject.measured.shape, columns.shape[1]))
        unknown[:, channel] = subject.measured_std[channel] * standardised(columns)
        remaining[text] = (subject.evidence(unknown=unknown).sigmas[channel] / before) ** 2
    best, *others = sorted(remaining, key=lambda text: remaining[text])
    return best if remaining[best] < MOST * min([1.0, *(remaining[text] for text in others)]) else _ELSE


def _hints(subject: EffortData, channel: int) -> Iterator[tuple[str, FloatArray]]:
    """Possible faults, with the columns ``(N, k)`` that the effort would follow."""
    name, joint = subject.names[channel], subject.joints[channel]
    place, speed = subject.samples.position[:, joint], subject.samples.velocity[:, joint]
    yield (
        f"the residual correlates with the position of '{name}': check its axis, sign and zero, or a spring",
        np.column_stack([place, place**2, place**3]),
    )
    yield _speed_hint(name), np.column_stack([speed, np.sign(speed)])
    for other, effort in enumerate(subject.measured.T):
        if other != channel:
            coupled = f"the residual correlates with the effort of '{subject.names[other]}'"
            yield f"{coupled}: check a coupling of the two gears, and the axes and signs of both", effort[:, None]


def _speed_hint(joint: str) -> str:
    return (
        f"the residual correlates with the speed of '{joint}': check the sign of its position, and its friction "
        "(--effects)"
    )


def unexplained(
    model: MeasurementModel, batches: Sequence[Samples], identified: Predictor, recorded: Samples | None
) -> list[Cause]:
    """Report the joints whose efforts a model does not explain, or explains worse than the input's file does.

    Args:
        model: of the robot.
        batches: held-out samples; empty if there are none.
        identified: the estimate.
        recorded: samples of all that was recorded, which are evaluated, too; None if there are none.
    """
    both = identified.beside(model.described_parameters)
    groups = (list(batches), [] if recorded is None else [recorded])
    residuals = [residual_rms_in_motion(model, samples, both) for samples in groups if samples]
    if not residuals:
        return []
    variation = np.max([variation for _, variation in residuals], axis=0)
    if recorded is not None:
        variation = np.maximum(variation, deviations(recorded.effort))
    channels = _named(model, model.layout.efforts)

    def look_at(joint: str, share: float) -> str:
        return _ELSE if recorded is None else hint(EffortData.of_all(model.robot, recorded), joint, share)

    findings = (
        badly_explained(channels, rms_pair[:, 0], variation, look_at, before=rms_pair[:, 1])
        for rms_pair, _ in residuals
    )
    return next(filter(None, findings), [])


def unexplained_base(model: MeasurementModel, batches: Sequence[Samples], parameters: FloatArray) -> list[Cause]:
    """Report if a model leaves half of the force on a moving base, or of the moment. One axis alone may be mostly noise
    of the legs' efforts."""
    base = list(model.layout.base)
    if not base or not batches:
        return []
    measured, predicted = (values[:, base] for values in model.predict(Samples.concatenate(list(batches)), parameters))
    left, variation = (
        np.linalg.norm(each.reshape(2, DIRECTIONS), axis=1)
        for each in (rms(measured - predicted), deviations(measured))
    )
    channels = [("force", "N"), ("moment", "N m")]
    return badly_explained(channels, left, variation, lambda *_: _OF_BASE, kind="on the base the")


def _named(model: MeasurementModel, places: Sequence[int]) -> list[tuple[str, str]]:
    """Names and units of channels."""
    return [(model.channels[place].name, model.channels[place].unit) for place in places]


def residual_rms_in_motion(
    model: MeasurementModel, batches: Sequence[Samples], several: Predictor
) -> tuple[FloatArray, FloatArray]:
    """Residual RMS ``(C, K)`` of K models on the efforts of joints while they move, as dry friction at rest has any
    value within its limits, and the standard deviations of these efforts ``(C,)``."""
    samples = Samples.concatenate(list(batches))
    measured, predicted = model.predict(samples, *several)
    residuals = (measured[:, :, None] - predicted)[:, model.layout.efforts]
    residuals = np.where(moving(samples.velocity)[:, :, None], residuals, np.nan)
    return rms(residuals), deviations(np.where(np.isfinite(residuals[:, :, 0]), samples.effort, np.nan))


def rms(residuals: FloatArray) -> FloatArray:
    """RMS ``(C, ...)`` of residuals ``(N, C, ...)`` where they are known, zero where too few are."""
    finite = np.isfinite(residuals)
    squares, counts = np.sum(np.where(finite, residuals, 0.0) ** 2, axis=0), np.count_nonzero(finite, axis=0)
    return np.asarray(np.where(counts < FEWEST, 0.0, np.sqrt(squares / np.maximum(counts, 1))))


def deviations(efforts: FloatArray) -> FloatArray:
    """Standard deviations of efforts ``(N, C)`` where they are known ``(C,)``, zero where fewer than two are."""
    finite = np.isfinite(efforts)
    counts = np.maximum(np.count_nonzero(finite, axis=0), 1)
    centred = np.where(finite, efforts - np.sum(np.where(finite, efforts, 0.0), axis=0) / counts, 0.0)
    return np.asarray(np.sqrt(np.sum(centred**2, axis=0) / counts))
