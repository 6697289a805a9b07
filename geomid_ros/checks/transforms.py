"""Transforms of a whole recording: a table of candidates for what is wrong.

Each row yields candidates that undo one kind of transform, of the efforts (sign, order, unit, friction, and gravity in
them) or of the motion (unit, names, zeros, axes and time). In each row only those are evaluated whose corrected efforts
resemble the URDF's prediction most, at a few samples: the number of fits does not grow with that of joints.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, pairwise

import numpy as np

from geomid_ros.checks.candidates import MASS_FACTOR, ROUNDS, TILT, FaultCandidate, is_probable
from geomid_ros.checks.causes import Cause, gain_settings
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.evidence import LEAST_SIGMA, Evidence, follows
from geomid_ros.model.dynamics import STEP
from geomid_ros.model.robot import STANDARD_GRAVITY
from geomid_ros.model.samples import REST_SPEED, SIGN, SMOOTH_SIGN, Samples
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
    for first, second in _exchanges(subject.names)[0]:
        matrix = np.eye(len(subject.joints))
        matrix[[first, second]] = matrix[[second, first]]
        yield _linear(matrix, Cause.of("order", [subject.names[first], subject.names[second]]))


def _couplings(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for a motor that also delivers the effort of another joint, in either direction, where this
    explains more than friction and inertia of a motor that turns both, which the model has.

    Only neighbours are named: sound recordings of some seconds may look like any pair.
    """
    for pair in _exchanges(subject.names)[0]:
        for joint, other in (pair, pair[::-1]):
            for sign, word in ((1.0, "plus"), (-1.0, "minus")):
                matrix = np.eye(len(subject.joints))
                matrix[joint, other] = sign
                cause = Cause.of("coupled", [subject.names[joint], subject.names[other]], sign=word)
                linear = _linear(matrix, cause)
                beyond = partial(_beyond_shared_motor, linear, pair)
                yield replace(linear, fit_corrected=beyond, may_be_named=abs(joint - other) == 1)


def _beyond_shared_motor(coupled: FaultCandidate, pair: tuple[int, int], subject: EffortData) -> Evidence:
    """Evidence of a candidate beyond what a motor gains that turns the joints of a pair of channels."""
    judged = coupled.evaluate(subject)
    shared = max(subject.evidence(unknown=_of_shared_motor(subject, pair, ratio)).log_evidence for ratio in (1.0, -1.0))
    return replace(judged, log_evidence=judged.log_evidence - max(shared - subject.nominal.log_evidence, 0.0))


def _of_shared_motor(subject: EffortData, pair: tuple[int, int], ratio: float) -> FloatArray:
    """Effort columns ``(N, C, 6)`` of friction and inertia of a motor that turns by ``q_1 + ratio q_2`` of a pair of
    channels, at each of them, per prior standard deviation."""
    speed, acceleration = (subject.friction[:, list(pair)][:, :, [1, -1]].transpose(2, 0, 1)) @ [1.0, ratio]
    columns = np.column_stack([speed, np.sign(speed), acceleration])
    columns *= 2.0 / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-6)
    unknown = np.zeros((*subject.measured.shape, 2, 3))
    for place, channel in enumerate(pair):
        unknown[:, channel, place] = subject.measured_std[channel] * columns
    return unknown.reshape(*subject.measured.shape, 6)


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
    """Channels that have lost their sign; the dry friction of a joint that never moves may keep one."""
    low, high = np.quantile(subject.measured, (_NEARLY, 1.0 - _NEARLY), axis=0)
    one_sided = np.minimum(-low, high) <= _NEARLY * np.maximum(-low, high)
    moves = np.any(np.abs(subject.samples.velocity[:, subject.joints]) > REST_SPEED, axis=0)
    concerned = np.flatnonzero(one_sided & moves).tolist()
    shares = [np.mean(_expected(subject, channel) > 0.0) for channel in concerned]
    return [channel for channel, share in zip(concerned, shares, strict=True) if _NEARLY < share < 1.0 - _NEARLY]


def _expected(subject: EffortData, channel: int) -> FloatArray:
    """Prediction or velocity ``(N,)``, whichever an effort follows by its magnitude.

    The effort of a vertical axis, a weight and friction, hardly changes with either. With or without its sign, the mean
    of its magnitude is the larger of the two, and the least of it is less by the smaller one: the prediction says which
    one is the weight. If it is the larger one, no sign changes.
    """
    effort, speed = np.abs(subject.measured[:, channel]), subject.samples.velocity[:, subject.joints[channel]]
    predicted = subject.predicted[:, channel]
    weight, mean, least = np.abs(np.mean(predicted)), np.mean(effort), np.quantile(effort, _NEARLY)
    if weight**2 > mean * (mean - least):  # nearer to the larger one by its ratio
        return predicted
    return max((predicted, speed), key=lambda one: float(np.nan_to_num(np.corrcoef(effort, np.abs(one))[0, 1])))


def _gains(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for another unit, or fractions of rated efforts, of all joints together and of each alone."""
    every = range(len(subject.joints))
    slopes, correlations = subject.slopes()
    common, settled = _common_factor(subject)
    if common > 0.0 and not 1.0 / MASS_FACTOR <= common <= MASS_FACTOR:
        yield _gain(common * np.eye(len(every)), _other_unit(subject, every, common), settled)
    by_size = subject.expected_std / subject.measured_std  # zero for joints that move no mass: any unit is possible
    factors = np.where(follows(correlations), 1.0 / np.maximum(slopes, 1e-30), by_size)
    unlike_common = np.abs(np.log(np.maximum(factors / (common if settled else 1.0), 1e-30))) > np.log(MASS_FACTOR)
    unlike_nominal = np.abs(np.log(np.maximum(factors, 1e-30))) > np.log(MASS_FACTOR)
    loads = np.quantile(np.abs(subject.measured), 0.99, axis=0) / subject.robot.effort_limits[subject.joints]
    for joint in np.flatnonzero(unlike_common & unlike_nominal & (by_size > 0.0)).tolist() if len(every) > 1 else ():
        factor, beyond_rating = float(factors[joint]), bool(loads[joint] > MASS_FACTOR**2)
        matrix = np.diag(np.where(np.isin(every, joint), factor, 1.0))
        yield _gain(matrix, _other_unit(subject, [joint], factor), beyond_rating)


def _gain(matrix: FloatArray, cause: Cause, settled: bool) -> FaultCandidate:
    """Candidate for another unit of efforts, on which their resemblance to the prediction does not depend."""
    linear = _linear(matrix, cause)
    return replace(linear, needs_no_evidence=settled, corrected=None, fit_corrected=linear.evaluate)


def _common_factor(subject: EffortData) -> tuple[float, bool]:
    """Factor that makes all efforts those of the URDF, and True if it is certain without any evidence: if the fitted
    links are all too light or too heavy by the same factor, or all implausibly light."""
    for slopes, correlations in (subject.slopes(), subject.fitted_slopes(subject.nominal)):
        sure = follows(correlations)
        if np.count_nonzero(sure) >= 2:
            factor = 1.0 / float(np.median(slopes[sure]))
            return factor, bool(np.median(np.abs(np.log(slopes[sure] * factor))) < np.log(MASS_FACTOR))
    felt = subject.sizes_of_links(subject.nominal)
    if len(felt) > 1 and np.all((felt > 0.0) & (felt < 1.0 / MASS_FACTOR)):
        return 1.0 / float(np.median(felt)), True
    return float(np.median(subject.expected_std / subject.measured_std)), False


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
    guesses = [unit for unit, (low, high) in units.items() if low < factor < high][:1]
    if is_all and factor < 1.0:
        guesses.append("or masses of the URDF that are placeholders, or another robot's")
    unit = f" ({', '.join(guesses)}?)" if guesses else ""
    return Cause.of("gain", names, settings, all_joints=is_all, ratio=ratio, unit=unit)


def _gravities(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for the best-fitting direction of gravity, and for efforts without gravity."""
    nominal = subject.robot.gravity
    size = float(np.linalg.norm(nominal))
    right = abs(size - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
    strength, fitted, under = size if right else STANDARD_GRAVITY, subject.fitted_gravity(), subject
    for _ in range(ROUNDS):
        under = under.under_gravity(strength * _unit(fitted))
        fitted = under.fitted_gravity(under.nominal)
    yield _turned(subject, under.robot.gravity)
    if not right:
        yield _turned(subject, STANDARD_GRAVITY * (nominal / size if size > 0.0 else np.array([0.0, 0.0, -1.0])))
    if size > 0.0:
        cause = Cause.of("compensated", subject.names, {"gravity": [0.0, 0.0, 0.0]})
        yield from (FaultCandidate(corrected=read, cause=cause) for read in (_without_gravity, _with_gravity_added))


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


def _without_gravity(subject: EffortData) -> EffortData:
    """Return the subject without gravity."""
    return subject.under_gravity(np.zeros(3))


def _with_gravity_added(subject: EffortData) -> EffortData:
    """Add the weights of the URDF's links to efforts that are compensated for them."""
    return subject.with_efforts(subject.measured + subject.weight)


def _exchanges(names: Sequence[str]) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
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


def _names(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield candidates for swapped names: positions and efforts of one joint are those of another."""
    single, sides = _exchanges(subject.names)
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
        yield replace(_of_motion(reordered, cause), sources=sources)


def _positions(subject: EffortData) -> Iterator[FaultCandidate]:
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
    return FaultCandidate(corrected=lambda subject: subject.with_samples(change(subject.samples)), cause=cause)


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
    least_gain = cache(_gain_without_gravity)
    yield _at_rate(subject, 0.0, Cause.of("guided", subject.names), least_gain)
    speeds = np.abs(subject.samples.velocity)
    for rate in (rate for rate in TIMES if np.any(rate * speeds > REST_SPEED)):  # at others the robot would rest
        speed = f"{1.0 / rate:g} times as slow" if rate < 1.0 else f"{rate:g} times as fast"
        cause = Cause.of("time", subject.names, rate=speed, period=f"{1.0 / rate:g} times")
        yield _at_rate(subject, rate, cause, least_gain)


def _gain_without_gravity(subject: EffortData) -> float:
    """Gain of log evidence by efforts that are compensated for gravity, zero if there is none."""
    readings = (_without_gravity(subject), _with_gravity_added(subject))
    fits = [reading.in_units(subject.measured_std).nominal for reading in readings]
    return max(0.0, *(fit.log_evidence - subject.nominal.log_evidence for fit in fits))


def _at_rate(
    subject: EffortData, rate: float, cause: Cause, least_gain: Callable[[EffortData], float]
) -> FaultCandidate:
    same = np.eye(len(subject.robot.joints))

    def undo(subject: EffortData) -> Evidence:
        timed = subject.with_samples(_moved(subject.samples, same, rate=rate))
        judged = timed.in_units(subject.measured_std).nominal
        return replace(judged, log_evidence=judged.log_evidence - least_gain(subject))

    return FaultCandidate(fit_corrected=undo, cause=cause)


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
            ahead, behind = (read(subject, zero + step).link_efforts(mended.links(fitted)) for step in (STEP, -STEP))
            rate = (ahead - behind) * (0.5 * TILT / STEP)
            mended.__dict__["predicted"] = mended.predicted + (start - zero) / TILT * rate
            fitted = mended.evidence(unknown=rate[:, :, None])
            zero = start + TILT * float(fitted.link_errors[-1])
            mended = read(subject, zero)
        return replace(fitted, estimates=np.array([zero]), estimate_deviations=TILT * fitted.deviations()[-1:])

    def cause(judged: Evidence) -> Cause:
        zero, deviation = np.degrees([judged.estimates[0], judged.estimate_deviations[0]])
        turn = (zero + 180.0) % 360.0 - 180.0
        text = f"about {turn:.0f} (+-{max(2.0 * deviation, 1.0):.0f}) degrees have"
        if sign > 0.0:
            return Cause.of("zero", [name], zero=text)
        addition = "" if abs(turn) < 5.0 else f", and {text} to be added to its positions then"
        return Cause.of("axis", [name], reversed="position, velocity and effort", zero=addition)

    return FaultCandidate(fit_corrected=undo, corrected=read, cause=cause)


def _with_zero(samples: Samples, joint: int, sign: float, zero: float) -> Samples:
    """Samples in which a joint counts from another zero [rad], in the opposite direction if ``sign`` is negative."""
    at = np.arange(samples.position.shape[1]) == joint
    signs = np.where(at, sign, 1.0)
    return replace(_moved(samples, np.diag(signs), zero * at), effort=signs * samples.effort)


OF_EFFORTS = (_signs, _frictions, _magnitudes, _orders, _couplings, _gains, _gravities, _positions)
"""Rows of candidates that leave the motion as it is, except for impossible angles."""
OF_MOTION = (_times, _names, _zeros, _axes)
"""Rows of candidates that change the motion of the recording."""


def transforms(subject: EffortData) -> tuple[list[FaultCandidate], int]:
    """Return all candidates that are worth evaluating on a subject, and the number that they are chosen from."""
    # If efforts are almost explained, another reading of the motion cannot gain enough.
    possible_gain = float(np.sum(np.log(subject.nominal.sigmas / LEAST_SIGMA)))
    rows = (*OF_EFFORTS, *OF_MOTION) if is_probable(possible_gain, 1) else OF_EFFORTS
    chosen, count = list[FaultCandidate](), 0
    for row in rows:
        ranked = sorted(row(subject), key=lambda candidate: -candidate.resemblance(subject.thinned))
        chosen += [c for place, c in enumerate(ranked) if place < _BEST or c.needs_no_evidence or c.corrected is None]
        count += len(ranked)
    return chosen, count
