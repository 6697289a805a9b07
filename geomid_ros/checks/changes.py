"""Whether something changes during a recording: offsets, gains, what is carried, gravity in efforts, positions.

Each is fitted as it would be from some instant on, or as it would grow, beside all that links, friction and curves
explain of the whole recording. What a robot does where its friction follows another law is explained by those.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.flexible import FlexibleFit, Gain, by_channel
from geomid_ros.checks.hypotheses import Cause, Hypothesis
from geomid_ros.checks.instants import NEARER, PLACES, after, elapsed
from geomid_ros.checks.rows import payload_factor
from geomid_ros.checks.subject import Subject
from geomid_ros.types import FloatArray

_WORTH = 0.05  # nats per instant: less promises nothing
_STEP = 1e-4  # [rad, m] of a position, for a derivative
_GAIN = 0.5  # standard deviations of what is tried: another gain,
_ZERO = 0.3  # another zero of a position [rad, m],
_LEAST_OFFSET = 0.25  # of an effort's standard deviation: warm friction changes less
_LEAST_GAIN = 0.1
_LEAST_MASS = 0.01  # of the robot's: less is of no account
_LEAST_ZERO = 0.02  # [rad, m]
_ALL = (-1.3, -0.7)  # times gravity's efforts, which are missing then
_MAIN = 0.5  # of the largest change: the joints that it is about


@dataclass(frozen=True, eq=False)
class _Kind:
    """Something that may change.

    Attributes:
        columns: ``(N, C, k)`` its efforts, by standard deviations of its size.
        said: what it says, from what was fitted and when it changes; None if it is too small or cannot be.
        grows: whether it may also do so bit by bit.
        first: whether it is so until some instant, not from then on.
    """

    columns: FloatArray
    said: Callable[[Gain, str], tuple[Cause, list[int]] | None]
    grows: bool = False
    first: bool = False


class Changes:
    """Looks for what changes during a recording."""

    def __init__(self, subject: Subject, fit: FlexibleFit) -> None:
        """
        Args:
            subject: what is judged.
            fit: of it.
        """
        self._subject, self._fit = subject, fit
        self._samples, self._names = subject.samples, subject.names
        self._units = [subject.robot.joints[joint].unit for joint in subject.joints]
        self._regressor = subject.regressor(subject.samples)

    def hypotheses(self, nominal: Evidence) -> Iterator[Hypothesis]:
        """What may change, as far as it explains anything; ``nominal`` is the evidence of nothing that does."""
        for kind in self._kinds():
            columns, when = self._best(kind)
            if self._fit.promise(columns) < _WORTH:
                continue
            gain, always = self._fit.gain(columns), self._fit.gain(kind.columns)
            said = kind.said(gain, when)
            if said is not None:
                beyond = gain.beyond(always) if always.per_instant > 0.0 else gain
                yield hypothesis(said[0], said[1], beyond, nominal, len(self._samples), len(PLACES))

    def _best(self, kind: _Kind) -> tuple[FloatArray, str]:
        """The columns of the instant that promises most, and when that is."""
        tried = [self._from(kind, place) for place in PLACES]
        best = int(np.argmax([self._fit.promise(columns) for columns, _ in tried]))
        near = [tried[best], *(self._from(kind, PLACES[best] + by) for by in NEARER)]
        if kind.grows:
            share = (np.arange(len(self._samples)) / len(self._samples))[:, None, None]
            near.append((share * kind.columns, words.BIT_BY_BIT))
        return max(near, key=lambda one: self._fit.promise(one[0]))

    def _from(self, kind: _Kind, place: float) -> tuple[FloatArray, str]:
        later = after(len(self._samples), place)
        when = words.until if kind.first else words.from_on
        return (later != kind.first)[:, None, None] * kind.columns, when(elapsed(self._samples.stamps, place))

    def _kinds(self) -> Iterator[_Kind]:
        fit, robot, prior = self._fit, self._subject.robot, self._subject.prior
        offsets = np.broadcast_to(fit.spread[None, :, None], (*fit.measured.shape, 1))
        yield _Kind(by_channel(offsets), self._offset, grows=True)
        gain = _GAIN * fit.rigid[:, :, None]
        yield _Kind(gain, self._gain, grows=True)
        yield _Kind(by_channel(gain), self._gain_of_one, grows=True)
        gravity = (self._regressor - self._subject.regressor(self._samples, weightless=True)) @ prior
        for first in (False, True):
            yield _Kind(gravity[:, :, None], self._gravity, first=first)
        bodies = prior.reshape(-1, 10)
        for place, body in enumerate(robot.bodies):
            if len(robot.subtree(body.name)) == 1:
                factor = payload_factor(bodies, place)
                columns = self._regressor[:, :, 10 * place : 10 * place + 10] @ factor
                yield _Kind(columns, self._payload(body.name, factor[0]))
        yield _Kind(_ZERO * self._by_position(), self._zero, grows=True)

    def _by_position(self) -> FloatArray:
        """Derivatives of the URDF's efforts by the positions of the joints ``(N, C, C)``."""
        prior, found = self._subject.prior, []
        now = self._regressor @ prior
        for joint in self._subject.joints:
            position = self._samples.position.copy()
            position[:, joint] += _STEP
            moved = self._subject.regressor(replace(self._samples, position=position)) @ prior
            found.append((moved - now) / _STEP)
        return np.stack(found, axis=2)

    def _offset(self, gain: Gain, when: str) -> tuple[Cause, list[int]] | None:
        main = _main(gain.coefficients, _LEAST_OFFSET)
        steps = gain.coefficients * self._fit.spread
        said = [words.change(self._names[c], steps[c], self._units[c]) for c in main]
        return (words.other_offset([self._names[c] for c in main], said, when), main) if main else None

    def _gain(self, gain: Gain, when: str) -> tuple[Cause, list[int]] | None:
        factor = 1.0 + _GAIN * float(gain.coefficients[0]) * float(np.median(self._share_of_first(gain)))
        if abs(factor - 1.0) < _LEAST_GAIN:
            return None
        return words.gain_changes(self._names, factor, when, True), [*range(len(self._names))]

    def _gain_of_one(self, gain: Gain, when: str) -> tuple[Cause, list[int]] | None:
        steps = _GAIN * gain.coefficients * self._share_of_first(gain)
        main = _main(steps, _LEAST_GAIN)
        if len(main) != 1:
            return None
        factor = 1.0 + float(steps[main[0]])
        return words.gain_changes([self._names[main[0]]], factor, when, False), main

    def _share_of_first(self, gain: Gain) -> FloatArray:
        """What was fitted to all of the time, as shares of what links take before it changes ``(C,)``."""
        return np.asarray(np.std(self._fit.rigid, axis=0) / np.maximum(np.std(gain.rigid, axis=0), 1e-9))

    def _gravity(self, gain: Gain, when: str) -> tuple[Cause, list[int]] | None:
        if not _ALL[0] < gain.coefficients[0] < _ALL[1]:
            return None
        return words.gravity_goes(self._names, when), [*range(len(self._names))]

    def _payload(self, link: str, masses: FloatArray) -> Callable[[Gain, str], tuple[Cause, list[int]] | None]:
        def said(gain: Gain, when: str) -> tuple[Cause, list[int]] | None:
            mass, whole = float(masses @ gain.coefficients), float(np.sum(self._subject.prior[::10]))
            if abs(mass) < _LEAST_MASS * whole:
                return None
            return words.payload_changes(link, mass, self._names, when), [*range(len(self._names))]

        return said

    def _zero(self, gain: Gain, when: str) -> tuple[Cause, list[int]] | None:
        main = _main(_ZERO * gain.coefficients, _LEAST_ZERO)
        said = [words.displaced(self._names[c], -_ZERO * gain.coefficients[c], self._units[c] != "N") for c in main]
        everywhere = [*range(len(self._names))]  # efforts of all joints depend on it
        return (words.zero_changes([self._names[c] for c in main], said, when), everywhere) if main else None


def _main(sizes: FloatArray, least: float) -> list[int]:
    """The channels whose size is at least that, and not small beside the largest."""
    return [*np.flatnonzero(np.abs(sizes) > max(least, _MAIN * float(np.max(np.abs(sizes)))))]


def hypothesis(
    cause: Cause, concerned: list[int], gain: Gain, nominal: Evidence, instants: int, choices: int
) -> Hypothesis:
    """A cause that gains so much, beside others that are compared with the same nominal evidence."""
    log = nominal.log + gain.per_instant * instants
    found = replace(nominal, log=log, sigmas=nominal.sigmas * gain.ratios)
    sources = np.arange(len(nominal.sigmas))
    return Hypothesis(cause=cause, evidence=found, choices=choices, sources=sources, concerned=concerned)
