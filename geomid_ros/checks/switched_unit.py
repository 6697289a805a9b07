"""Efforts of all joints that are in another unit, or have the other sign, from some instant on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.hypotheses import Hypothesis
from geomid_ros.checks.instants import FEWEST, NEARER, PLACES, after, elapsed
from geomid_ros.checks.readings import Reading, as_it_is
from geomid_ros.checks.subject import Subject
from geomid_ros.checks.units import REASON
from geomid_ros.signals.saturation import STANDING
from geomid_ros.types import BoolArray, FloatArray

_NEARER = (0.7, 1.0, 1.4)  # times the factor that sizes tell
_NONE = 1e-12


@dataclass(frozen=True, eq=False)
class _Switch:
    """Efforts are ``factor`` times as much from a ``place`` on: the ``evidence`` of it."""

    place: float
    factor: float
    evidence: Evidence


class SwitchedUnit:
    """Looks for an instant from which on all efforts are multiplied by what no change of a robot explains."""

    def __init__(self, subject: Subject) -> None:
        """
        Args:
            subject: what is judged.
        """
        self._subject = subject
        moves = np.any(np.abs(subject.samples.velocity[:, subject.joints]) > STANDING, axis=1)
        self._samples = subject.samples.select(moves)  # at rest stiction holds whatever it likes
        self._world = subject.world(self._samples)

    def hypotheses(self, nominal: Evidence) -> Iterator[Hypothesis]:
        """The instant and the factor that explain most; ``nominal`` is the evidence of none."""
        if len(self._samples) < FEWEST:
            return
        tried = [self._switch(place, factor) for place in PLACES for factor in self._factors(place)]
        best = max(tried, key=lambda switch: switch.evidence.log)
        near = [(best.place + by, times * best.factor) for by in (0.0, *NEARER) for times in _NEARER]
        best = max([best, *(self._switch(*one) for one in near)], key=lambda switch: switch.evidence.log)
        when = words.from_on(elapsed(self._samples.stamps, best.place))
        cause = words.unit_switches(self._subject.names, best.factor, when)
        no_reason = not 1.0 / REASON <= best.factor <= REASON
        as_before = self._world.judge(as_it_is(len(self._subject.joints)))
        log = nominal.log + best.evidence.log - as_before.log
        found = replace(nominal, log=log, sigmas=nominal.sigmas * best.evidence.sigmas / as_before.sigmas)
        yield self._subject.hypothesis(cause, found, len(tried), allowed=no_reason)

    def _factors(self, place: float) -> list[float]:
        """What efforts may be multiplied by: the other sign, and where they become that large or small another unit."""
        later = after(len(self._world.measured), place)
        factor = float(np.median(self._size(later) / self._size(~later)))
        return [-1.0] if 1.0 / REASON <= factor <= REASON else [factor, -factor]

    def _size(self, part: BoolArray) -> FloatArray:
        """How large measured efforts are in a part, over the predicted ones ``(C,)``."""
        sizes = [
            np.sqrt(np.mean(values[part] ** 2, axis=0)) for values in (self._world.measured, self._world.predicted)
        ]
        return np.asarray(np.maximum(sizes[0], _NONE) / np.maximum(sizes[1], _NONE))

    def _switch(self, place: float, factor: float) -> _Switch:
        """The better of two readings: efforts are in N m before the place, or after it.

        The smaller numbers are multiplied, so that the evidence is that of numbers as they were measured times the
        Jacobian of this.
        """
        later = after(len(self._world.measured), place)
        part, size = (~later, abs(factor)) if abs(factor) > 1.0 else (later, 1.0 / abs(factor))
        mended = self._world.measured * np.where(part, size, 1.0)[:, None]
        mended[later] *= np.sign(factor)
        world = self._world.with_measured(mended)
        count, channels = mended.shape
        jacobian = count * float(np.sum(np.log(self._world.spread / world.spread)))
        jacobian += channels * int(np.sum(part)) * float(np.log(size))
        readings = {sign * gain for sign in (1.0, np.sign(factor)) for gain in (1.0, 1.0 / size)}
        found = [world.judge(Reading(np.arange(channels), np.full(channels, gain))) for gain in readings]
        best = max(found, key=lambda evidence: evidence.log)
        return _Switch(place, factor, replace(best, log=best.log + jacobian))
