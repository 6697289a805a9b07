"""Candidates for changes during a recording, and for delays: offsets, gains, loads, gravity, positions.

Each is fitted as a step or as gradual growth, given all that links, friction and curves explain of the whole recording.
Friction that follows another law is explained by these curves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TypeAlias

import numpy as np

from geomid_ros.checks.candidates import MASS_FACTOR, TILT, FaultCandidate
from geomid_ros.checks.causes import BIT_BY_BIT, Cause
from geomid_ros.checks.effort_data import STRETCHES, EffortData, EvidenceGain, by_channel, moving
from geomid_ros.checks.evidence import LEAST_SIGMA, MOST, PRIOR_STD, Evidence, evidence, payload_factor
from geomid_ros.checks.sample_reservoir import FEWEST
from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.model.dynamics import STEP
from geomid_ros.model.samples import SIGN, SMOOTH_SIGN
from geomid_ros.types import BoolArray, FloatArray

_PLACES = np.linspace(0.0, 1.0, STRETCHES, endpoint=False)[1:]  # fractions of the recording at which a change may begin
_LEAST_LAG, _MOST_LAG = 0.03, 0.3  # [s]; less hardly matters after the filter; if more fits, it is no lag

Columns: TypeAlias = Callable[[EffortData], FloatArray]
"""Makes the effort columns ``(N, C, k)`` of a subject, per standard deviation of a possible fault."""


@dataclass(frozen=True, eq=False)
class _Kind:
    """A possible change: its ``columns``; its ``cause``, made from a fit and its time of beginning, None if it is too
    small. ``grows``: True if it may be gradual. ``first``: True if it is there from the beginning, until some time."""

    columns: Columns
    cause: Callable[[EvidenceGain, str], Cause | None]
    grows: bool = False
    first: bool = False

    def onset(self, subject: EffortData, place: float) -> FloatArray:
        """Columns from a ``place`` on, or until it, or growing gradually if it is NaN."""
        weight = subject.shares if np.isnan(place) else (subject.shares >= place) != self.first
        return np.asarray(weight[:, None, None] * self.columns(subject))


def changes(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield the changes that promise to explain anything, each from where it promises most."""
    yield from switches(subject)
    # People change something between recordings rather than during one.
    begins = np.union1d(
        np.searchsorted(subject.shares, _PLACES),
        np.flatnonzero(np.diff(subject.recordings, prepend=subject.recordings[0])),
    )
    fit = subject.baseline_fit
    for kind in _kinds(subject):
        always = kind.columns(subject)
        promises = fit.predicted_gains(always, begins, before=kind.first)
        places = subject.shares[begins]
        if kind.grows:
            promises = np.append(promises, fit.predicted_gains(subject.shares[:, None, None] * always))
            places = np.append(places, np.nan)
        best = int(np.argmax(promises))
        if promises[best] <= 0.0:
            continue
        place = float(places[best])
        gain = fit.gain(kind.onset(subject, place))
        time = BIT_BY_BIT if np.isnan(place) else f"about {subject.time_of(place)}"
        cause = kind.cause(gain, time if np.isnan(place) else f"until {time}" if kind.first else f"from {time} on")
        if cause is not None:
            yield _candidate(kind, place, int(np.argmax(np.abs(gain.coefficients))), cause)


def _candidate(kind: _Kind, place: float, main: int, cause: Cause) -> FaultCandidate:
    def undo(subject: EffortData) -> Evidence:
        gain = subject.baseline_fit.gain(kind.onset(subject, place))
        always = subject.baseline_fit.gain(kind.columns(subject))
        beyond = gain.beyond(always) if always.per_instant > 0.0 else gain
        return _judged(subject, beyond, slice(main, main + 1))

    return FaultCandidate(fit_corrected=undo, cause=cause, begins_during_recording=True)


def _judged(subject: EffortData, gain: EvidenceGain, main: slice) -> Evidence:
    """Evaluate a gain over the baseline fit, with the sizes of its ``main`` columns."""
    nominal = subject.nominal
    return replace(
        nominal,
        log_evidence=nominal.log_evidence + gain.per_instant * len(subject.samples),
        sigmas=nominal.sigmas * gain.ratios,
        estimates=gain.coefficients[main],
        estimate_deviations=gain.deviations[main],
    )


def _kinds(subject: EffortData) -> Iterator[_Kind]:
    names, units = subject.names, subject.units

    def offset(gain: EvidenceGain, when: str) -> Cause:
        steps = gain.coefficients * subject.measured_std
        return _sized("offset", gain, when, [f"{step:+.3g} {unit}" for step, unit in zip(steps, units, strict=True)])

    def slip(gain: EvidenceGain, when: str) -> Cause:
        shifts = -TILT * gain.coefficients
        texts = [
            f"{1000.0 * shift:+.0f} mm" if unit == "N" else f"{np.degrees(shift):+.0f} degrees"
            for shift, unit in zip(shifts, units, strict=True)
        ]
        return _sized("slip", gain, when, texts)

    def _sized(kind: str, gain: EvidenceGain, when: str, texts: list[str]) -> Cause:
        main = _main(gain.coefficients)
        sizes = ", ".join(f"'{names[c]}' by {texts[c]}" for c in main)
        return Cause.of(kind, [names[c] for c in main], sizes=sizes, when=when)

    def drift(gain: EvidenceGain, when: str) -> Cause | None:
        every = len(gain.coefficients) == 1
        first = np.std(subject.baseline_fit.link_efforts, axis=0) / np.maximum(np.std(gain.link_efforts, axis=0), 1e-9)
        steps = PRIOR_STD * gain.coefficients * (np.median(first) if every else first)
        main, *others = _main(steps)
        if others:
            return None
        factor = 1.0 + float(steps[main])
        return Cause.of("drift", names if every else [names[main]], when=when, factor=factor, all_joints=every)

    def switched(gain: EvidenceGain, when: str) -> Cause | None:
        return Cause.of("switched", names, when=when) if round(float(gain.coefficients[0])) == -1 else None

    yield _Kind(
        lambda of: by_channel(np.broadcast_to(of.measured_std[None, :, None], (*of.measured.shape, 1))), offset, True
    )
    yield _Kind(lambda of: PRIOR_STD * of.baseline_fit.link_efforts[:, :, None], drift, True)
    yield _Kind(lambda of: by_channel(PRIOR_STD * of.baseline_fit.link_efforts[:, :, None]), drift, True)
    for first in (False, True):
        yield _Kind(lambda of: of.weight[:, :, None], switched, first=first)
    bodies = subject.urdf_parameters.reshape(-1, 10)
    for place, body in enumerate(subject.robot.bodies):
        if len(subject.robot.subtree(body.name)) == 1:
            yield _load(subject, place, body.name, payload_factor(bodies, place))
    yield _Kind(lambda of: TILT * _by_position(of), slip, True)


def _load(subject: EffortData, place: int, link: str, factor: FloatArray) -> _Kind:
    """Load that a link picks up or puts down."""

    def cause(gain: EvidenceGain, when: str) -> Cause:
        mass = float(factor[0] @ gain.coefficients)
        way = "more" if mass > 0.0 else "less"
        return Cause.of("load", subject.names, link=link, mass=abs(mass), way=way, when=when)

    return _Kind(lambda of: of.columns_of(place, factor), cause)


def _by_position(subject: EffortData) -> FloatArray:
    """Derivatives of the URDF's efforts by joint positions ``(N, C, C)``."""
    columns = []
    for joint in subject.joints:
        position = subject.samples.position.copy()
        position[:, joint] += STEP
        moved = subject.with_samples(replace(subject.samples, position=position))
        columns.append((moved.predicted - subject.predicted) / STEP)
    return np.stack(columns, axis=2)


def _main(sizes: FloatArray) -> list[int]:
    """Channels whose size is not small compared with the largest."""
    return [*np.flatnonzero(np.abs(sizes) >= MOST * float(np.max(np.abs(sizes))))]


def switches(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield switches of the efforts of all joints to another unit, or the opposite sign, at some sample."""
    switches = [(place, factor) for place in _PLACES[1::2] for factor in _factors(subject.moving_part, place)]
    if len(subject.moving_part.samples) < FEWEST or not switches:
        return
    tried = {(place, factor): _switched(subject, place, factor).log_evidence for place, factor in switches}
    place, factor = max(tried, key=lambda one: tried[one])
    near = [(place + by, factor) for by in (-_PLACES[0], _PLACES[0])]
    tried |= {switch: _switched(subject, *switch).log_evidence for switch in near}
    place, factor = max(tried, key=lambda one: tried[one])
    change = "the opposite sign" if factor == -1.0 else f"{factor:.2g} times the earlier value"
    cause = Cause.of("stream", subject.names, factor=change, when=f"from about {subject.time_of(place)} on")
    yield FaultCandidate(
        fit_corrected=lambda of: _switched(of, place, factor), cause=cause, begins_during_recording=True
    )


def _factors(subject: EffortData, place: float) -> list[float]:
    """Possible factors on the efforts from a place on: the opposite sign, or a unit, if they change as much."""
    later = subject.shares >= place

    def size(part: np.ndarray) -> FloatArray:
        measured, predicted = (np.sqrt(np.mean(e[part] ** 2, axis=0)) for e in (subject.measured, subject.predicted))
        return np.asarray(np.maximum(measured, 1e-12) / np.maximum(predicted, 1e-12))

    if np.all(later) or not np.any(later):
        return []
    factor = float(np.median(size(later) / size(~later)))
    return [-1.0] if 1.0 / MASS_FACTOR <= factor <= MASS_FACTOR else [factor, -factor]


def _switched(recording: EffortData, place: float, factor: float) -> Evidence:
    """Evaluate the best reading: efforts in N m before the place or after it, of either sign for a negative factor;
    on the samples in motion, because stiction is arbitrary at rest."""
    subject = recording.moving_part
    later = subject.shares >= place
    readings = []
    # If efforts are reversed, each reading is the opposite of the other.
    for sign in {1.0, 1.0 if factor == -1.0 else float(np.sign(factor))}:
        for part, size in ((later, 1.0 / factor), (~later, factor)):
            gains = np.where(part, size, 1.0) * sign
            mended = subject.with_efforts(subject.measured * gains[:, None])
            volume = len(subject.joints) * float(np.sum(np.log(np.abs(gains))))
            volume += len(gains) * float(np.sum(np.log(subject.measured_std / mended.measured_std)))
            readings.append(replace(mended.nominal, log_evidence=mended.nominal.log_evidence + volume))
    best = max(readings, key=lambda judged: judged.log_evidence)
    log = recording.nominal.log_evidence + best.log_evidence - subject.nominal.log_evidence
    return replace(best, log_evidence=log, sigmas=np.minimum(best.sigmas, recording.nominal.sigmas))


def lags(subject: EffortData) -> Iterator[FaultCandidate]:
    """Yield delays of the efforts against the motion: of all, and of the one that promises most.

    Efforts that come late are those of an earlier motion. Friction turns about late by itself, too, so that joints tell
    a lag only while they move one way.
    """
    earlier = cache(partial(_in_earlier_motion, subject))
    every = np.ones(len(subject.joints), dtype=bool)
    alone = np.arange(len(every)) == _most_delayed(subject, earlier)
    for late in (every, alone) if len(every) > 1 else (every,):
        lag, deviation = _most_probable_lag(subject, late, earlier)
        if abs(lag) < _MOST_LAG and abs(lag) - STDS_OF_95 * deviation > _LEAST_LAG:
            yield _late(subject, late, lag)


def _most_delayed(subject: EffortData, earlier: Callable[[float], EffortData]) -> int:
    """Channel that the fitted links, with any friction, explain much better at another time."""
    links = subject.links(subject.nominal)
    residuals = [
        (of := earlier(lag)).without_friction((of.measured - of.link_efforts(links)).T[:, :, None])
        for lag in (0.0, _LEAST_LAG, -_LEAST_LAG)
    ]
    at_once, *others = np.sum(np.square(residuals), axis=(2, 3))
    return int(np.argmin(np.min(others, axis=0) / at_once))


def _most_probable_lag(
    subject: EffortData, late: BoolArray, earlier: Callable[[float], EffortData]
) -> tuple[float, float]:
    """Lag [s] of the channels ``late (C,)`` at which the evidence has its first maximum, and its standard deviation by
    as many independent samples as the shortest recording's; beyond ``_MOST_LAG`` any."""
    found, best = {0: subject.nominal.log_evidence}, 0
    while True:
        for step in {best - 1, best + 1} - {*found}:
            found[step] = _undone(subject, _with_late(subject, late, earlier(step * _LEAST_LAG))).log_evidence
        best, previous = max(found, key=lambda step: found[step]), best
        if best == previous or abs(best) * _LEAST_LAG > _MOST_LAG:
            break
    before, at, after = (found.get(best + by, -np.inf) for by in (-1, 0, 1))
    curvature = max(2.0 * at - before - after, np.finfo(float).tiny)
    vertex = np.nan_to_num(0.5 * (after - before) / curvature)  # of the parabola
    return _LEAST_LAG * (best + float(vertex)), _LEAST_LAG * float(np.sqrt(len(subject.samples) / FEWEST / curvature))


def _late(subject: EffortData, late: BoolArray, lag: float) -> FaultCandidate:
    names = [name for name, is_late in zip(subject.names, late, strict=True) if is_late]
    time = f"{1000.0 * abs(lag):.0f} ms {'late' if lag > 0.0 else 'early'}"
    sizes = f"all are about {time}" if np.all(late) else f"that of '{names[0]}' about {time}"
    cause = Cause.of("late", names, sizes=sizes)
    return FaultCandidate(
        fit_corrected=lambda of: _undone(of, _with_late(of, late, _in_earlier_motion(of, lag))), cause=cause
    )


def _undone(subject: EffortData, earlier: EffortData) -> Evidence:
    """Evaluate a subject by how much better its efforts are those of an ``earlier`` motion, where each joint moves the
    same way in both. Any residual tells a lag, as errors of links are not late, but channels with little are not worse.
    """
    ways = [np.sign(of.friction[:, :, 1]) * moving(of.friction[:, :, 1]) for of in (subject, earlier)]
    counted = np.where(ways[0] == ways[1], np.abs(ways[0]), 0.0)
    at_once, late = (
        evidence(of.target, of.unknowns, of.tolerated, units=of.measured_std, counted=counted, least=0.0)
        for of in (subject, earlier)
    )
    instants = float(np.mean(np.maximum(np.sum(counted, axis=0), FEWEST)))
    gain = (late.log_evidence - at_once.log_evidence) * len(subject.samples) / instants
    ratios = np.maximum(late.sigmas, LEAST_SIGMA) / np.maximum(at_once.sigmas, LEAST_SIGMA)
    nominal = subject.nominal
    return replace(nominal, log_evidence=nominal.log_evidence + gain, sigmas=nominal.sigmas * ratios)


def _in_earlier_motion(subject: EffortData, lag: float) -> EffortData:
    """Subject in the motion that was a ``lag`` [s] earlier."""
    samples, later = subject.samples, subject.next_samples
    times = 1e-9 * (later.stamps - samples.stamps)[:, None]
    change = later.acceleration - samples.acceleration
    jerk = np.divide(change, times, out=np.zeros_like(change), where=times > 0.0)
    velocity = samples.velocity - lag * samples.acceleration + lag**2 / 2.0 * jerk
    effects = samples.effects.copy()
    for column in (candidate for candidate in (SIGN, SMOOTH_SIGN) if candidate in samples.entries):
        signs = [samples.entries.at(column, joint) for joint in range(velocity.shape[1])]
        effects[:, signs] = np.copysign(effects[:, signs], velocity)
    earlier = replace(
        samples,
        position=samples.position - lag * samples.velocity + lag**2 / 2.0 * samples.acceleration - lag**3 / 6.0 * jerk,
        velocity=velocity,
        acceleration=samples.acceleration - lag * jerk,
        effects=effects,
    )
    return subject.with_samples(earlier)


def _with_late(subject: EffortData, late: BoolArray, earlier: EffortData) -> EffortData:
    """Subject whose channels ``late (C,)`` feel the ``earlier`` motion."""
    if np.all(late):
        return earlier
    mixed = earlier.with_samples(earlier.samples)
    of_pairs = late[subject.pairs[0], None, None]
    for name, chosen in {"rows": of_pairs, "predicted": late, "friction": late[:, None]}.items():
        mixed.__dict__[name] = np.where(chosen, getattr(earlier, name), getattr(subject, name))
    return mixed
