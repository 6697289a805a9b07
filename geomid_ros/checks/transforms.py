"""Transforms of a whole recording: a table of candidates for what is wrong.

Each row yields candidates that undo one kind of transform, of the efforts (see :mod:`~geomid_ros.checks.efforts`) or of
the motion: unit, names, zeros, axes and time. In each row only those are evaluated whose corrected efforts resemble the
URDF's prediction most, at a few samples: the number of fits does not grow with that of joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from geomid_ros.checks.candidates import MASS_FACTOR, ROUNDS, STEP, TILT, FaultCandidate, is_probable
from geomid_ros.checks.causes import Cause
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.efforts import EFFORT_TRANSFORMS, exchanges, with_gravity_added, without_gravity
from geomid_ros.checks.evidence import LEAST_SIGMA, Evidence
from geomid_ros.model.samples import SIGN, SMOOTH_SIGN, Samples
from geomid_ros.types import FloatArray

UNITS = {
    "N m": {
        "degrees": np.pi / 180.0,
        "revolutions": 2.0 * np.pi,
        "mrad": 1e-3,
        **{f"steps of {2**bits} a turn": 2.0 * np.pi / 2.0**bits for bits in range(10, 21)},
    },
    "N": {"mm": 1e-3},
}
"""Units of positions, in rad and m, of joints with efforts in N m and N."""
_BEST = 3  # evaluated candidates per row
TIMES = (0.5, 2.0, 1e-3, 1e3)
"""Factors on speeds: stamps count seconds as halves, twice, as milliseconds or as thousands."""


def _names(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for swapped names: positions and efforts of one joint are those of another."""
    single, sides = exchanges(subject.names)
    for pairs in [*([pair] for pair in single), *([sides] if sides else [])]:
        sources = np.arange(len(subject.joints))
        for first, second in pairs:
            sources[[first, second]] = second, first
        order = np.arange(len(subject.robot.joints))
        order[subject.joints] = subject.joints[sources]
        both = [(subject.names[first], subject.names[second]) for first, second in pairs]
        described = ", ".join(f"'{first}' and '{second}'" for first, second in both)
        cause = Cause.of("names", [name for end in zip(*both, strict=True) for name in end], pairs=described)

        reordered = partial(Samples.with_joints, order=order)
        yield replace(_of_motion(reordered, cause), sources=sources, changes_all=False)


def positions(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for another unit of positions and speeds, of all rotary joints or of one joint. A smaller unit
    is tried only if positions exceed limits, or a turn."""
    robot = subject.robot
    turning = np.array([joint.unit != "N" for joint in robot.joints])
    low, high = robot.position_limits.T
    largest = np.max(np.abs(subject.samples.position), axis=0)
    allowed = np.where(turning, np.minimum(np.maximum(-low, high), 2.0 * np.pi), np.maximum(-low, high))
    for unit, size in UNITS["N m"].items() if np.any(turning) else ():
        if size > 1.0 or np.any((largest > allowed)[turning]):
            yield _in_unit(subject.names, np.where(turning, size, 1.0), unit, "joint positions are")
    for joint, kind in enumerate(robot.joints) if len(turning) > 1 else ():
        for unit, size in UNITS[kind.unit].items():
            if size > 1.0 or largest[joint] > allowed[joint]:
                scales = np.ones(len(turning))
                scales[joint] = size
                name = robot.joint_names[joint]
                beyond = largest[joint] > MASS_FACTOR * allowed[joint] and np.sum(largest > MASS_FACTOR * allowed) == 1
                yield _in_unit([name], scales, unit, f"the positions of joint '{name}' are", settled=bool(beyond))


def _in_unit(
    names: Sequence[str], scales: FloatArray, unit: str, positions_text: str, *, settled: bool = False
) -> FaultCandidate:
    right = "m and m/s" if unit in UNITS["N"] else "rad and rad/s"
    cause = Cause.of("position", names, positions=positions_text, unit=unit, right=right)
    return replace(_of_motion(partial(_moved, matrix=np.diag(scales)), cause), needs_no_evidence=settled)


def _of_motion(change: Callable[[Samples], Samples], cause: Cause) -> FaultCandidate:
    """Candidate whose changed samples are those of this robot."""
    return FaultCandidate(
        corrected=lambda subject: subject.with_samples(change(subject.samples)), cause=cause, changes_all=True
    )


def _moved(samples: Samples, matrix: FloatArray, zero: FloatArray | float = 0.0, rate: float = 1.0) -> Samples:
    """Apply a ``matrix (joints, joints)`` and a ``zero (joints,)`` to positions, and a clock ``rate`` times as fast."""
    velocity, effects = rate * samples.velocity @ matrix.T, samples.effects.copy()
    alone = np.count_nonzero(matrix, axis=1) == 1
    for column in (candidate for candidate in (SIGN, SMOOTH_SIGN) if candidate in samples.entries):
        signs = [samples.entries.at(column, joint) for joint in range(len(matrix))]
        effects[:, signs] = np.where(alone, np.sign(np.diag(matrix)) * effects[:, signs], np.sign(velocity))
    return replace(
        samples,
        position=samples.position @ matrix.T + zero,
        velocity=velocity,
        acceleration=rate**2 * samples.acceleration @ matrix.T,
        effects=effects,
    )


def _times(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for stamps that are too fast or too slow, or a robot that is moved by someone else: inertia does
    not fit gravity in the efforts."""
    yield _at_rate(subject, 0.0, Cause.of("guided", subject.names))
    for rate in TIMES:
        speed = f"{1.0 / rate:g} times as slow" if rate < 1.0 else f"{rate:g} times as fast"
        yield _at_rate(subject, rate, Cause.of("time", subject.names, rate=speed, period=f"{1.0 / rate:g} times"))


def _at_rate(subject: EffortData, rate: float, cause: Cause) -> FaultCandidate:
    same = np.eye(len(subject.robot.joints))

    def undo(subject: EffortData) -> Evidence:
        timed = subject.with_samples(_moved(subject.samples, same, rate=rate))
        judged, *without = (
            read.in_units(subject.measured_std).nominal
            for read in (timed, without_gravity(subject), with_gravity_added(subject))
        )
        beyond = max(one.log_evidence - subject.nominal.log_evidence for one in without)
        return replace(judged, log_evidence=judged.log_evidence - max(beyond, 0.0))

    return FaultCandidate(fit_corrected=undo, cause=cause, changes_all=True)


def _zeros(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for another zero of a rotary joint, fitted from where efforts resemble the prediction most."""
    for joint in _turning(subject):
        yield _zero(subject, joint, 1.0, _best_start(subject.thinned, joint, 1.0))


def _axes(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for a joint that counts in the opposite direction, or includes the angle of a parallel joint."""
    robot = subject.robot
    turning = _turning(subject)
    for joint in range(len(robot.joints)):
        yield _zero(subject, joint, -1.0, _best_start(subject.thinned, joint, -1.0) if joint in turning else 0.0)
        yield _reversed_motion(subject, joint)
        for other in robot.parallel_joints(joint) if joint in turning else ():
            yield from (_absolute(subject, joint, other, share) for share in (1.0, -1.0) if other in turning)


def _turning(subject: EffortData) -> list[int]:
    return [place for place, joint in enumerate(subject.robot.joints) if joint.unit != "N"]


def _best_start(few: EffortData, joint: int, sign: float) -> float:
    """Zero [rad] at which efforts resemble the prediction most: near the configured one, or quarter turns away."""
    near = 0.5 * TILT
    starts = np.array([0.0, near, -near, 0.5 * np.pi, -0.5 * np.pi, np.pi])
    counted = few.with_samples(_with_zero(few.samples, joint, sign, 0.0))
    at = np.arange(counted.samples.position.shape[1]) == joint
    read = [counted.at_positions(counted.samples.position + start * at) for start in starts]
    return float(starts[int(np.argmax([subject.resemblance for subject in read]))])


def _absolute(subject: EffortData, joint: int, other: int, share: float) -> FaultCandidate:
    names = subject.robot.joint_names
    cause = Cause.of("absolute", [names[joint], names[other]], sign="minus" if share > 0.0 else "plus")
    matrix = np.eye(len(names))
    matrix[joint, other] = -share
    return _of_motion(partial(_moved, matrix=matrix), cause)


def _reversed_motion(subject: EffortData, joint: int) -> FaultCandidate:
    """Candidate for a joint whose position and speed have the opposite sign, but not its effort."""
    cause = Cause.of("axis", [subject.robot.joint_names[joint]], reversed="position and velocity", zero="")
    signs = np.where(np.arange(len(subject.robot.joints)) == joint, -1.0, 1.0)
    return _of_motion(partial(_moved, matrix=np.diag(signs)), cause)


def _zero(subject: EffortData, joint: int, sign: float, start: float) -> FaultCandidate:
    """Candidate for a joint that counts from another zero, fitted near ``start`` [rad], and in the opposite direction
    if ``sign`` is negative.

    A wrong zero is one more unknown, ``tau(q + c) = tau(q) + dtau/dq c``: its evidence comes from the linearisation at
    the fitted links, repeated at its result.
    """
    name = subject.robot.joint_names[joint]

    def read(subject: EffortData, zero: float = start) -> EffortData:
        return subject.with_samples(_with_zero(subject.samples, joint, sign, zero))

    def undo(subject: EffortData) -> Evidence:
        zero, mended = start, read(subject)
        fitted = mended.nominal
        for _ in range(ROUNDS):
            links = mended.links(fitted)
            ahead, behind = (read(subject, zero + step) for step in (STEP, -STEP))
            rate = (ahead.regressor - behind.regressor) @ links * (0.5 * TILT / STEP)
            mended = read(subject, zero)
            mended.__dict__["predicted"] = mended.predicted + (start - zero) / TILT * rate
            fitted = mended.evidence(unknown=rate[:, :, None])
            zero = start + TILT * float(fitted.link_errors[-1])
        return replace(fitted, estimates=np.array([zero]), estimate_deviations=TILT * fitted.deviations()[-1:])

    def cause(judged: Evidence) -> Cause:
        zero, deviation = np.degrees([judged.estimates[0], judged.estimate_deviations[0]])
        turn = (zero + 180.0) % 360.0 - 180.0
        text = f"about {turn:.0f} (+-{max(2.0 * deviation, 1.0):.0f}) degrees have"
        if sign > 0.0:
            return Cause.of("zero", [name], zero=text)
        addition = "" if abs(turn) < 5.0 else f", and {text} to be added to its positions then"
        return Cause.of("axis", [name], reversed="position, velocity and effort", zero=addition)

    return FaultCandidate(fit_corrected=undo, corrected=read, cause=cause, changes_all=True)


def _with_zero(samples: Samples, joint: int, sign: float, zero: float) -> Samples:
    """Samples in which a joint counts from another zero [rad], in the opposite direction if ``sign`` is negative."""
    at = np.arange(samples.position.shape[1]) == joint
    signs = np.where(at, sign, 1.0)
    return replace(_moved(samples, np.diag(signs), zero * at), effort=signs * samples.effort)


MOTION_TRANSFORMS = (_times, _names, _zeros, _axes)
"""Rows of candidates that change the motion of the recording."""


_AS_IT_MOVES = (*EFFORT_TRANSFORMS, positions)  # motion unchanged, except for impossible angles


def transforms(subject: EffortData) -> tuple[list[FaultCandidate], int]:
    """Return all candidates that are worth evaluating on a subject, and the number that they are chosen from."""
    # If efforts are almost explained, another reading of the motion cannot gain enough.
    possible_gain = float(np.sum(np.log(subject.nominal.sigmas / LEAST_SIGMA)))
    rows = (*_AS_IT_MOVES, *MOTION_TRANSFORMS) if is_probable(possible_gain, 1) else _AS_IT_MOVES
    chosen, count = list[FaultCandidate](), 0
    for row in rows:
        ranked = sorted(row(subject), key=lambda candidate: -candidate.resemblance(subject.thinned))
        chosen += [c for place, c in enumerate(ranked) if place < _BEST or c.needs_no_evidence or c.corrected is None]
        count += len(ranked)
    return chosen, count
