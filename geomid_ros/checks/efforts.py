"""Transforms of efforts throughout a recording: sign, order, unit, friction, and gravity in them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np

from geomid_ros.checks.candidates import MASS_FACTOR, ROUNDS, TILT, FaultCandidate
from geomid_ros.checks.causes import Cause, gain_settings
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.evidence import LEAST_SIGMA, MOST, Evidence, follows
from geomid_ros.model.robot import STANDARD_GRAVITY
from geomid_ros.types import FloatArray

_PAIRS = 8  # most joints of which all pairs are tried; of more joints, neighbours
_NEARLY = 0.02  # fraction of samples, and of the largest effort, that a filter leaves beyond zero
_SIDES = {"left": "right", "right": "left", "l": "r", "r": "l"}
_SIDE = re.compile(r"(?<![a-z])(left|right|l|r)(?![a-z])", re.IGNORECASE)


def _signs(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for reversed efforts, of all joints or of one."""
    every = range(len(subject.joints))
    for joints in [every, *([joint] for joint in every if len(every) > 1)]:
        names, is_all = [subject.names[joint] for joint in joints], len(joints) == len(every)
        cause = Cause.of("sign", names, gain_settings(names, -subject.gains[list(joints)], is_all), all_joints=is_all)
        yield _linear(np.diag(np.where(np.isin(every, joints), -1.0, 1.0)), cause)


def _linear(matrix: FloatArray, cause: Cause) -> FaultCandidate:
    """Candidate whose efforts, times a ``matrix (C, C)``, are those of this robot."""
    sizes = np.abs(matrix)
    sources = np.where(np.diag(sizes) > 0.0, np.arange(len(matrix)), np.argmax(sizes, axis=1))
    return FaultCandidate(
        corrected=lambda subject: subject.with_efforts(subject.measured @ matrix.T),
        cause=cause,
        sizes=np.take_along_axis(sizes, sources[:, None], axis=1)[:, 0],
        sources=sources,
    )


def _orders(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for swapped efforts of two joints."""
    for first, second in exchanges(subject.names)[0]:
        matrix = np.eye(len(subject.joints))
        matrix[[first, second]] = matrix[[second, first]]
        yield _linear(matrix, Cause.of("order", [subject.names[first], subject.names[second]]))


def _couplings(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for a motor that also delivers the effort of another joint, in either direction.

    They are not named, because sound recordings of some seconds may look like them. But they explain what would be
    taken for a sign or a gain: the joint is then reported as unexplained, with a hint at the coupling.
    """
    for pair in exchanges(subject.names)[0]:
        for joint, other in (pair, pair[::-1]):
            for sign in (1.0, -1.0):
                matrix = np.eye(len(subject.joints))
                matrix[joint, other] = sign
                cause = Cause(kind="coupled", sentence="", places=(subject.names[joint],))
                yield replace(_linear(matrix, cause), may_be_named=False)


def _frictions(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield a candidate for friction that drives joints, while weights and inertias are right in the efforts."""
    fitted = subject.evidence(either_sign=True)
    friction = subject.friction_efforts(fitted)
    power = np.mean(friction * subject.samples.velocity[:, subject.joints], axis=0)
    drives = (power < 0.0) & (np.sqrt(np.mean(friction**2, axis=0)) > LEAST_SIGMA)
    concerned = np.flatnonzero(drives).tolist()
    if concerned and not np.any(follows(-subject.fitted_slopes(fitted)[1])):
        cause = Cause.of("friction", [subject.names[joint] for joint in concerned])
        yield FaultCandidate(fit_corrected=lambda subject: subject.evidence(either_sign=drives), cause=cause)


def _magnitudes(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield a candidate for efforts that lost their sign: it never changes where the prediction's does, or the
    velocity's if friction dominates."""
    concerned = _without_sign(subject)
    if not concerned:
        return
    cause = Cause.of("magnitude", [subject.names[joint] for joint in concerned])

    def undo(subject: EffortData) -> Evidence:
        measured = subject.measured.copy()
        explained = np.array([_expected(subject, channel) for channel in concerned]).T
        for _ in range(ROUNDS):
            measured[:, concerned] = np.copysign(measured[:, concerned], explained)
            mended = subject.with_efforts(measured)
            explained = mended.explained(mended.nominal)[:, concerned]
        return mended.nominal  # in its own units: restored signs make numbers vary more, not less probable

    yield FaultCandidate(fit_corrected=undo, cause=cause)


def _without_sign(subject: EffortData) -> list[int]:
    """Channels that have lost their sign."""
    low, high = np.quantile(subject.measured, (_NEARLY, 1.0 - _NEARLY), axis=0)
    one_sided = np.minimum(-low, high) <= _NEARLY * np.maximum(-low, high)
    shares = [np.mean(_expected(subject, channel) > 0.0) for channel in range(len(subject.joints))]
    return [channel for channel, share in enumerate(shares) if one_sided[channel] and _NEARLY < share < 1.0 - _NEARLY]


def _expected(subject: EffortData, channel: int) -> FloatArray:
    """Prediction or velocity ``(N,)``, whichever an effort follows by its magnitude. An effort that is always about as
    large, and mostly a weight, as of a vertical axis, hardly changes with either."""
    effort, speed = np.abs(subject.measured[:, channel]), subject.samples.velocity[:, subject.joints[channel]]
    predicted = subject.predicted[:, channel]
    if min(np.abs(np.mean(predicted)), np.quantile(effort, _NEARLY)) > MOST * np.mean(effort):
        return predicted
    return max((predicted, speed), key=lambda one: float(np.nan_to_num(np.corrcoef(effort, np.abs(one))[0, 1])))


def _gains(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for another unit, or fractions of rated efforts, of all joints together and of each alone."""
    every = range(len(subject.joints))
    slopes, correlations = subject.slopes()
    common, settled = _common_factor(subject)
    if not 1.0 / MASS_FACTOR <= common <= MASS_FACTOR:
        yield _gain(common * np.eye(len(every)), _other_unit(subject, every, common), settled)
    by_size = np.std(subject.predicted, axis=0) / subject.measured_std
    factors = np.where(follows(correlations), 1.0 / np.maximum(slopes, 1e-30), by_size)
    unlike_common = np.abs(np.log(np.maximum(factors / (common if settled else 1.0), 1e-30))) > np.log(MASS_FACTOR)
    unlike_nominal = np.abs(np.log(np.maximum(factors, 1e-30))) > np.log(MASS_FACTOR)
    loads = np.quantile(np.abs(subject.measured), 0.99, axis=0) / subject.robot.effort_limits[subject.joints]
    for joint in np.flatnonzero(unlike_common & unlike_nominal & (factors > 0.0)).tolist() if len(every) > 1 else ():
        factor, beyond_rating = float(factors[joint]), bool(loads[joint] > MASS_FACTOR**2)
        matrix = np.diag(np.where(np.isin(every, joint), factor, 1.0))
        yield _gain(matrix, _other_unit(subject, [joint], factor), beyond_rating)


def _gain(matrix: FloatArray, cause: Cause, settled: bool) -> FaultCandidate:
    """Candidate for another unit of efforts, on which their resemblance to the prediction does not depend."""
    linear = _linear(matrix, cause)
    return replace(linear, needs_no_evidence=settled, corrected=None, fit_corrected=linear.evaluate)


def _common_factor(subject: EffortData) -> tuple[float, bool]:
    """Factor that makes all efforts those of the URDF, and True if it is certain without any evidence: if the fitted
    links are all too light or too heavy by the same factor."""
    for slopes, correlations in (subject.slopes(), subject.fitted_slopes(subject.nominal)):
        sure = follows(correlations)
        if np.count_nonzero(sure) >= 2:
            factor = 1.0 / float(np.median(slopes[sure]))
            return factor, bool(np.median(np.abs(np.log(slopes[sure] * factor))) < np.log(MASS_FACTOR))
    predicted = np.maximum(np.std(subject.predicted, axis=0), 1e-9)
    return float(np.median(predicted / subject.measured_std)), False


def _other_unit(subject: EffortData, joints: Sequence[int], factor: float) -> Cause:
    """Cause if the efforts of these joints must be multiplied by a factor."""
    names, is_all = [subject.names[joint] for joint in joints], len(joints) == len(subject.joints)
    settings = gain_settings(names, subject.gains[list(joints)] * factor, is_all)
    ratio = f"1/{factor:.3g}" if factor > 1.0 else f"{1.0 / factor:.3g} times"
    units = {
        "in mN m": (0.5e-3, 2e-3),
        "in kN m? or masses of the URDF in grams": (250.0, 4000.0),
        "in A, on the motor side of the gear, or a share of what they are rated for": (1.0, np.inf),
    }
    unit = next((unit for unit, (low, high) in units.items() if low < factor < high), "")
    return Cause.of("gain", names, settings, all_joints=is_all, ratio=ratio, unit=f" ({unit}?)" if unit else "")


def _gravities(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for the best-fitting directions of gravity, and for efforts without gravity."""
    nominal = subject.robot.gravity
    size = float(np.linalg.norm(nominal))
    right = abs(size - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
    strength, fitted = size if right else STANDARD_GRAVITY, subject.fitted_gravity(subject.urdf_parameters)
    for start in (1.0, -1.0):
        gravity = start * strength * _unit(fitted)
        under = subject.under_gravity(gravity)
        yield _turned(subject, gravity)
        yield _turned(subject, strength * _unit(subject.fitted_gravity(under.links(under.nominal))))
    if not right:
        yield _turned(subject, STANDARD_GRAVITY * (nominal / size if size > 0.0 else np.array([0.0, 0.0, -1.0])))
    if size > 0.0:
        cause = Cause.of("compensated", subject.names, {"gravity": [0.0, 0.0, 0.0]})
        yield from (FaultCandidate(corrected=read, cause=cause) for read in (without_gravity, with_gravity_added))


def _unit(vector: FloatArray) -> FloatArray:
    """Direction of a vector."""
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def _turned(subject: EffortData, gravity: FloatArray) -> FaultCandidate:
    nominal, size = subject.robot.gravity, float(np.linalg.norm(gravity))
    angle = float(np.arccos(np.clip(_unit(gravity) @ _unit(nominal), -1.0, 1.0)))
    turned = angle > TILT
    alone = turned or abs(size - float(np.linalg.norm(nominal))) > 0.1 * size
    written = (np.round(gravity, 2) + 0.0).tolist()
    cause = Cause.of(
        "gravity",
        subject.names,
        {"gravity": written},
        sentence_key="gravity" if alone else "level",
        how="in another direction" if turned else "with another size",
        check="check how the robot is mounted" if turned else "it must be in m/s^2",
        vector=" ".join(f"{entry:g}" for entry in written),
        angle=np.degrees(angle),
    )
    return FaultCandidate(corrected=lambda subject: subject.under_gravity(gravity), cause=cause, may_be_named=alone)


def without_gravity(subject: EffortData) -> EffortData:
    """Return the subject without gravity."""
    return subject.under_gravity(np.zeros(3))


def with_gravity_added(subject: EffortData) -> EffortData:
    """Add the weights of the URDF's links to efforts that are compensated for them."""
    return subject.with_efforts(subject.measured + subject.weight)


def exchanges(names: Sequence[str]) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return plausible exchanges of joints by their ``names``, in the robot's order.

    Returns:
        The pairs of indices ``(first, second)`` of which one may swap names; and those of joints on the left and on the
        right that may swap names together, none if there are fewer than two.
    """
    places = {name: place for place, name in enumerate(names)}
    mirrored = [(place, places.get(_mirrored(name), place)) for name, place in places.items()]
    sides = [(first, second) for first, second in mirrored if first < second]
    count = len(names)
    pairs = [*combinations(range(count), 2)] if count <= _PAIRS else [*pairwise(range(count)), *sides]
    return list(dict.fromkeys(pairs)), sides if len(sides) > 1 else []


def _mirrored(name: str) -> str:
    return _SIDE.sub(lambda found: _SIDES[found.group().lower()], name)


EFFORT_TRANSFORMS = (_signs, _frictions, _magnitudes, _orders, _couplings, _gains, _gravities)
"""Rows of candidates: each yields those that undo one kind of transform."""
