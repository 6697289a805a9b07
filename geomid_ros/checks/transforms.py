"""Transforms of recordings that may have happened throughout: a table of candidates for what is wrong.

Each row of :data:`ROWS` yields candidates that undo one kind of transform: of the efforts (sign, unit, order), of
gravity, or of the motion (unit, names, zero, axis, time). Of each row those are judged whose mended efforts resemble
most, at a few instants, what the URDF predicts: the number of fits does not grow with that of joints.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np

from geomid_ros.checks.candidates import GAIN, Candidate, Judged
from geomid_ros.checks.causes import Cause, gain_settings, gravity_settings
from geomid_ros.checks.evidence import FOLLOWS, LEAST_SIGMA
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.subject import Subject
from geomid_ros.model.moving import SIGN
from geomid_ros.model.robot import GRAVITY
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray

REASON = 4.0
"""No URDF is wrong by more in its masses: a gain beyond it is a unit."""
STANDARD_GRAVITY = float(np.linalg.norm(GRAVITY))
"""[m/s^2]"""
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
TIMES = (0.5, 2.0, 1e-3, 1e3)
"""Factors of time: seconds that are counted as halves, twice, as milliseconds or as thousands."""
TILT = np.radians(25.0)
"""A base that is not level, and a zero that is off, are hardly off by more."""
STEP = 1e-4
"""[rad, m] of derivatives by positions."""
ROUNDS = 3
"""Of a fit that is linearised where it leads."""
_BEST = 3
_PAIRS = 8  # joints of which all pairs are tried; of more, neighbours
_NEARLY = 0.02  # of instants, and of the largest effort: what a filter leaves beyond zero
_SIDES = {"left": "right", "right": "left", "l": "r", "r": "l"}
_SIDE = re.compile(r"(?<![a-z])(left|right|l|r)(?![a-z])", re.IGNORECASE)


def candidates(subject: Subject) -> Iterator[Candidate]:
    """All candidates that are worth judging on a subject."""
    few = subject.part(slice(None, None, -(-len(subject.samples) // (2 * FEWEST))))
    # Of what is nearly explained no more could be told by reading the motion otherwise.
    rows = ROWS if np.sum(np.log(subject.nominal.sigmas / LEAST_SIGMA)) > GAIN else AS_IT_MOVES
    for row in rows:
        ranked = sorted(row(subject, few), key=lambda candidate: -candidate.resemblance(few))
        yield from ranked[:_BEST]
        yield from (candidate for candidate in ranked[_BEST:] if candidate.settled or candidate.read is None)


def _signs(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """The efforts of all joints are reversed, or of one."""
    every = range(len(subject.joints))
    for joints in [every, *([joint] for joint in every if len(every) > 1)]:
        names, whole = [subject.names[joint] for joint in joints], len(joints) == len(every)
        cause = Cause.of("sign", names, gain_settings(names, -subject.gains[list(joints)], whole), every=whole)
        yield _linear(np.diag(np.where(np.isin(every, joints), -1.0, 1.0)), cause, joints, upright=True)


def _linear(matrix: FloatArray, cause: Cause, concerned: Sequence[int], *, upright: bool = False) -> Candidate:
    """Efforts times a ``matrix (C, C)`` are those of this robot."""
    channels, sizes = np.arange(len(matrix)), np.abs(matrix)
    sources = np.where(sizes[channels, channels] > 0.0, channels, np.argmax(sizes, axis=1))

    def read(subject: Subject) -> Subject:
        return subject.with_efforts(subject.measured @ matrix.T)

    undo = _undone(read, sizes[channels, sources], sources)
    return Candidate(undo=undo, read=read, cause=cause, concerned=concerned, sources=sources, upright=upright)


def _orders(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """The efforts of two joints are exchanged."""
    for pairs in exchanges(subject.names):
        if len(pairs) == 1:
            pair = list(pairs[0])
            matrix = np.eye(len(subject.joints))
            matrix[pair] = matrix[pair[::-1]]
            yield _linear(matrix, Cause.of("order", [subject.names[joint] for joint in pair]), pair)


def _frictions(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """Weights and inertias are in the efforts as they should be, but friction drives joints."""
    found = subject.evidence(either_sign=True)
    friction = np.einsum("nck,ck->nc", subject.friction[:, :, 1:3], found.friction[:, 1:3])
    power = np.mean(friction * subject.samples.velocity[:, subject.joints], axis=0)
    concerned = np.flatnonzero((power < 0.0) & (np.sqrt(np.mean(friction**2, axis=0)) > LEAST_SIGMA)).tolist()
    if concerned:
        cause = Cause.of("friction", [subject.names[joint] for joint in concerned])

        def undo(subject: Subject) -> Judged:
            return Judged.mended(subject, subject.spread, subject.evidence(either_sign=True))

        everything_upright = not np.any(subject.opposite(found))
        yield Candidate(undo=undo, cause=cause, concerned=concerned, allowed=everything_upright)


def _magnitudes(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """Efforts are the magnitudes of what they should be: those that never change their sign where what is predicted, or
    the velocity of a joint that mainly rubs, does."""
    concerned = _without_sign(subject)
    if not concerned:
        return
    cause = Cause.of("magnitude", [subject.names[joint] for joint in concerned])

    def undo(subject: Subject) -> Judged:
        measured = subject.measured.copy()
        explained = np.array([_expected(subject, channel) for channel in concerned]).T
        for _ in range(ROUNDS):
            measured[:, concerned] = np.sign(explained) * np.abs(measured[:, concerned])
            mended = subject.with_efforts(measured)
            explained = mended.explained(mended.nominal)[:, concerned]
        return Judged.mended(mended, mended.spread)  # signs make numbers larger, not less probable

    yield Candidate(undo=undo, cause=cause, concerned=concerned)


def _without_sign(subject: Subject) -> list[int]:
    """The channels that have lost their sign."""
    low, high = np.quantile(subject.measured, (_NEARLY, 1.0 - _NEARLY), axis=0)
    one_sided = np.minimum(-low, high) <= _NEARLY * np.maximum(-low, high)
    shares = [np.mean(_expected(subject, channel) > 0.0) for channel in range(len(subject.joints))]
    return [channel for channel, share in enumerate(shares) if one_sided[channel] and _NEARLY < share < 1.0 - _NEARLY]


def _expected(subject: Subject, channel: int) -> FloatArray:
    """What an effort follows, of what is predicted and the speed of its joint ``(N,)``: by its magnitude."""
    effort, speed = np.abs(subject.measured[:, channel]), subject.samples.velocity[:, subject.joints[channel]]
    both = (subject.predicted[:, channel], speed)
    return max(both, key=lambda one: float(np.nan_to_num(np.corrcoef(effort, np.abs(one))[0, 1])))


def _gains(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """Another unit of all joints together, or shares of what they are rated for, and of each by itself."""
    every = range(len(subject.joints))
    slopes, told = subject.slopes()
    common, settled = _common_factor(subject, slopes, told)
    if not 1.0 / REASON <= common <= REASON:
        yield _gain(common * np.eye(len(every)), _other_unit(subject, every, common), every, settled)
    by_size = np.std(subject.predicted, axis=0) / subject.spread
    factors = np.where((told > 1.0 - FOLLOWS**2) & (slopes > 0.0), 1.0 / np.maximum(slopes, 1e-30), by_size)
    own = np.abs(np.log(np.maximum(factors / (common if settled else 1.0), 1e-30))) > np.log(REASON)
    unlike = np.abs(np.log(np.maximum(factors, 1e-30))) > np.log(REASON)
    loads = np.quantile(np.abs(subject.measured), 0.99, axis=0) / subject.robot.effort_limits[subject.joints]
    for joint in np.flatnonzero(own & unlike & (factors > 0.0)).tolist() if len(every) > 1 else ():
        factor, absurd = float(factors[joint]), bool(loads[joint] > REASON**2)
        matrix = np.diag(np.where(np.isin(every, joint), factor, 1.0))
        yield _gain(matrix, _other_unit(subject, [joint], factor), [joint], absurd)


def _gain(matrix: FloatArray, cause: Cause, concerned: Sequence[int], settled: bool) -> Candidate:
    """Another unit of efforts, which are as much like what is predicted in one unit as in the other."""
    return replace(_linear(matrix, cause, concerned), settled=settled, read=None)


def _common_factor(subject: Subject, slopes: FloatArray, told: FloatArray) -> tuple[float, bool]:
    """The factor that makes all efforts those of the URDF, and whether it is sure without any evidence: where the
    links that were fitted are all as much too light or too heavy."""
    fitted, follows = subject.fitted_slopes(subject.nominal)
    for ratios, sure in ((slopes, (told > 1.0 - FOLLOWS**2) & (slopes > 0.0)), (fitted, follows)):
        if np.count_nonzero(sure) >= 2:
            factor = 1.0 / float(np.median(ratios[sure]))
            return factor, bool(np.median(np.abs(np.log(ratios[sure] * factor))) < np.log(REASON))
    predicted = np.maximum(np.std(subject.predicted, axis=0), 1e-9)
    return float(np.median(predicted / subject.spread)), False


def _other_unit(subject: Subject, joints: Sequence[int], factor: float) -> Cause:
    """Efforts of these joints have to be multiplied by a factor."""
    names, whole = [subject.names[joint] for joint in joints], len(joints) == len(subject.joints)
    settings = gain_settings(names, subject.gains[list(joints)] * factor, whole)
    ratio = f"1/{factor:.3g}" if factor > 1.0 else f"{1.0 / factor:.3g} times"
    units = {"in mN m": (0.5e-3, 2e-3), "in kN m? or masses of the URDF in grams": (250.0, 4000.0)}
    unit = next((unit for unit, (low, high) in units.items() if low < factor < high), "")
    unit = unit or (
        "in A, on the motor side of the gear, or a share of what they are rated for" if factor > 1.0 else ""
    )
    return Cause.of("gain", names, settings, every=whole, ratio=ratio, unit=f" ({unit}?)" if unit else "")


def _gravities(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """The directions of gravity that fit best, and that it is not in the efforts."""
    nominal = subject.robot.gravity
    size = float(np.linalg.norm(nominal))
    right = abs(size - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
    fitted = subject.fitted_gravity(subject.prior)
    for start in (1.0, -1.0):
        direction = start * fitted / max(float(np.linalg.norm(fitted)), 1e-9)
        under = subject.under((size if right else STANDARD_GRAVITY) * direction)
        refined = subject.fitted_gravity(under.links(under.nominal))
        for gravity in (direction, refined / max(float(np.linalg.norm(refined)), 1e-9)):
            yield _turned(subject, (size if right else STANDARD_GRAVITY) * gravity)
    if not right:
        yield _turned(subject, STANDARD_GRAVITY * (nominal / size if size > 0.0 else np.array([0.0, 0.0, -1.0])))
    if size > 0.0:
        cause = Cause.of("compensated", subject.names, {"gravity": [0.0, 0.0, 0.0]})
        every = range(len(subject.joints))
        for read in (_weightless, _compensated):
            yield Candidate(undo=_undone(read), read=read, cause=cause, concerned=every)


def _turned(subject: Subject, gravity: FloatArray) -> Candidate:
    nominal, size = subject.robot.gravity, float(np.linalg.norm(gravity))
    cosine = float(gravity @ nominal) / max(size * float(np.linalg.norm(nominal)), 1e-9)
    angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    alone = angle > TILT or abs(size - float(np.linalg.norm(nominal))) > 0.1 * size
    vector = " ".join(f"{entry:g}" for entry in np.round(gravity, 2) + 0.0)
    turned = angle > TILT
    cause = Cause.of(
        "gravity",
        subject.names,
        gravity_settings(gravity),
        said="gravity" if alone else "level",
        how="in another direction" if turned else "with another size",
        check="check how the robot is mounted" if turned else "it must be in m/s^2",
        vector=vector,
        angle=np.degrees(angle),
    )

    def read(subject: Subject) -> Subject:
        return subject.under(gravity)

    return Candidate(undo=_undone(read), read=read, cause=cause, concerned=range(len(subject.joints)), alone=alone)


def _undone(
    read: Callable[[Subject], Subject], sizes: FloatArray | float = 1.0, sources: IntArray | slice = slice(None)
) -> Callable[[Subject], Judged]:
    """Judges a subject as it is read then, of efforts ``sizes`` times as large that were measured as ``sources``."""
    return lambda subject: Judged.mended(read(subject), sizes * subject.spread[sources])


def _weightless(subject: Subject) -> Subject:
    """There is no gravity."""
    return subject.under(np.zeros(3))


def _compensated(subject: Subject) -> Subject:
    """Weights, as of the URDF's links, are taken off."""
    return subject.with_efforts(subject.measured + subject.weight)


def _names(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """Positions and efforts of one joint are those of another."""
    for pairs in exchanges(subject.names):
        sources = np.arange(len(subject.joints))
        for first, second in pairs:
            sources[[first, second]] = second, first
        order = np.arange(len(subject.robot.joints))
        order[subject.joints] = subject.joints[sources]
        both = [(subject.names[first], subject.names[second]) for first, second in pairs]
        said = ", ".join(f"'{first}' and '{second}'" for first, second in both)
        cause = Cause.of("names", [name for end in zip(*both, strict=True) for name in end], pairs=said)

        def read(samples: Samples, order: IntArray = order) -> Samples:
            return samples.with_joints(order)

        yield _of_motion(read, cause, [place for pair in pairs for place in pair], sources=sources)


def exchanges(names: Sequence[str]) -> list[list[tuple[int, int]]]:
    """The exchanges that may well happen: of two joints, and of all of the left side with those of the right.

    Args:
        names: of joints, in the robot's order.

    Returns:
        Of each exchange the pairs of places ``(first, second)`` that change their names.
    """
    places = {name: place for place, name in enumerate(names)}
    mirrored = [(place, places.get(_mirrored(name), place)) for name, place in places.items()]
    sides = [(first, second) for first, second in mirrored if first < second]
    count = len(names)
    pairs = [*combinations(range(count), 2)] if count <= _PAIRS else [*pairwise(range(count)), *sides]
    return [*([pair] for pair in dict.fromkeys(pairs)), *([sides] if len(sides) > 1 else [])]


def _mirrored(name: str) -> str:
    return _SIDE.sub(lambda found: _SIDES[found.group().lower()], name)


def _positions(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """Positions and speeds of all joints that turn, or of one joint, are in another unit: in a smaller one only where
    they are beyond limits, or a turn."""
    robot = subject.robot
    turning = np.array([joint.unit != "N" for joint in robot.joints])
    low, high = robot.position_limits.T
    largest = np.max(np.abs(subject.samples.position), axis=0)
    allowed = np.where(turning, np.minimum(np.maximum(-low, high), 2.0 * np.pi), np.maximum(-low, high))
    for unit, size in UNITS["N m"].items() if np.any(turning) else ():
        if size > 1.0 or np.any((largest > allowed)[turning]):
            yield _in_unit(subject, np.where(turning, size, 1.0), unit, "joint positions are")
    for joint, kind in enumerate(robot.joints) if len(turning) > 1 else ():
        for unit, size in UNITS[kind.unit].items():
            if size > 1.0 or largest[joint] > allowed[joint]:
                scales = np.ones(len(turning))
                scales[joint] = size
                said = f"the positions of joint '{robot.joint_names[joint]}' are"
                beyond = largest[joint] > REASON * allowed[joint] and np.sum(largest > REASON * allowed) == 1
                yield _in_unit(subject, scales, unit, said, joint, settled=bool(beyond))


def _in_unit(
    subject: Subject,
    scales: FloatArray,
    unit: str,
    said: str,
    joint: int | None = None,
    *,
    settled: bool = False,
) -> Candidate:
    robot = subject.robot
    names = subject.names if joint is None else [robot.joint_names[joint]]
    right = "m and m/s" if unit in UNITS["N"] else "rad and rad/s"
    cause = Cause.of("position", names, positions=said, unit=unit, right=right)
    every = range(len(subject.joints))
    return _of_motion(lambda samples: _scaled(samples, scales), cause, every, settled=settled)


def _of_motion(
    change: Callable[[Samples], Samples],
    cause: Cause,
    concerned: Sequence[int],
    *,
    sources: IntArray | None = None,
    settled: bool = False,
) -> Candidate:
    """The recording with its samples changed is that of this robot."""

    def read(subject: Subject) -> Subject:
        return subject.with_samples(change(subject.samples))

    undo = _undone(read) if sources is None else _undone(read, sources=sources)
    return Candidate(undo=undo, read=read, cause=cause, concerned=concerned, sources=sources, settled=settled)


def _scaled(samples: Samples, scales: FloatArray, rate: float = 1.0) -> Samples:
    """Positions times scales ``(joints,)``, by a clock that runs ``rate`` times as fast."""
    return replace(
        samples,
        position=scales * samples.position,
        velocity=rate * scales * samples.velocity,
        acceleration=rate**2 * scales * samples.acceleration,
    )


def _times(subject: Subject, _: Subject) -> Iterator[Candidate]:
    """Stamps run too fast or too slow: where inertia does not fit gravity, and there is gravity in the efforts."""
    ones, every = np.ones(len(subject.robot.joints)), range(len(subject.joints))
    for rate in TIMES:
        said = f"{1.0 / rate:g} times as slow" if rate < 1.0 else f"{rate:g} times as fast"
        cause = Cause.of("time", subject.names, rate=said, period=f"{1.0 / rate:g} times")

        def undo(subject: Subject, rate: float = rate) -> Judged:
            judged = Judged.mended(subject.with_samples(_scaled(subject.samples, ones, rate)), subject.spread)
            without = max(_undone(read)(subject).log for read in (_weightless, _compensated))
            return replace(judged, log=judged.log - max(without - subject.nominal.log, 0.0))

        yield Candidate(undo=undo, cause=cause, concerned=every)


def _zeros(subject: Subject, few: Subject) -> Iterator[Candidate]:
    """A joint that turns counts from another zero: each from where efforts resemble those predicted most."""
    for joint in _turning(subject):
        yield _zero(subject, joint, 1.0, _best_start(few, joint, 1.0))


def _axes(subject: Subject, few: Subject) -> Iterator[Candidate]:
    """A joint counts the other way round, from any zero, or the angle of a parallel joint, too."""
    robot = subject.robot
    turning = _turning(subject)
    for joint in range(len(robot.joints)):
        yield _zero(subject, joint, -1.0, _best_start(few, joint, -1.0) if joint in turning else 0.0)
        yield _half_axis(subject, joint)
        for other in robot.parallel_joints(joint) if joint in turning else ():
            yield from (_absolute(subject, joint, other, share) for share in (1.0, -1.0) if other in turning)


def _turning(subject: Subject) -> list[int]:
    return [place for place, joint in enumerate(subject.robot.joints) if joint.unit != "N"]


def _best_start(few: Subject, joint: int, sign: float) -> float:
    """The zero [rad], of quarters of a turn and of what is near the configured one, from which efforts resemble those
    predicted most."""
    near = 0.5 * TILT
    starts = np.array([0.0, near, -near, 0.5 * np.pi, -0.5 * np.pi, np.pi])
    read = [few.with_samples(_recounted(few.samples, joint, sign, start)) for start in starts]
    return float(starts[int(np.argmax([each.resemblance for each in read]))])


def _absolute(subject: Subject, joint: int, other: int, share: float) -> Candidate:
    names = subject.robot.joint_names
    cause = Cause.of("absolute", [names[joint], names[other]], sign="minus" if share > 0.0 else "plus")

    def read(samples: Samples) -> Samples:
        moved = {name: getattr(samples, name).copy() for name in ("position", "velocity", "acceleration")}
        for name, values in moved.items():
            values[:, joint] -= share * getattr(samples, name)[:, other]
        return _with_sign(replace(samples, **moved), joint)

    return _of_motion(read, cause, range(len(subject.joints)))


def _with_sign(samples: Samples, joint: int) -> Samples:
    """Samples whose column of dry friction is that of a joint's velocity."""
    if SIGN not in samples.entries.columns.place:
        return samples
    effects = samples.effects.copy()
    effects[:, samples.entries.at(SIGN, joint)] = np.sign(samples.velocity[:, joint])
    return replace(samples, effects=effects)


def _turned_axis(samples: Samples, joint: int, *, effort: bool) -> Samples:
    """The motion of a joint the other way round, with its effort if that is asked for."""
    moved = {name: getattr(samples, name).copy() for name in ("position", "velocity", "acceleration", "effort")}
    for name, values in moved.items():
        if effort or name != "effort":
            values[:, joint] *= -1.0
    effects = samples.effects.copy()
    if SIGN in samples.entries.columns.place:
        effects[:, samples.entries.at(SIGN, joint)] *= -1.0
    return replace(samples, **moved, effects=effects)


def _half_axis(subject: Subject, joint: int) -> Candidate:
    """Position and speed of a joint have the opposite sign, its effort has not."""
    cause = Cause.of("axis", [subject.robot.joint_names[joint]], reversed="position and velocity", zero="")
    every = range(len(subject.joints))
    return _of_motion(lambda samples: _turned_axis(samples, joint, effort=False), cause, every)


def _zero(subject: Subject, joint: int, sign: float, start: float) -> Candidate:
    """A joint counts from another zero, which is fitted near ``start`` [rad], and the other way round if ``sign`` is
    below zero.

    A wrong zero is an unknown among others, ``tau(q + c) = tau(q) + dtau/dq c``: its evidence is found by the
    linearisation at the links that fit, and this is repeated from where it leads.
    """
    name = subject.robot.joint_names[joint]

    def read(subject: Subject, zero: float = start) -> Subject:
        return subject.with_samples(_recounted(subject.samples, joint, sign, zero))

    def undo(subject: Subject) -> Judged:
        zero, mended = start, read(subject)
        found = mended.nominal
        for _ in range(ROUNDS):
            links = mended.links(found)
            ahead, behind = (read(subject, zero + step) for step in (STEP, -STEP))
            rate = (ahead.regressor - behind.regressor) @ links * (0.5 * TILT / STEP)
            mended = read(subject, zero)
            mended.__dict__["predicted"] = mended.predicted + (start - zero) / TILT * rate
            found = mended.evidence(unknown=rate)
            zero = start + TILT * float(found.links[-1])
        sizes, deviations = [zero], [TILT * float(found.deviations()[-1])]
        return Judged.mended(mended, subject.spread, found, sizes=sizes, deviations=deviations)

    def cause(judged: Judged) -> Cause:
        zero, deviation = np.degrees([judged.sizes[0], judged.deviations[0]])
        turn = (zero + 180.0) % 360.0 - 180.0
        said = f"about {turn:.0f} (+-{max(2.0 * deviation, 1.0):.0f}) degrees have"
        if sign > 0.0:
            return Cause.of("zero", [name], zero=said)
        beside = "" if abs(turn) < 5.0 else f", and {said} to be added to its positions then"
        return Cause.of("axis", [name], reversed="position, velocity and effort", zero=beside)

    return Candidate(undo=undo, read=read, cause=cause, concerned=range(len(subject.joints)))


def _recounted(samples: Samples, joint: int, sign: float, zero: float) -> Samples:
    """Samples of which a joint counts from another zero [rad], the other way round if ``sign`` is below zero."""
    turned = samples if sign > 0.0 else _turned_axis(samples, joint, effort=True)
    position = turned.position.copy()
    position[:, joint] += zero
    return replace(turned, position=position)


AS_IT_MOVES = (_signs, _frictions, _magnitudes, _orders, _gains, _gravities, _positions)
"""Rows whose motion is that of the recording, unless its angles cannot be any."""
ROWS = (*AS_IT_MOVES, _times, _names, _zeros, _axes)
"""What may have happened to a recording."""
