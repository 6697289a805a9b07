"""Joints, and bases that move, whose efforts are badly explained: what is left is a good part of their variation, and
large on this robot.

The efforts of a wrist are often mostly friction and noise: there a good part is left of sound recordings, too. What is
left is told where it is large beside the largest variation of an effort of this robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.evidence import HALF, LEAST_SIGMA
from geomid_ros.checks.flexible import moving
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.subject import Subject, largest_of_unit
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

WORSE = 1.05
"""RMS over that of the input's file: less is of no account."""
_ELSE = (
    "check the axis and the sign of the position in the URDF, a coupling of its gear with that of another joint, and "
    "that all of the recording is of this robot"
)


_OF_BASE = (
    "what the feet bear and what the base does do not belong together: check that the clocks of the IMU and of the "
    "joints agree, that efforts are not late, the IMU's frame, and that all feet are named"
)


def badly_explained(
    channels: Sequence[tuple[str, str]],
    left: FloatArray,
    variation: FloatArray,
    hint: Callable[[str, float], str],
    *,
    before: FloatArray | float = np.inf,
    allowed: float = HALF,
    what: str = "joint",
) -> tuple[Finding, ...]:
    """The channels whose efforts are not explained, the worst first, and what to look at; nothing if all are.

    Args:
        channels: name and unit of each of C joints' efforts, or of what a base feels.
        left: ``(C,)`` RMS of what is left of the efforts.
        variation: ``(C,)`` standard deviations of the efforts, or their RMS.
        hint: says what to look at, by a channel's name and the share of its variation that is left.
        before: ``(C,)`` RMS of what the input's file leaves, infinite where that is not known.
        allowed: share of the variation that may be left.
        what: the channels are.
    """
    units = [unit for _, unit in channels]
    share = left / np.maximum(variation, np.finfo(float).tiny)
    large = left > LEAST_SIGMA * largest_of_unit(variation, units)
    bad = large & ((share > allowed) | (left > WORSE * before))
    worst = sorted(np.flatnonzero(bad).tolist(), key=lambda joint: -share[joint])
    if not worst:
        return ()
    names = tuple(channels[joint][0] for joint in worst)
    said = ", ".join(
        f"'{name}' is not explained: {100.0 * max(1.0 - share[j], 0.0):.0f} % ({left[j]:.3g} of {variation[j]:.3g} "
        f"{units[j]} are left)"
        for name, j in zip(names, worst, strict=True)
    )
    sentence = f"{what} {said}; {hint(names[0], float(share[worst[0]]))}"
    return (Finding(cause=Cause(kind="unexplained", sentence=sentence, places=names)),)


def hint(subject: Subject, joint: str, share: float) -> str:
    """What to look at: friction, if beside links it explains half of what a model leaves of a joint's effort, a
    ``share`` of its variation; or what explains most of it beside both, if that leaves half of what others leave."""
    if joint not in subject.names:
        return _ELSE
    channel = subject.names.index(joint)
    before, left = subject.nominal.sigmas[channel], dict[str, float]()
    without = subject.evidence(friction=False).sigmas[channel]
    if before**2 < HALF * min(share, without) ** 2:
        return _of_speed(joint)
    for said, columns in _hints(subject, channel):
        unknown = np.zeros((*subject.measured.shape, columns.shape[1]))
        sizes = np.maximum(np.std(columns, axis=0), np.finfo(float).tiny)
        unknown[:, channel] = subject.spread[channel] * columns / sizes
        left[said] = (subject.evidence(unknown=unknown).sigmas[channel] / before) ** 2
    best, *others = sorted(left, key=lambda said: left[said])
    return best if left[best] < HALF * min([1.0, *(left[said] for said in others)]) else _ELSE


def _hints(subject: Subject, channel: int) -> Iterator[tuple[str, FloatArray]]:
    """What may be wrong, with what the effort would follow then ``(N, k)``."""
    name, joint = subject.names[channel], subject.joints[channel]
    place, speed = subject.samples.position[:, joint], subject.samples.velocity[:, joint]
    yield (
        f"what is left follows the position of '{name}': check its axis, sign and zero in the URDF, or a spring",
        np.column_stack([place, place**2, place**3]),
    )
    yield _of_speed(name), np.column_stack([speed, np.sign(speed)])
    for other, effort in enumerate(subject.measured.T):
        if other != channel:
            coupled = f"what is left follows the effort of '{subject.names[other]}': check a coupling of the two gears"
            yield f"{coupled}, and the axes and signs of both positions", effort[:, None]


def _of_speed(joint: str) -> str:
    return f"what is left follows the speed of '{joint}': check the sign of its position, and its friction (--effects)"


def unexplained(
    model: MeasurementModel, batches: Sequence[Samples], parameters: FloatArray, recorded: Samples | None
) -> tuple[Finding, ...]:
    """The joints whose efforts a model does not explain, or worse than the input's file does.

    Args:
        model: of the robot.
        batches: samples that were held out; none if there are none.
        parameters: the identified ones ``(D,)``.
        recorded: instants of all that was recorded, which is judged too; None if there are none.
    """
    both = np.column_stack([parameters, model.nominal_parameters])
    told = (list(batches), [] if recorded is None else [recorded])
    judged = [_left(model, samples, both) for samples in told if samples]
    if not judged:
        return ()
    variation = np.max([variation for _, variation in judged], axis=0)
    if recorded is not None:
        variation = np.maximum(variation, deviations(recorded.effort))
    channels = [(model.channels[channel].name, model.channels[channel].unit) for channel in model.layout.efforts]
    found = (
        badly_explained(
            channels,
            left[:, 0],
            variation,
            lambda *of: _ELSE if recorded is None else hint(Subject.of_all(model.robot, recorded), *of),
            before=left[:, 1],
        )
        for left, _ in judged
    )
    return next(filter(None, found), ())


def unexplained_base(model: MeasurementModel, batches: Sequence[Samples], parameters: FloatArray) -> list[str]:
    """The forces and moments on a base that moves of which a model leaves half, in a sentence, if so.

    Small moments may be mostly noise of the efforts of the legs, so that this alone is no doubt.
    """
    base = list(model.layout.base)
    if not base or not batches:
        return []
    pairs = [model.predict(samples, parameters) for samples in batches]
    measured, predicted = (np.concatenate([each[:, base] for each in own]) for own in zip(*pairs, strict=True))
    channels = [(model.channels[channel].name, model.channels[channel].unit) for channel in base]
    found = badly_explained(channels, rms(measured - predicted), rms(measured), lambda *_: _OF_BASE, what="on the base")
    return [finding.sentence for finding in found]


def _left(model: MeasurementModel, judged: Sequence[Samples], both: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The RMS ``(C, 2)`` of what two sets of parameters ``(D, 2)`` leave of the efforts of joints that move, and the
    standard deviations of these efforts ``(C,)``."""
    efforts = model.layout.efforts
    pairs = [model.predict(samples, both) for samples in judged]
    residuals = np.concatenate([(measured[:, :, None] - predicted)[:, efforts] for measured, predicted in pairs])
    velocity, effort = (np.concatenate([getattr(each, name) for each in judged]) for name in ("velocity", "effort"))
    residuals = np.where(moving(velocity)[:, :, None], residuals, np.nan)
    left = np.stack([rms(of_one) for of_one in np.moveaxis(residuals, 2, 0)], axis=1)
    return left, deviations(np.where(np.isfinite(residuals[:, :, 0]), effort, np.nan))


def rms(residuals: FloatArray) -> FloatArray:
    """RMS ``(C,)`` of residuals ``(N, C)`` where they are known, zero where too few are."""
    known = np.isfinite(residuals)
    squares, counts = np.sum(np.where(known, residuals, 0.0) ** 2, axis=0), np.count_nonzero(known, axis=0)
    return np.asarray(np.where(counts < FEWEST, 0.0, np.sqrt(squares / np.maximum(counts, 1))))


def deviations(efforts: FloatArray) -> FloatArray:
    """Standard deviations of efforts ``(N, C)`` where they are known ``(C,)``, zero where fewer than two are."""
    known = np.isfinite(efforts)
    counts = np.maximum(np.count_nonzero(known, axis=0), 1)
    centred = np.where(known, efforts - np.sum(np.where(known, efforts, 0.0), axis=0) / counts, 0.0)
    return np.asarray(np.sqrt(np.sum(centred**2, axis=0) / counts))
